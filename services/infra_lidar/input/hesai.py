"""Hesai Pandar128E3X, OT128 (UDP protocol 1.4) and QT128 (3.2) packets to ranges. Bytes in, arrays out; no I/O.

Layout from the user manuals (Pandar128E3X 128-en-240110, OT128 O01-en-240310, QT128C2X, chapter 3): header, two blocks
of azimuth (0.01 degrees) and 128 times distance, reflectivity and, where the flags say so, a fourth byte; check sum;
functional safety where the flags say so; tail. All little endian. Read side by side with the vendor's SDK 2.0, Nebula
and hydra4. Where they disagree:

- Fourth byte of a channel: the E3X manual's flag is bit 4 (confidence), hydra4's for the OT128 is bit 5 (noise), QT128
  always has it (manual, Nebula) or by bit 4 (SDK). Here the length of the packet decides.
- Unit of distance: 4 mm in Nebula's notes and hydra4; here as in the SDK what the header says, in millimetres.
- Direction of a channel: block azimuth + offset + firing time x speed, as the SDK has it. Nebula and hydra4 leave the
  last out, 0.2 degrees at 600 rpm.
- First azimuth state: bits 15 and 14 of the little-endian word (manual, Nebula, hydra4, SDK alike).
- QT128 loop: block 1 and 2 are loop 1 and 2 in a single-return mode (manual); with two returns an odd mode flag is loop
  1 (SDK, Nebula).
- Parallax of the lens (some cm) is off in the SDK by default and in no other: left out.

The sensor frame is the vendor's: azimuth 0 is y, clockwise seen from above.
"""

from __future__ import annotations

from functools import lru_cache
from struct import Struct
from typing import NamedTuple

import numpy as np

from services.infra_lidar.input.hesai_calibration import (
    CHANNELS,
    PANDAR128_PROTOCOL,
    QT128_PROTOCOL,
    HesaiCalibration,
    read_metadata,
)
from services.infra_lidar.input.range_image import RangeImage, RangeImageArrays
from services.infra_lidar.input.spinning import PacketHead, SensorFormat
from services.infra_lidar.input.velodyne import COS_SIN
from services.infra_lidar.jit import kernel

SINGLE_RETURNS = (0x33, 0x34, 0x37, 0x38)
DUAL_RETURNS = (0x39, 0x3A, 0x3B, 0x3C, 0x3E)
BODY_AT, BLOCKS = 12, 2
SAFETY_BYTES, TAIL_BYTES, SEQUENCE_BYTES, IMU_BYTES, CHECK_BYTES, SIGNATURE_BYTES = 17, 26, 4, 22, 4, 32
SEQUENCE, IMU, SAFETY, SIGNATURE = 1, 2, 4, 8  # flags
SELECTED_CHANNELS = 64  # of a QT128: its blocks hold channels of a table that is not in the packet; not read
HIGH_RESOLUTION = 0  # operational state of the E3X and OT128
BLOCK_US = {PANDAR128_PROTOCOL: 55.556, QT128_PROTOCOL: 111.11}
MAX_RPM = 3000
MAX_UNIT_MM = 8
PERIOD, FARTHEST = 1 << 32, 1_000_000  # of a sequence number, or of microseconds of the minute where it is off
_START = b"\xee\xff"
_TAIL = Struct("<5xB3xHBBH5xBI")  # mode flag, azimuth state, operational state, return mode, rpm, second, microsecond
_U16, _U32 = Struct("<H"), Struct("<I")


class HesaiLayout(NamedTuple):
    """Where things lie in a packet; ``safety_at`` and ``sequence_at`` are 0 where there are none."""

    version: int  # of the protocol, major
    unit_bytes: int
    safety_at: int
    tail_at: int
    sequence_at: int
    check_at: int  # check sum of the tail

    @property
    def block_bytes(self) -> int:
        """Bytes of one block: azimuth and all channels."""
        return 2 + CHANNELS * self.unit_bytes

    @property
    def body_end(self) -> int:
        """First byte behind the blocks."""
        return BODY_AT + BLOCKS * self.block_bytes


@lru_cache(maxsize=256)
def _layout(major: int, minor: int, flags: int, length: int) -> HesaiLayout | None:
    if (major, minor) not in BLOCK_US or ((major, minor) == QT128_PROTOCOL and flags & SELECTED_CHANNELS):
        return None
    for unit in (3, 4):
        safety_at = BODY_AT + BLOCKS * (2 + CHANNELS * unit) + CHECK_BYTES
        tail_at = safety_at + (SAFETY_BYTES if flags & SAFETY else 0)
        sequence_at = tail_at + TAIL_BYTES
        imu_at = sequence_at + (SEQUENCE_BYTES if flags & SEQUENCE else 0)
        check_at = imu_at + (IMU_BYTES if flags & IMU and major == 1 else 0)
        if length == check_at + CHECK_BYTES + (SIGNATURE_BYTES if flags & SIGNATURE else 0):
            safety_at, sequence_at = safety_at if flags & SAFETY else 0, sequence_at if flags & SEQUENCE else 0
            return HesaiLayout(major, unit, safety_at, tail_at, sequence_at, check_at)
    return None


def layout_of(packet: bytes) -> HesaiLayout | None:
    """Layout of a packet; None if it is none of these sensors, or its length and its flags disagree."""
    if len(packet) < BODY_AT or packet[:2] != _START or packet[6] != CHANNELS or packet[7] != BLOCKS:
        return None
    return _layout(packet[2], packet[3], packet[11], len(packet))


def is_dual(packet: bytes) -> bool:
    """Whether two returns of each beam are in it. ``packet`` is one of these sensors."""
    layout = layout_of(packet)
    return layout is not None and _TAIL.unpack_from(packet, layout.tail_at)[3] in DUAL_RETURNS


def head(packet: bytes) -> PacketHead | None:
    """Where a packet lies, by its sequence number or, where that is off, microseconds. None: not of these sensors."""
    layout = layout_of(packet)
    if layout is None or not 0 < packet[9] <= MAX_UNIT_MM:
        return None
    first, last = _U16.unpack_from(packet, BODY_AT)[0], _U16.unpack_from(packet, BODY_AT + layout.block_bytes)[0]
    _, _, operation, mode, rpm, second, microsecond = _TAIL.unpack_from(packet, layout.tail_at)
    dual = mode in DUAL_RETURNS
    if first >= 36000 or last >= 36000 or not (dual or mode in SINGLE_RETURNS) or not 0 < rpm <= MAX_RPM:
        return None
    if layout.sequence_at:
        return PacketHead(first / 100.0, last / 100.0, _U32.unpack_from(packet, layout.sequence_at)[0], 1.0)
    block_us = BLOCK_US[packet[2], packet[3]]
    if layout.version == PANDAR128_PROTOCOL[0] and operation == HIGH_RESOLUTION:
        block_us /= 2.0
    return PacketHead(first / 100.0, last / 100.0, second * 1_000_000 + microsecond, block_us * (1.0 if dual else 2.0))


def silent_packet() -> bytes:
    """A packet of protocol 1.4 without a return, for a kernel to be compiled with."""
    header = _START + bytes([*PANDAR128_PROTOCOL, 0, 0, CHANNELS, BLOCKS, 0, 4, 1, 0])
    return header.ljust(BODY_AT + BLOCKS * (2 + 3 * CHANNELS) + CHECK_BYTES + TAIL_BYTES + CHECK_BYTES, b"\0")


def hesai_format(metadata: str) -> SensorFormat:
    """The packet format of a sensor with the calibration in ``metadata``, see ``hesai_calibration.as_metadata``.

    Raises:
        CalibrationError: it is no calibration of a Hesai sensor of 128 channels.
    """
    sensor = _Hesai(read_metadata(metadata))
    return SensorFormat("hesai", sensor.heads, sensor.decode, PERIOD, FARTHEST, metadata)


class _Hesai:
    """One sensor with its calibration."""

    def __init__(self, calibration: HesaiCalibration) -> None:
        self._calibration = calibration
        self._beams: dict[tuple[int, int], np.ndarray] = {}  # by protocol and speed, of which there are few

    def heads(self, raw: np.ndarray) -> np.ndarray:
        """Where packets (P, B) uint8 lie, see ``SensorFormat``: none where the firing times are of another model."""
        known, none = self._calibration.protocol, (np.nan,) * 4
        packets = [row.tobytes() for row in raw]
        ours = [known is None or tuple(packet[2:4]) == known for packet in packets]
        rows = [head(packet) or none if own else none for packet, own in zip(packets, ours, strict=True)]
        return np.array(rows, np.float64).reshape(-1, 4)

    def decode(self, raw: np.ndarray) -> RangeImage:
        """The rows of packets (P, B) uint8 of one layout, one for each block. See ``SensorFormat``."""
        n = len(raw) * BLOCKS
        range_m, intensity = np.empty((n, CHANNELS), np.float32), np.empty((n, CHANNELS), np.uint8)
        cos, sin, bank = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.uint8)
        layout = layout_of(raw[0].tobytes()) if n else None
        version = layout.version if layout else PANDAR128_PROTOCOL[0]
        m, rpm = 0, 0
        if layout is not None:
            rpm = _median_rpm(raw, layout.tail_at + 13)
            places = np.array([layout.unit_bytes, layout.tail_at, layout.version], np.int64)
            m = _decode(raw, places, COS_SIN, RangeImageArrays(range_m, intensity, cos, sin, bank, range_m))
        return RangeImage(range_m[:m], intensity[:m], cos[:m], sin[:m], bank[:m], self._beams_at(version, rpm))

    def _beams_at(self, version: int, rpm: int) -> np.ndarray:
        """(7, S x 128) float32 of all firing orders, as in ``RangeImage``, while the head turns with ``rpm``."""
        beams = self._beams.get((version, rpm))
        if beams is None:
            if len(self._beams) > 64:
                self._beams.clear()
            beams = self._beams[version, rpm] = _beams(self._calibration, version, rpm)
        return beams


def _beams(calibration: HesaiCalibration, version: int, rpm: int) -> np.ndarray:
    firetime_s = calibration.firetimes_for(PANDAR128_PROTOCOL if version == PANDAR128_PROTOCOL[0] else QT128_PROTOCOL)
    turned = np.radians(calibration.azimuth_deg + firetime_s * rpm * 6.0)
    elevation = np.broadcast_to(np.radians(calibration.elevation_deg), turned.shape)
    ring = np.broadcast_to(np.argsort(np.argsort(calibration.elevation_deg, kind="stable")), turned.shape)
    flat, none = np.cos(elevation), np.zeros(turned.shape)
    direction = [flat * np.cos(turned), -flat * np.sin(turned), np.sin(elevation)]  # turns clockwise from above
    return np.stack([*direction, none, none, none, ring]).reshape(7, -1).astype(np.float32)


@kernel
def _median_rpm(raw: np.ndarray, at: int) -> int:
    """Median speed of the head over packets (P, B) uint8, from the two bytes at ``at``, in revolutions per minute."""
    rpm = np.empty(raw.shape[0], np.int64)
    for p in range(len(rpm)):
        rpm[p] = raw[p, at] + 256 * raw[p, at + 1]
    return int(np.median(rpm))


@kernel
def _decode(raw: np.ndarray, places: np.ndarray, cos_sin: np.ndarray, rows: RangeImageArrays) -> int:
    """Write packets (P, B) uint8 to rows, one for each block; returns the number of rows.

    places: bytes of a channel, start of the tail, version. A second return at the range of the first is none.
    """
    unit, tail, version = places[0], places[1], places[2]
    m = 0
    for p in range(raw.shape[0]):
        step_m = np.float32(raw[p, 9]) * np.float32(0.001)
        dual, operation = raw[p, tail + 12] >= 0x39, raw[p, tail + 11] & 15
        for block in range(2):
            at = 12 + block * (2 + 128 * unit)
            azimuth = raw[p, at] + 256 * raw[p, at + 1]
            if azimuth >= 36000:
                break
            state = raw[p, tail + 10] >> (6 - 2 * block) & 3
            if version == 1:
                rows.bank[m] = state if operation == 0 else (6 if operation == 3 else 4) + (state & 1)
            else:
                rows.bank[m] = 1 - (raw[p, tail + 5] & 1) if dual else block
            rows.cos[m], rows.sin[m] = cos_sin[azimuth, 1], cos_sin[azimuth, 0]  # azimuth 0 is y
            for k in range(128):
                byte = at + 2 + unit * k
                range_m = np.float32(raw[p, byte] + 256 * raw[p, byte + 1]) * step_m
                again = dual and block == 1 and range_m == rows.range_m[m - 1, k]
                rows.range_m[m, k] = np.float32(0.0) if again else range_m
                rows.intensity[m, k] = raw[p, byte + 2]
            m += 1
    return m
