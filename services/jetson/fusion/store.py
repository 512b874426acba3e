"""What fusion remembers, on disk: claims outlive the process that made them, for as long as they would have lived.

Times in the memory are monotonic, and that clock begins anew with the machine. The file says how old each of them was
when it was written, when that was in UTC, and which start of the machine it was: while it has run on, its monotonic
clock tells how long ago, whatever UTC was set to.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
from dataclasses import replace
from pathlib import Path

import msgspec

from common.periodic import Periodic
from services.jetson.fusion.evidence import FusionMemory
from services.jetson.fusion.recovery import Habit

log = logging.getLogger(__name__)

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
PERIOD_S = 1.0  # at least so often, so that the file's age is the length of the gap


class Saved(msgspec.Struct, frozen=True):
    """The file: the memory, and when on both clocks it was written."""

    now_ns: int
    now_s: float
    begun_s: float  # when start-up began
    memory: FusionMemory
    sensors: dict[str, Habit] = {}
    boot: str = ""  # the start of the machine since which now_s counts; empty = not the one of now, or unknown

    def gap_s(self, now_s: float, now_ns: int) -> float:
        """How long ago that was; negative where only UTC tells, and it was set back."""
        if self.boot:
            return now_s - self.now_s
        return (now_ns - self.now_ns) * 1e-9


def shifted(memory: FusionMemory, by_s: float) -> FusionMemory:
    """The memory with all its times ``by_s`` later."""

    def later(time_s: float | None) -> float | None:
        return None if time_s is None else time_s + by_s

    budget = memory.suppression
    return replace(
        memory,
        at_s=later(memory.at_s),
        claims=tuple(replace(one, since_s=one.since_s + by_s, seen_s=one.seen_s + by_s) for one in memory.claims),
        suppression=budget._replace(since_s=later(budget.since_s), clear_s=later(budget.clear_s)),
    )


def resumed(saved: Saved, now_s: float, now_ns: int) -> Saved:
    """The same on the monotonic clock of now. A file from the future is of now."""
    by_s = now_s - max(0.0, saved.gap_s(now_s, now_ns)) - saved.now_s
    sensors = {
        name: msgspec.structs.replace(one, faults_s=tuple(begun_s + by_s for begun_s in one.faults_s))
        for name, one in saved.sensors.items()
    }
    return Saved(now_ns, now_s, saved.begun_s + by_s, shifted(saved.memory, by_s), sensors, saved.boot)


def this_boot() -> str:
    """The kernel's name for this start of the machine; empty where it has none."""
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""


class Store:
    """A folder with a file for each fusion; with an empty name nothing is kept. Written by a thread of its own.

    ``namespace`` and ``host`` name the file: the alarms of another site or vehicle on this machine are not ours.
    """

    def __init__(self, folder: str, namespace: str, host: str) -> None:
        file = f"{namespace.replace('/', '.')}.{host}.json"
        self._path = Path(folder).expanduser() / file if folder else None
        self._boot = this_boot()
        self._due = Periodic(PERIOD_S)
        self._kept: object = None
        self._next: Saved | None = None
        self._failing = False
        self._wake = threading.Event()
        if self._path is not None:
            threading.Thread(target=self._write_forever, name="store", daemon=True).start()

    def load(self) -> Saved | None:
        """What the last run remembered; a file that cannot be read is said in the log and counts as none."""
        if self._path is None or not self._path.exists():
            return None
        try:
            saved = msgspec.json.decode(self._path.read_bytes(), type=Saved)
            return saved if saved.boot == self._boot else msgspec.structs.replace(saved, boot="")
        except (OSError, msgspec.MsgspecError) as error:
            log.warning("%s is damaged, or of another version, and does not count: %s", self._path, error)
            return None

    def keep(self, state: Saved) -> None:
        """Write it soon: at once when a claim begins, ends or changes its level, else once a second."""
        if self._path is None:
            return
        news = [(one.by, one.level, one.lost, one.counted, one.since_s) for one in state.memory.claims]
        if news == self._kept and not self._due.due(state.now_s):
            return
        self._kept, self._next = news, state
        self._wake.set()

    def _write_forever(self) -> None:
        while self._wake.wait():
            self._wake.clear()
            saved = self._next
            if saved is not None:
                self.write(saved)

    def write(self, saved: Saved) -> None:
        """Never half a file; a full or read-only disk is said once in the log and costs the memory, not the verdict."""
        assert self._path is not None
        part = self._path.with_suffix(f".{os.getpid()}.tmp")  # a swap runs two of us for a moment
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(msgspec.json.encode(msgspec.structs.replace(saved, boot=self._boot)))
            part.replace(self._path)
        except OSError as error:
            with contextlib.suppress(OSError):
                part.unlink()
            if not self._failing:
                log.warning("%s: %s; alarms would not survive a restart", self._path.parent, error.strerror)
            self._failing = True
        else:
            if self._failing:
                log.info("%s: written again, alarms survive a restart", self._path.parent)
            self._failing = False
