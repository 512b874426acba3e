"""Packets of Hesai Pandar128E3X, OT128 and QT128, written field by field from the user manuals, chapter 3.

Independent of the decoder: fields stand in the order of the manual's tables, check sums are computed bit by bit.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np

ELEVATIONS_DEG = np.linspace(14.4, -25.0, 128).round(3)
OFFSETS_DEG = np.tile([0.186, 1.343, -3.257, 0.105], 32)
ANGLES = "Channel,Elevation,Azimuth\n" + "".join(f"{k + 1},{ELEVATIONS_DEG[k]},{OFFSETS_DEG[k]}\n" for k in range(128))
OT128_FIRETIMES = "laser_id,loop0_firetime,loop1_firetime\n" + "".join(
    f"{k + 1},{(46.645, 34.067, 18.867, 6.289)[k % 4]},{(46.645, 34.067, 21.011, 6.289)[k % 4]}\n" for k in range(128)
)
PANDAR128_FIRETIMES = "distance 2.85 m" + "," * 16 + "\n" + "mode," * 16 + "x\n" + "Channel" + ",far,near" * 8 + "\n"
PANDAR128_FIRETIMES += "".join(
    f"{k + 1}," + ",".join(f"{1000 * c + 100 * (k % 10)},{1000 * c + 100 * (k % 10) + 765}" for c in range(8)) + "\n"
    for k in range(128)
)
QT128_FIRETIMES = "EEFF,1,1\nLoop Num,2,x,2\n" + "Laser ID,time,Laser ID,time\n"
QT128_FIRETIMES += "".join(f"{k + 1},{0.6 + 0.7 * k:.3f},{k + 1},{1.2 + 0.7 * k:.3f}\n" for k in range(128))


def crc(data: bytes, mpeg2: bool) -> int:
    """CRC-32 or CRC-32/MPEG-2, bit by bit from their definition."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte << 24 if mpeg2 else byte
        for _ in range(8):
            if mpeg2:
                value = (value << 1 ^ (0x04C11DB7 if value & 0x80000000 else 0)) & 0xFFFFFFFF
            else:
                value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
    return value if mpeg2 else value ^ 0xFFFFFFFF


@dataclass(frozen=True)
class Packet:
    """What the sensor says in one packet. ``steps`` and ``reflectivity`` are (2, 128), ``azimuth`` in 0.01 degrees."""

    qt128: bool = False
    azimuth: tuple[int, int] = (0, 20)
    steps: np.ndarray = field(default_factory=lambda: np.full((2, 128), 2500))
    reflectivity: np.ndarray = field(default_factory=lambda: np.full((2, 128), 77))
    unit_mm: int = 4
    confidence: bool = False
    sequence: int | None = 1
    imu: bool = False
    safety_state: int | None = 1
    signature: bool = False
    states: tuple[int, int] = (0, 0)
    operation: int = 2
    mode: int = 0x37
    mode_flag: int = 1
    rpm: int = 600
    microsecond: int = 0
    checks: bool = True

    def build(self) -> bytes:
        """Its bytes."""
        flags = (self.sequence is not None) | self.imu << 1 | (self.safety_state is not None) << 2
        flags |= self.signature << 3 | self.confidence << 4
        returns = 2 if self.mode >= 0x39 else 1
        packet = b"\xee\xff" + bytes((3, 2) if self.qt128 else (1, 4)) + b"\0\0"  # pre-header
        packet += bytes([128, 2, returns - 1, self.unit_mm, returns, flags])  # header
        body = b""
        for block in range(2):
            body += struct.pack("<H", self.azimuth[block])
            for k in range(128):
                body += struct.pack("<HB", self.steps[block, k], self.reflectivity[block, k])
                body += b"\x2a" if self.qt128 or self.confidence else b""
        packet += body + self._crc(body)
        if self.safety_state is not None:
            safety = bytes([self.safety_state << 5 | 1 << 3 | 5, 0x11]) + struct.pack("<H", 0x1234)
            reserved = bytes(8)
            packet += b"\0" + safety + reserved + self._crc(safety + reserved if self.qt128 else safety)
        tail = self._tail()
        packet += tail + self._crc(tail)
        return packet + (b"\x55" * 32 if self.signature else b"")

    def _tail(self) -> bytes:
        date = bytes([126, 11, 25, 16, 59, 58])  # year - 1900, month, day, hour, minute, second
        if self.qt128:
            tail = bytes(5) + bytes([self.mode_flag]) + bytes(6) + bytes([self.mode])
        else:
            tail = bytes(9) + struct.pack("<H", self.states[0] << 14 | self.states[1] << 12)
            tail += bytes([self.operation, self.mode])
        tail += struct.pack("<H", self.rpm) + date + struct.pack("<IB", self.microsecond, 0x42)
        tail += struct.pack("<I", self.sequence) if self.sequence is not None else b""
        return tail + (struct.pack("<hHHI6h", 2500, 122, 140, 99, 1, -2, 3, -4, 5, -6) if self.imu else b"")

    def _crc(self, data: bytes) -> bytes:
        return struct.pack("<I", crc(data, mpeg2=self.qt128)) if self.checks else b"\0\0\0\0"


def points_of(packet: Packet, firetime_s: np.ndarray) -> np.ndarray:
    """(2, 128, 3) m: slow and plain, one channel after the other, as the manual's formulas have it.

    firetime_s: (2, 128) of both blocks.
    """
    points = np.zeros((2, 128, 3))
    for block in range(2):
        for k in range(128):
            distance = packet.steps[block, k] * packet.unit_mm / 1000.0
            degrees = packet.azimuth[block] / 100.0 + OFFSETS_DEG[k] + firetime_s[block, k] * packet.rpm / 60.0 * 360.0
            azimuth, elevation = np.radians(degrees), np.radians(ELEVATIONS_DEG[k])
            flat = distance * np.cos(elevation)
            points[block, k] = flat * np.sin(azimuth), flat * np.cos(azimuth), distance * np.sin(elevation)
    return points
