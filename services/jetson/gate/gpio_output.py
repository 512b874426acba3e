"""Permissions on GPIO lines: pulses that stop by themselves, or levels held by a guard process.

A level alone is not fail-safe: a process that freezes, or a kernel that keeps the last value of a released line, leaves
it at "go". So it is either

- ``mode=pulse``: the line changes at every round while the vehicle may move. A missing-pulse detector
  (a retriggerable monostable, a charge pump) behind it lets the relay go when the changes stop, whatever the reason; or
- ``mode=level``: a process of its own (``guard``) holds the line. It lets go when the gate is silent, and the gate
  takes the line away from a guard that is silent. A kernel that stands still is not covered.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from typing import NamedTuple

from common.backoff import Backoff
from common.config import ConfigError
from common.source_url import SourceUrl
from services.jetson.gate.config import GateConfig
from services.jetson.gate.gpio_lines import Lines, open_lines
from services.jetson.gate.pipeline import Decision
from services.jetson.gate.serial_output import FIRST_PAUSE_S, LONGEST_PAUSE_S, FramedOutput

log = logging.getLogger(__name__)

GUARD_LATE_S = 0.1  # a guard that is silent for longer loses its lines


class Pins(NamedTuple):
    """Which lines of which chip. ``full`` None: SLOW cannot be told from GO, so it is STOP."""

    chip: str
    enable: int
    full: int | None
    active_low: bool

    @property
    def offsets(self) -> tuple[int, ...]:
        """The lines in use, as numbers of the chip."""
        return (self.enable,) if self.full is None else (self.enable, self.full)

    def open(self) -> Lines:
        """Raises ``LineError``."""
        return open_lines(self.chip, self.offsets, active_low=self.active_low)


def gpio_output(url: SourceUrl, config: GateConfig) -> PulseOutput | FramedOutput:
    """``gpio:/dev/gpiochip0?enable=17&full=27&mode=pulse&active=high&hold=0.05``.

    Raises:
        ConfigError: no ``enable``, or a value that is not allowed.
    """
    pins, mode = _pins_of(url), url.params.get("mode", "pulse")
    if mode == "pulse":
        return PulseOutput(url, pins, url.number("hold", 0.05))
    if mode == "level":
        return FramedOutput(url, lambda: GuardPort(pins), config.limits.permit_s, late_s=GUARD_LATE_S)
    raise ConfigError(f"output {url}: mode={mode!r}: expected pulse or level")


def _pins_of(url: SourceUrl) -> Pins:
    active = url.params.get("active", "high")
    if active not in ("high", "low"):
        raise ConfigError(f"output {url}: active={active!r}: expected high or low")
    if "enable" not in url.params:
        raise ConfigError(f"output {url}: expected the number of the line, e.g. gpio:/dev/gpiochip0?enable=17")
    full = int(url.number("full", 0)) if "full" in url.params else None
    return Pins(url.target, int(url.number("enable", 0)), full, active == "low")


def line_values(pins: Pins, permission: str) -> dict[int, bool]:
    """Which lines are active with a permission."""
    may_move = permission == "GO" or (permission == "SLOW" and pins.full is not None)
    values = {pins.enable: may_move}
    if pins.full is not None:
        values[pins.full] = permission == "GO"
    return values


class PulseOutput:
    """The enable line changes at every round while the vehicle may move, and is inactive otherwise."""

    def __init__(self, url: SourceUrl, pins: Pins, hold_s: float) -> None:
        self.url, self.hold_s = url, hold_s
        self._pins = pins
        self._lines: Lines | None = None
        self._high, self._lost = False, f"{url}: not opened yet"
        self._backoff, self._retry_s = Backoff(FIRST_PAUSE_S, LONGEST_PAUSE_S), 0.0

    def send(self, now_s: float, decision: Decision, verdict_seq: int) -> None:
        """Set the lines; the enable line changes its level while the vehicle may move."""
        if self._lines is None and not self._reopen(now_s):
            return
        assert self._lines is not None
        values = line_values(self._pins, decision.permission)
        self._high = values[self._pins.enable] and not self._high
        try:
            self._lines.set({**values, self._pins.enable: self._high})
        except OSError as error:
            self._lose(now_s, error)

    def listen(self, now_s: float) -> None:
        return

    def fault(self, now_s: float) -> str:
        return "" if self._lines is not None else self._lost

    def presses(self) -> int:
        return 0

    def words(self) -> str:
        return ""

    def close(self) -> None:
        if self._lines is not None:
            self._lines.close()
        self._lines = None

    def _reopen(self, now_s: float) -> bool:
        if now_s < self._retry_s:
            return False
        try:
            self._lines = self._pins.open()
        except OSError as error:
            self._lose(now_s, error)
            return False
        self._backoff.reset()
        return True

    def _lose(self, now_s: float, error: OSError) -> None:
        if str(error) != self._lost:
            log.warning("%s", error)
        self._lost, self._retry_s = str(error), now_s + self._backoff.next_s()
        self._lines = None


class GuardPort:
    """The guard process as the other end of a port: frames to its stdin, reports from its stdout."""

    def __init__(self, pins: Pins) -> None:
        self._pins = pins
        full = "-" if pins.full is None else str(pins.full)
        polarity = "low" if pins.active_low else "high"
        command = [sys.executable, "-m", "services.jetson.gate.guard", pins.chip, str(pins.enable), full, polarity]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._in, False)
        os.set_blocking(self._out, False)

    @property
    def pid(self) -> int:
        """Process id of the guard."""
        return self._process.pid

    def write(self, data: bytes) -> None:
        os.write(self._in, data)  # a full pipe raises BlockingIOError: the guard does not read

    def read(self) -> bytes:
        try:
            data = os.read(self._out, 4096)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError("the guard process has ended")
        return data

    def close(self) -> None:
        """End the guard, whatever state it is in, and make the lines inactive ourselves."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        try:
            self._pins.open().close()
        except OSError as error:
            log.warning("the lines could not be taken from the guard: %s", error)
