"""LD06 bytes in any chunking -> packets of twelve returns.

Layout, all little endian (LDROBOT LD06 development manual v1.0, section "Data protocol")::

    0    1        2      4      6 .. 41                            42     44         46
    54   2C       speed  start  12 x (distance u16, confidence u8) end    timestamp  CRC-8
    header  length deg/s  0.01°  mm                                 0.01°  ms

The sensor counts angles clockwise seen from above. They are turned round here and nowhere else: ``angles_rad`` is
counter-clockwise. No I/O, no clock.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

HEADER = b"\x54\x2c"
PACKET_BYTES = 47
POINTS = 12
CRC_POLYNOMIAL = 0x4D  # x^8 + x^6 + x^3 + x^2 + 1, initial value 0, not reflected
OLDEST_SAMPLE_RATE_HZ = 2300.0  # the firmware behind the manual's printed example; today's is 4500
MAX_SPEED_DPS = 20 * 360  # the data sheet's fastest is 13 turns a second
MAX_TIMESTAMP_MS = 30_000
BLOCK_BYTES = 1 << 20  # one step of a long feed, which bounds its memory

PACKET_DTYPE = np.dtype(
    [
        ("header", "u1", 2),
        ("speed_dps", "<u2"),
        ("start_cdeg", "<u2"),
        ("points", [("distance_mm", "<u2"), ("confidence", "u1")], POINTS),
        ("end_cdeg", "<u2"),
        ("timestamp_ms", "<u2"),
        ("crc", "u1"),
    ]
)


def crc_table(polynomial: int = CRC_POLYNOMIAL) -> np.ndarray:
    """(256,) uint8: the CRC of each single byte."""
    table = np.arange(256)
    for _ in range(8):
        table = ((table << 1) ^ np.where(table & 0x80, polynomial, 0)) & 0xFF
    return table.astype(np.uint8)


def _position_tables() -> np.ndarray:
    """(46 * 256,) uint8: what a byte at each position adds to the packet's CRC.

    A CRC with initial value 0 is linear over XOR: the CRC of a message is the XOR of the CRCs of its bytes, each
    followed by as many zeros as there are bytes behind it. So one look-up a byte and one XOR along the row do.
    """
    single = crc_table()
    rows = [single]
    for _ in range(PACKET_BYTES - 2):
        rows.append(single[rows[-1]])  # one more zero behind it
    return np.concatenate(rows[::-1])


_TABLES = _position_tables()
_ROW = np.arange(PACKET_BYTES - 1, dtype=np.intp) * 256
_BYTE = np.arange(PACKET_BYTES, dtype=np.intp)


def crc8(rows: np.ndarray) -> np.ndarray:
    """(K,) uint8 CRC of each row of (K, 46) uint8."""
    return np.asarray(np.bitwise_xor.reduce(_TABLES[rows + _ROW], axis=1))


@dataclass(frozen=True, slots=True)
class Packet:
    """Twelve returns in the order they were measured."""

    speed_dps: int
    start_deg: float  # clockwise, as the sensor counts; of the first return
    end_deg: float  # of the last return
    timestamp_ms: int  # the sensor's own clock, 0 .. 30000
    angles_rad: np.ndarray  # (12,) float64, counter-clockwise from the sensor's arrow, in [-2 pi, 2 pi], not wrapped
    distances_mm: np.ndarray  # (12,) uint16; 0 = no return
    confidence: np.ndarray  # (12,) uint8

    @property
    def ranges_m(self) -> np.ndarray:
        """(12,) float64 metres; 0 = no return."""
        return self.distances_mm * 1e-3

    @property
    def angles_deg(self) -> np.ndarray:
        """(12,) degrees as the sensor counts them: clockwise (unless told otherwise), in [0, 360)."""
        step_deg = (self.end_deg - self.start_deg) % 360.0 / (POINTS - 1)
        return (self.start_deg + step_deg * np.arange(POINTS)) % 360.0


class Ld06Parser:
    """Feed it any pieces of the stream; it returns the packets that are complete and believable.

    After a bad packet the search goes on at the next byte, not at the next packet, so that a true header inside
    garbage is never skipped. ``counters`` says what was rejected and why; it does not depend on the chunking.

    Args:
        sample_rate_hz: returns a second. It bounds the angle a packet may span at its speed (vendor SDK: 1.5 x).
            The default suits every firmware known; the service passes the LD06's own 4500.
        clockwise: False for a unit that counts the other way round.
    """

    def __init__(self, sample_rate_hz: float = OLDEST_SAMPLE_RATE_HZ, clockwise: bool = True) -> None:
        self.counters: Counter[str] = Counter()
        self._degrees_per_speed = POINTS / sample_rate_hz * 1.5
        self._sign = -1.0 if clockwise else 1.0
        self._rest = b""

    @property
    def pending(self) -> int:
        """Bytes of a packet that is not complete yet."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that ``data`` completes."""
        packets: list[Packet] = []
        for at in range(0, len(data), BLOCK_BYTES):
            packets += self._feed_block(data[at : at + BLOCK_BYTES])
        return packets

    def _feed_block(self, data: bytes) -> list[Packet]:
        buffer = self._rest + data
        stream = np.frombuffer(buffer, np.uint8)
        rows, starts = self._accept(stream)
        consumed = self._keep_tail(buffer, int(starts[-1]) + PACKET_BYTES if len(starts) else 0)
        self.counters["packets"] += len(starts)
        self.counters["skipped_bytes"] += consumed - PACKET_BYTES * len(starts)
        return self._decode(rows) if len(starts) else []

    def _accept(self, stream: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(records of the accepted packets, where they start), each the first believable one behind its predecessor."""
        last = max(len(stream) - PACKET_BYTES + 1, 0)
        heads = np.flatnonzero((stream[:last] == HEADER[0]) & (stream[1 : last + 1] == HEADER[1]))
        if not len(heads):
            return np.empty(0, PACKET_DTYPE), heads
        windows = stream[heads[:, None] + _BYTE]
        sums_match = crc8(windows[:, :-1]) == windows[:, -1]
        records = windows.view(PACKET_DTYPE)[:, 0]
        faults = self._implausible(records)
        good = sums_match & ~np.any(list(faults.values()), axis=0)
        accepted = _without_overlap(heads, good)
        if len(accepted) < len(heads):
            self._count(heads, heads[accepted], sums_match, faults)
        return records[accepted], heads[accepted]

    def _implausible(self, records: np.ndarray) -> dict[str, np.ndarray]:
        """Per fault (K,) bool: fields that no LD06 sends, whatever the CRC says."""
        start, end, speed = records["start_cdeg"], records["end_cdeg"], records["speed_dps"]
        span_deg = (end.astype(np.int32) - start) % 36_000 // 100  # whole degrees, as the vendor's SDK compares
        return {
            "angle_range": (start >= 36_000) | (end >= 36_000),
            "speed_range": speed > MAX_SPEED_DPS,
            "timestamp_range": records["timestamp_ms"] > MAX_TIMESTAMP_MS,
            "angle_span": span_deg > speed * self._degrees_per_speed,
        }

    def _count(
        self, heads: np.ndarray, accepted: np.ndarray, sums_match: np.ndarray, faults: dict[str, np.ndarray]
    ) -> None:
        """Count rejected candidates, except header bytes that are payload of an accepted packet."""
        before = np.searchsorted(accepted, heads, side="right") - 1
        outside = before < 0
        if len(accepted):
            outside |= heads >= accepted[before] + PACKET_BYTES
        self.counters["crc"] += int(np.count_nonzero(outside & ~sums_match))
        open_cases = outside & sums_match
        for name, fault in faults.items():  # one packet, one fault
            self.counters[name] += int(np.count_nonzero(open_cases & fault))
            open_cases &= ~fault

    def _keep_tail(self, buffer: bytes, done: int) -> int:
        """Keep what may still become a packet, at most 46 bytes; return how many bytes are done with."""
        at = buffer.find(HEADER, max(done, len(buffer) - PACKET_BYTES + 1))
        if at < 0:
            cut_header = len(buffer) > done and buffer[-1] == HEADER[0]
            at = len(buffer) - 1 if cut_header else len(buffer)
        self._rest = buffer[at:]
        return at

    def _decode(self, records: np.ndarray) -> list[Packet]:
        start_deg, end_deg = records["start_cdeg"] / 100.0, records["end_cdeg"] / 100.0
        step_deg = (end_deg - start_deg) % 360.0 / (POINTS - 1)
        angles_rad = self._sign * np.radians(start_deg[:, None] + step_deg[:, None] * np.arange(POINTS))
        columns = (
            records["speed_dps"].tolist(),
            start_deg.tolist(),
            end_deg.tolist(),
            records["timestamp_ms"].tolist(),
            angles_rad,
            records["points"]["distance_mm"],
            records["points"]["confidence"],
        )
        return [Packet(*fields) for fields in zip(*columns, strict=True)]


def _without_overlap(heads: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Indices of the good candidates, first come first served, none inside another."""
    candidates = np.flatnonzero(good)
    starts = heads[candidates]
    if len(starts) < 2 or np.diff(starts).min() >= PACKET_BYTES:
        return candidates
    chosen, free = [], -1
    for index, start in zip(candidates.tolist(), starts.tolist(), strict=True):
        if start >= free:
            chosen.append(index)
            free = start + PACKET_BYTES
    return np.array(chosen, dtype=np.intp)
