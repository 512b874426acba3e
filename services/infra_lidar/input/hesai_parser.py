"""Hesai packets to revolutions: what their check sums and their functional safety say. Bytes in, arrays out; no I/O.

The Pandar128E3X manual has "CRC-32" and the QT128C2X manual "CRC-32/MPEG-2" of the body and of the tail, without an
example, and no open driver checks them. So none is believed before it was seen to be right: from the first packet on
whose body or tail fits one of both, that one counts, and packets in which it is wrong are dropped as damaged. UDP has
its own check sum.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence

from services.infra_lidar.input.hesai import BODY_AT, CHECK_BYTES, HesaiLayout, hesai_format, layout_of
from services.infra_lidar.input.revolution import Revolution
from services.infra_lidar.input.spinning import SpinningParser

_REVERSED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))
FIRST_BAD_STATE = 3
LIDAR_STATES = {  # of both manuals; Nebula calls 3 and 4 of the QT128 degradation and untrusted output
    3: "pre-performance degradation",
    4: "performance degradation",
    5: "pre-shutdown",
    6: "shutdown",
    7: "standby",
}


def crc32(data: bytes) -> int:
    """CRC-32 (ISO-HDLC), as in zlib."""
    return zlib.crc32(data)


def crc32_mpeg2(data: bytes) -> int:
    """CRC-32/MPEG-2: the same polynomial, most significant bit first, not inverted at the end."""
    mirrored = zlib.crc32(data.translate(_REVERSED)) ^ 0xFFFFFFFF
    return int.from_bytes(mirrored.to_bytes(4, "little").translate(_REVERSED), "big")


CHECKS: tuple[Callable[[bytes], int], ...] = (crc32, crc32_mpeg2)


class HesaiParser(SpinningParser):
    """Feed it packets; it returns whole revolutions. See ``PacketParser``.

    ``order.counters`` also holds ``packet damaged`` and each fault state that the sensor has reported.

    Raises:
        CalibrationError: ``metadata`` is no calibration of a Hesai sensor.
    """

    def __init__(self, metadata: str, cut_deg: float = 0.0) -> None:
        super().__init__(hesai_format(metadata), cut_deg)
        self._believed: dict[str, Callable[[bytes], int]] = {}  # check by part of the packet
        self._state = 0

    def feed_all(self, packets: Sequence[bytes], stamps_ns: Sequence[int]) -> list[Revolution]:
        """Packets as ``feed`` takes them, one after the other; the revolutions that ended."""
        intact = [k for k, packet in enumerate(packets) if self._is_intact(packet)]
        return super().feed_all([packets[k] for k in intact], [stamps_ns[k] for k in intact])

    def _is_intact(self, packet: bytes) -> bool:
        """Whether no check sum of a packet is wrong; what is damaged and what the sensor says of itself is counted."""
        layout = layout_of(packet)
        if layout is None:
            return True  # of another sensor
        body, tail = (BODY_AT, layout.body_end), (layout.tail_at, layout.check_at)
        if self._wrong("body", packet, *body) or self._wrong("tail", packet, *tail):
            self.order.counters["packet damaged"] += 1
            return False
        self._watch_state(packet, layout)
        return True

    def _wrong(self, part: str, packet: bytes, begin: int, end: int) -> bool:
        """Whether the check sum of a part, which follows it, is wrong. Learns which one it is."""
        data, expected = packet[begin:end], int.from_bytes(packet[end : end + CHECK_BYTES], "little")
        if part in self._believed:
            return self._believed[part](data) != expected
        for check in CHECKS:
            if check(data) == expected:
                self._believed[part] = check
        return False

    def _watch_state(self, packet: bytes, layout: HesaiLayout) -> None:
        """Count when the sensor begins to report a fault.

        The manual does not say whether the check sum covers the reserved bytes; both are tried.
        """
        at = layout.safety_at
        state = packet[at + 1] >> 5 if at else 0
        if state == self._state:
            return
        expected = int.from_bytes(packet[at + 13 : at + 17], "little")
        if at and not any(check(packet[at + 1 : end]) == expected for check in CHECKS for end in (at + 5, at + 13)):
            return
        self._state = state
        if state >= FIRST_BAD_STATE:
            self.order.counters[f"sensor reports {LIDAR_STATES[state]}"] += 1
