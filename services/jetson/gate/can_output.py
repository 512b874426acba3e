"""Permissions as CAN frames (python-can, extra ``vehicle``). The layout is also in ``gate.dbc``.

    0    CRC-8/SAE-J1850 of bytes 1 to 7
    1    sequence number modulo 256
    2    0x00 STOP, 0x55 SLOW, 0xAA GO
    3-4  speed limit, mm/s, little-endian
    5    expiry, ms after arrival, at most 250
    6    version, 1
    7    0

Whoever acts on it stops when a frame is late, repeated or wrong, as the serial firmware does.
"""

from __future__ import annotations

import logging
import struct
from typing import Any

from common.backoff import Backoff
from common.config import ConfigError
from common.source_url import SourceUrl
from services.jetson.gate.config import GateConfig
from services.jetson.gate.frames import CODES, MAX_EXPIRY_MS, MAX_MM_S, VERSION
from services.jetson.gate.pipeline import STOPPED, Decision

log = logging.getLogger(__name__)

DEFAULT_ID = 0x0C0
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 2.0


def crc8_j1850(data: bytes) -> int:
    """CRC-8/SAE-J1850: polynomial 0x1D, initial value and final XOR 0xFF; 0x4B of b"123456789"."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1D if crc & 0x80 else crc << 1) & 0xFF
    return crc ^ 0xFF


def can_payload(seq: int, decision: Decision, stop_valid_s: float) -> bytes:
    """The eight bytes for a decision."""
    valid_s = stop_valid_s if decision.permission == "STOP" else decision.valid_s
    body = struct.pack(
        "<BBHBBB",
        seq & 0xFF,
        CODES[decision.permission],
        min(int(decision.limit_mps * 1e3), MAX_MM_S),
        min(int(valid_s * 1e3), MAX_EXPIRY_MS),
        VERSION,
        0,
    )
    return bytes((crc8_j1850(body),)) + body


class CanOutput:
    """``can:can0?id=192&interface=socketcan``.

    Raises:
        ConfigError: python-can is not installed, or an id that is no 11-bit number.
    """

    hold_s = 0.02

    def __init__(self, url: SourceUrl, config: GateConfig) -> None:
        try:
            import can
        except ImportError:
            raise ConfigError(f"output {url}: library python-can is missing: install the extra vehicle") from None
        self.url, self._can = url, can
        self._id = int(url.number("id", DEFAULT_ID))
        if not 0 <= self._id <= 0x7FF:
            raise ConfigError(f"output {url}: id={self._id}: expected 0 to {0x7FF}")
        self._interface = url.params.get("interface", "socketcan")
        self._options: dict[str, Any] = {}
        if "bitrate" in url.params:
            self._options["bitrate"] = int(url.number("bitrate", 500_000))
        self._permit_s, self._seq = config.limits.permit_s, 0
        self._bus: Any = None
        self._lost = f"{url}: not opened yet"
        self._backoff, self._retry_s = Backoff(FIRST_PAUSE_S, LONGEST_PAUSE_S), 0.0

    def send(self, now_s: float, decision: Decision, verdict_seq: int) -> None:
        """Send the decision as one CAN frame; an interface that is away is opened again in time."""
        if self._bus is None and not self._reopen(now_s):
            return
        self._seq = (self._seq + 1) & 0xFF
        data = can_payload(self._seq, decision, self._permit_s)
        try:
            self._bus.send(self._can.Message(arbitration_id=self._id, data=data, is_extended_id=False), timeout=0.0)
        except (self._can.CanError, OSError) as error:  # also: nobody on the bus acknowledges, the buffer is full
            self._lose(now_s, error)

    def listen(self, now_s: float) -> None:
        return

    def fault(self, now_s: float) -> str:
        return "" if self._bus is not None else self._lost

    def presses(self) -> int:
        return 0

    def words(self) -> str:
        return ""

    def close(self) -> None:
        if self._bus is not None:
            self.send(0.0, STOPPED, 0)
        self._close_bus()

    def _reopen(self, now_s: float) -> bool:
        if now_s < self._retry_s:
            return False
        try:
            self._bus = self._can.Bus(channel=self.url.target, interface=self._interface, **self._options)
        except (self._can.CanError, OSError, ValueError) as error:
            self._lose(now_s, error)
            return False
        self._backoff.reset()
        log.info("%s is open", self.url)
        return True

    def _lose(self, now_s: float, error: Exception) -> None:
        reason = (
            f"{self.url}: {error}; is the interface up (`ip link set {self.url.target} up type can bitrate 500000`)?"
        )
        if reason != self._lost:
            log.warning("%s", reason)
        self._lost, self._retry_s = reason, now_s + self._backoff.next_s()
        self._close_bus()

    def _close_bus(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
        self._bus = None
