"""Permissions as frames over a serial port, and what the microcontroller answers."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Protocol

import serial

from common.backoff import Backoff
from common.serial_port import PORT_ERRORS, explain
from common.source_url import SourceUrl
from services.jetson.gate.config import GateConfig
from services.jetson.gate.frames import FRAMES_STOPPED, Report, ReportReader, permission_frame
from services.jetson.gate.pipeline import STOPPED, Decision

log = logging.getLogger(__name__)

REPORTS_LATE_S = 0.5  # a microcontroller reports every 0.1 s; a busy USB is no reason to stop
START_S = 2.0  # a process that starts, or a board that resets when the port is opened
OBEYS_WITHIN_S = 0.25  # between what it is told and what it says that it does
WRITE_TIMEOUT_S = 0.02
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 2.0
RANK = {"STOP": 0, "SLOW": 1, "GO": 2}


class Port(Protocol):
    """Bytes to and from an actuator. ``write`` and ``read`` return at once and raise ``OSError`` when it is gone."""

    def write(self, data: bytes) -> None:
        """Send all of it."""

    def read(self) -> bytes:
        """What has come since the last call."""

    def close(self) -> None:
        """Let go of the device."""


class SerialPort:
    """A serial device as a ``Port``."""

    def __init__(self, device: str, baud: int) -> None:
        self._serial = serial.Serial(device, baud, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=True)

    def write(self, data: bytes) -> None:
        self._serial.write(data)

    def read(self) -> bytes:
        return bytes(self._serial.read(self._serial.in_waiting))

    def close(self) -> None:
        self._serial.close()


class FramedOutput:
    """Speaks the frames of ``frames`` over a port that may come and go.

    Args:
        open_port: raises ``OSError`` while the device is away.
        reports: the actuator answers; without answers only the writing can fail.
        late_s: after this long without a report the port is closed and opened again.
    """

    hold_s = 0.02  # one round of the firmware's loop, the frame's time on the wire, a relay that lets go

    def __init__(
        self,
        url: SourceUrl,
        open_port: Callable[[], Port],
        permit_s: float,
        *,
        reports: bool = True,
        late_s: float = REPORTS_LATE_S,
    ) -> None:
        self.url = url
        self._open_port, self._permit_s = open_port, permit_s
        self._reports, self._late_s = reports, late_s
        self._port: Port | None = None
        self._backoff, self._retry_s = Backoff(FIRST_PAUSE_S, LONGEST_PAUSE_S), 0.0
        self._lost, self._was_open = "not opened yet", False
        self._seq = 0
        self._reader = ReportReader()
        self._report: Report | None = None
        self._report_s = self._opened_s = 0.0
        self._presses: int | None = None
        self._new_presses = 0
        self._sent_ranks: list[tuple[float, int]] = []  # what it was told lately: (time, rank)

    def send(self, now_s: float, decision: Decision, verdict_seq: int) -> None:
        """Send the decision as one frame and take what the actuator answers."""
        if self._port is None and not self._reopen(now_s):
            return
        assert self._port is not None
        self._seq = (self._seq + 1) & 0xFF
        try:
            self._port.write(permission_frame(self._seq, decision, self._permit_s, verdict_seq))
        except PORT_ERRORS as error:
            self._lose(now_s, explain(self.url.target, error, self._was_open))
            return
        self._sent_ranks.append((now_s, RANK[decision.permission]))
        self._sent_ranks = [one for one in self._sent_ranks if now_s - one[0] <= OBEYS_WITHIN_S]
        self.listen(now_s)

    def listen(self, now_s: float) -> None:
        """Take the actuator's reports; one that is silent for too long counts as lost."""
        if self._port is None:
            return
        try:
            self._take(now_s, self._port.read())
        except PORT_ERRORS as error:
            self._lose(now_s, explain(self.url.target, error, self._was_open))
            return
        silent_s = now_s - max(self._report_s, self._opened_s)
        if self._reports and silent_s > (self._late_s if self._report else START_S):
            self._lose(now_s, f"{self.url}: the actuator has not answered for {silent_s:.1f} s")

    def fault(self, now_s: float) -> str:
        """Why the actuator does not do what it is told: away, silent, stopped by itself, or more than allowed."""
        if self._port is None:
            return self._lost
        if not self._reports:
            return ""
        if self._report is None:
            return f"{self.url}: the actuator has not answered yet"
        if self._report.why == FRAMES_STOPPED:
            return f"{self.url}: the actuator stopped by itself: {self._report.why}"
        if self._sent_ranks and RANK[self._report.permission] > max(rank for _, rank in self._sent_ranks):
            return f"{self.url}: the actuator does {self._report.permission} although it was told less"
        return ""

    def presses(self) -> int:
        taken, self._new_presses = self._new_presses, 0
        return taken

    def words(self) -> str:
        if self._report is None:
            return ""
        refused = f", {self._report.refused} frames refused" if self._report.refused else ""
        return f"{self._report.permission} ({self._report.why}){refused}"

    def close(self) -> None:
        if self._port is not None:
            try:
                self._seq = (self._seq + 1) & 0xFF
                self._port.write(permission_frame(self._seq, STOPPED, self._permit_s))
            except PORT_ERRORS as error:
                log.warning("%s: could not say STOP at the end: %s", self.url, error)
            self._close_port()

    def _reopen(self, now_s: float) -> bool:
        if now_s < self._retry_s:
            return False
        try:
            self._port = self._open_port()
        except PORT_ERRORS as error:
            self._lose(now_s, explain(self.url.target, error, self._was_open))
            return False
        self._was_open, self._opened_s, self._report, self._presses = True, now_s, None, None
        self._reader, self._sent_ranks = ReportReader(), []
        self._backoff.reset()
        log.info("%s is open", self.url)
        return True

    def _lose(self, now_s: float, reason: str) -> None:
        if reason != self._lost:
            log.warning("%s", reason)
        self._lost, self._retry_s = reason, now_s + self._backoff.next_s()
        self._close_port()

    def _close_port(self) -> None:
        if self._port is not None:
            self._port.close()
        self._port = None

    def _take(self, now_s: float, data: bytes) -> None:
        for report in self._reader.feed(data):
            self._report, self._report_s = report, now_s
            if self._presses is not None:
                self._new_presses += (report.presses - self._presses) & 0xFF
            self._presses = report.presses


def serial_output(url: SourceUrl, config: GateConfig) -> FramedOutput:
    """``serial:/dev/ttyACM0?baud=115200&reports=1``. Raises ``ConfigError`` for a baud rate that is no number."""
    baud = int(url.number("baud", 115200))
    reports = url.flag("reports") if "reports" in url.params else True
    return FramedOutput(url, lambda: SerialPort(url.target, baud), config.limits.permit_s, reports=reports)
