"""An actuator on this desk: the firmware's logic behind a pseudo-terminal, with the time of every change."""

from __future__ import annotations

import os
import pty
import select
import threading
import tty
from collections import deque
from typing import NamedTuple

from common.clock import monotonic_s
from services.jetson.gate.firmware.micropython.gate_receiver import FRAME_BYTES, TICKS_MASK, GateReceiver
from services.jetson.gate.frames import PERMISSIONS

ROUND_S = 0.002
REPORT_EVERY_S = 0.1


class Change(NamedTuple):
    """What the actuator does from ``at_s`` (monotonic) on, and the verdict's number that it came with."""

    at_s: float
    permission: str
    limit_mps: float
    why: int


class EmulatedActuator:
    """Reads its end of the terminal in a thread of its own; the gate opens ``device``. Use it with ``with``."""

    def __init__(self) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        self.receiver = GateReceiver()
        self.changes: list[Change] = []
        self.accepted_s: list[float] = []
        self.verdicts_s: dict[int, float] = {}  # by the lower 16 bits of the number: when a frame first came with it
        self._frame: deque[int] = deque(maxlen=FRAME_BYTES)
        self.presses = 0
        self.answers = True  # False: reads and obeys, says nothing
        self._changed = threading.Condition()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="actuator", daemon=True)

    def __enter__(self) -> EmulatedActuator:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    @property
    def permission(self) -> str:
        """What it does now."""
        return PERMISSIONS[self.receiver.permission]

    def wait_for(self, permission: str, since_s: float, until_s: float) -> float | None:
        """The first moment at or after ``since_s`` at which it did this; None when it did not by ``until_s``."""
        while True:
            with self._changed:
                state = "STOP"
                for change in self.changes:
                    if change.at_s > since_s and state == permission:
                        return since_s
                    state = change.permission
                    if change.at_s > since_s and state == permission:
                        return change.at_s
                if state == permission:
                    return since_s
                left_s = until_s - monotonic_s()
                if left_s <= 0.0:
                    return None
                self._changed.wait(left_s)

    def _run(self) -> None:
        reported_s, last = 0.0, ("STOP", 0, 1)
        while not self._stop.is_set():
            ready, _, _ = select.select([self._master], [], [], ROUND_S)
            now_s = monotonic_s()
            accepted = self._feed(now_s) if ready else False
            self.receiver.tick(int(now_s * 1e3) & TICKS_MASK)
            now = (self.permission, self.receiver.limit_mm_s, self.receiver.why)
            changed = now != last
            if changed:
                last = now
                with self._changed:
                    self.changes.append(Change(now_s, now[0], now[1] * 1e-3, now[2]))
                    self._changed.notify_all()
            if self.answers and (accepted or changed or now_s - reported_s >= REPORT_EVERY_S):
                reported_s = now_s
                try:
                    os.write(self._master, self.receiver.report(self.presses))
                except BlockingIOError:
                    continue  # nobody reads

    def _feed(self, now_s: float) -> bool:
        accepted = False
        for byte in os.read(self._master, 4096):
            self._frame.append(byte)
            if self.receiver.feed(byte, int(now_s * 1e3) & TICKS_MASK):
                accepted = True
                self.accepted_s.append(now_s)
                self.verdicts_s.setdefault(self._frame[8] | self._frame[9] << 8, now_s)
        return accepted
