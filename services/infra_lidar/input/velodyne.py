"""Velodyne VLS-128 (Alpha Prime) packets to revolutions. Bytes in, arrays out; no I/O.

Layout and timing from the VLS-128 user manual (63-9483 Rev. D), chapter 9: a packet of 1206 bytes holds 12 blocks of
100 bytes (flag, azimuth in 0.01 degree, 32 x distance in 4 mm and reflectivity), a time stamp in microseconds of the
hour, return mode and product id. The flag tells which 32 of the 128 lasers a block belongs to. With two returns a
packet has one firing sequence in eight blocks, the last and the strongest return of each bank in turn, and four blocks
of padding (figure 9-3; Nebula and velodyne-decoder alike). Eight lasers fire at a time, 2.665 us apart, with a pause
after each 64; the head turns on meanwhile.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from services.infra_lidar.input.range_image import RangeImage, RangeImageArrays
from services.infra_lidar.input.spinning import SensorFormat, SpinningParser
from services.infra_lidar.jit import kernel

PACKET_BYTES, BLOCKS, BEAMS_OF_BLOCK = 1206, 12, 32
PRODUCT_VLS128 = 0xA1
DUAL_RETURN = 0x39
DISTANCE_STEP_M = 0.004
CYCLE_US, GROUP_S = 55.3, 2.665e-6  # a firing sequence of all 128 lasers, and of eight of them
FIRST_AT, DUAL_LAST_AT, LAST_AT = 2, 702, 1102  # azimuths of the first, eighth and last block
TIME_AT, MODE_AT, PRODUCT_AT = 1200, 1204, 1205
DUAL_BLOCKS = 8  # one firing sequence, each bank of lasers twice; the other four are padding
FOCUS_M = 0.0586  # the beams meet this far in front of the axis
HOUR_US = 3_600_000_000
LONGEST_GAP_US = 1_000_000

_ELEVATION_DEG = np.array([
    -11.742, -1.99, 3.4, -5.29, -0.78, 4.61, -4.08, 1.31,
    -6.5, -1.11, 4.28, -4.41, 0.1, 6.48, -3.2, 2.19,
    -3.86, 1.53, -9.244, -1.77, 2.74, -5.95, -0.56, 4.83,
    -2.98, 2.41, -6.28, -0.89, 3.62, -5.07, 0.32, 7.58,
    -0.34, 5.18, -3.64, 1.75, -25, -2.43, 2.96, -5.73,
    0.54, 9.7, -2.76, 2.63, -7.65, -1.55, 3.84, -4.85,
    3.18, -5.51, -0.12, 5.73, -4.3, 1.09, -16.042, -2.21,
    4.06, -4.63, 0.76, 15, -3.42, 1.97, -6.85, -1.33,
    -5.62, -0.23, 5.43, -3.53, 0.98, -19.582, -2.32, 3.07,
    -4.74, 0.65, 11.75, -2.65, 1.86, -7.15, -1.44, 3.95,
    -2.1, 3.29, -5.4, -0.01, 4.5, -4.19, 1.2, -13.565,
    -1.22, 4.17, -4.52, 0.87, 6.08, -3.31, 2.08, -6.65,
    1.42, -10.346, -1.88, 3.51, -6.06, -0.67, 4.72, -3.97,
    2.3, -6.39, -1, 4.39, -5.18, 0.21, 6.98, -3.09,
    4.98, -3.75, 1.64, -8.352, -2.54, 2.85, -5.84, -0.45,
    8.43, -2.87, 2.52, -6.17, -1.66, 3.73, -4.96, 0.43,
])  # fmt: skip
_OFFSET_DEG = np.tile([-6.354, -4.548, -2.732, -0.911, 0.911, 2.732, 4.548, 6.354], 16)
_GROUP = np.arange(128) // 8
_DELAY_S = GROUP_S * (_GROUP + _GROUP // 8)  # of each laser after the start of its firing sequence
RING = np.argsort(np.argsort(_ELEVATION_DEG, kind="stable")).astype(np.float32)  # 0 = lowest beam
_ELEVATION = np.radians(_ELEVATION_DEG)
_CENTIDEGREES = np.radians(np.arange(36000) / 100.0)
COS_SIN = np.stack([np.cos(_CENTIDEGREES), np.sin(_CENTIDEGREES)], axis=1).astype(np.float32)


class Vls128Parser(SpinningParser):
    """Feed it packets; it returns whole revolutions, cut where the head passes ``cut_deg``."""

    def __init__(self, cut_deg: float = 0.0) -> None:
        super().__init__(VLS128_FORMAT, cut_deg)


@kernel
def heads(raw: np.ndarray) -> np.ndarray:
    """Where packets (P, B) uint8 lie, counted in microseconds of the hour. See ``SensorFormat``."""
    rows = np.full((raw.shape[0], 4), np.nan)
    if raw.shape[1] != PACKET_BYTES:
        return rows
    for p in range(raw.shape[0]):
        dual = raw[p, MODE_AT] == DUAL_RETURN
        last_at = DUAL_LAST_AT if dual else LAST_AT
        first, last = raw[p, FIRST_AT] + 256 * raw[p, FIRST_AT + 1], raw[p, last_at] + 256 * raw[p, last_at + 1]
        if raw[p, PRODUCT_AT] == PRODUCT_VLS128 and first < 36000 and last < 36000:
            time_us = 0
            for k in range(4):
                time_us += raw[p, TIME_AT + k] << 8 * k
            rows[p, 0], rows[p, 1], rows[p, 2] = first / 100.0, last / 100.0, time_us
            rows[p, 3] = CYCLE_US if dual else 3.0 * CYCLE_US
    return rows


def decode(raw: np.ndarray) -> RangeImage:
    """The rows of packets (P, 1206) uint8, one for each valid block."""
    n = len(raw) * BLOCKS
    range_m, intensity = np.empty((n, BEAMS_OF_BLOCK), np.float32), np.empty((n, BEAMS_OF_BLOCK), np.uint8)
    cos, sin, bank = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.uint8)
    image = RangeImage(range_m, intensity, cos, sin, bank, _beams(_head_speed_deg_per_s(raw)))
    m = _decode(raw, COS_SIN, image.arrays)
    return RangeImage(range_m[:m], intensity[:m], cos[:m], sin[:m], bank[:m], image.beams)


VLS128_FORMAT = SensorFormat("velodyne", heads, decode, HOUR_US, LONGEST_GAP_US)
DECODER = VLS128_FORMAT.decoder


@lru_cache(maxsize=64)
def _beams(speed_deg_per_s: float) -> np.ndarray:
    """(7, 128) float32, see ``RangeImage``. Azimuths come in hundredths of a degree, so there are only few speeds."""
    turned = np.radians(speed_deg_per_s * _DELAY_S - _OFFSET_DEG)  # since the block began
    flat, none = np.cos(_ELEVATION), np.zeros(len(_ELEVATION))
    direction = [flat * np.cos(turned), -flat * np.sin(turned), np.sin(_ELEVATION)]  # turns clockwise from above
    return np.stack([*direction, none, none, -FOCUS_M * np.tan(_ELEVATION), RING]).astype(np.float32)


@kernel
def _head_speed_deg_per_s(raw: np.ndarray) -> float:
    """Median speed of the head over packets (P, 1206) uint8, from the azimuths in each, or from one to the next."""
    one = raw.shape[0] > 0 and raw[0, MODE_AT] == DUAL_RETURN  # a packet is one firing sequence, else three
    steps = np.empty(max(raw.shape[0] - 1, 0) if one else raw.shape[0], np.float64)  # 0.01 degree
    for p in range(len(steps)):
        here, there = raw[p, 2] + 256 * raw[p, 3], raw[p, LAST_AT] + 256 * raw[p, LAST_AT + 1]
        steps[p] = (raw[p + 1, 2] + 256 * raw[p + 1, 3] - here) % 36000 if one else (there - here) % 36000 / 2.0
    return np.median(steps) / (100.0 * CYCLE_US * 1e-6) if len(steps) else 0.0


@kernel
def _decode(raw: np.ndarray, cos_sin: np.ndarray, rows: RangeImageArrays) -> int:
    """Write packets (P, 1206) uint8 to rows, one for each valid block; returns the number of rows.

    cos_sin: (36000, 2) float32 of each hundredth of a degree. With two returns a block that repeats laser bank and
    azimuth of the one before is its second return; where that has the same range it is none.
    """
    m = 0
    for p in range(raw.shape[0]):
        first, bank, direction = True, -1, -1  # of the block before
        blocks = DUAL_BLOCKS if raw[p, MODE_AT] == DUAL_RETURN else BLOCKS
        for at in range(0, 100 * blocks, 100):
            flag = raw[p, at + 1]
            azimuth = raw[p, at + 2] + 256 * raw[p, at + 3]
            if raw[p, at] != 0xFF or flag < 0xBB or flag > 0xEE or (flag - 0xBB) % 0x11 != 0 or azimuth >= 36000:
                first, bank = True, -1
                continue
            second = raw[p, MODE_AT] == DUAL_RETURN and first and flag == bank and azimuth == direction
            first, bank, direction = not second, flag, azimuth
            rows.bank[m] = (0xEE - flag) // 0x11
            rows.cos[m], rows.sin[m] = cos_sin[azimuth, 0], -cos_sin[azimuth, 1]
            for k in range(BEAMS_OF_BLOCK):
                byte = at + 4 + 3 * k
                steps = raw[p, byte] + 256 * raw[p, byte + 1]
                range_m = np.float32(steps) * np.float32(DISTANCE_STEP_M)
                rows.range_m[m, k] = np.float32(0.0) if second and range_m == rows.range_m[m - 1, k] else range_m
                rows.intensity[m, k] = raw[p, byte + 2]
            m += 1
    return m
