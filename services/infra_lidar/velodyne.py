"""Velodyne VLS-128 (Alpha Prime) packets to revolutions. Bytes in, arrays out; no I/O.

Layout and timing from the VLS-128 user manual (63-9483 Rev. D), chapter 9: a packet of 1206 bytes holds 12 blocks of
100 bytes (flag, azimuth in 0.01 degree, 32 x distance in 4 mm and reflectivity), a time stamp in microseconds of the
hour, return mode and product id. The flag tells which 32 of the 128 lasers a block belongs to. Eight lasers fire at a
time, 2.665 us apart, with a pause after each 64; the head turns on meanwhile.
"""

from __future__ import annotations

from functools import lru_cache
from struct import Struct

import numpy as np

from services.infra_lidar.jit import kernel
from services.infra_lidar.ordering import sort_rising
from services.infra_lidar.range_image import RangeImage
from services.infra_lidar.revolutions import ImageRows, PacketDecoder, Revolution, TurnCollector, joined

PACKET_BYTES, BLOCKS = 1206, 12
PRODUCT_VLS128 = 0xA1
DUAL_RETURN = 0x39
DISTANCE_STEP_M = 0.004
CYCLE_US, GROUP_S = 55.3, 2.665e-6  # a firing sequence of all 128 lasers, and of eight of them
MODE_AT = 1204
_HEAD = Struct("<2xH1098xH96xIBB")  # azimuths of the first and the last block, time, mode, product
FOCUS_M = 0.0586  # the beams meet this far in front of the axis
HOUR_US = 3_600_000_000

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
_COS_SIN = np.stack([np.cos(_CENTIDEGREES), np.sin(_CENTIDEGREES)], axis=1).astype(np.float32)


class Vls128Parser:
    """Feed it packets in order; it returns whole revolutions, cut where the head passes ``cut_deg``.

    ``rejected`` counts packets that are none of a VLS-128; ``turns`` counts losses and incomplete revolutions.
    """

    def __init__(self, cut_deg: float = 0.0) -> None:
        self._cut_deg = cut_deg
        self._last_us: int | None = None
        self._last_turn_deg = -1.0
        self.turns = TurnCollector(DECODER)
        self.rejected = 0

    def feed(self, packet: bytes, stamp_ns: int) -> Revolution | None:
        """One packet and the UTC ns at which it came; the revolution that ended before it, if one did."""
        if len(packet) != PACKET_BYTES:
            self.rejected += 1
            return None
        first, last, time_us, mode, product = _HEAD.unpack(packet)
        if product != PRODUCT_VLS128 or first >= 36000 or last >= 36000:
            self.rejected += 1
            return None
        lost = self._count_lost(time_us, mode)
        turn_deg, end_deg = (first / 100.0 - self._cut_deg) % 360.0, (last / 100.0 - self._cut_deg) % 360.0
        ended = self.turns.finish() if turn_deg < self._last_turn_deg - 180.0 or self.turns.full else None
        self._last_turn_deg = turn_deg
        self.turns.add(packet, turn_deg, end_deg, stamp_ns, lost)
        return ended

    def _count_lost(self, time_us: int, mode: int) -> int:
        """Packets missing before this one, from the sensor's own clock."""
        gap_us = 0 if self._last_us is None else (time_us - self._last_us) % HOUR_US
        self._last_us = time_us
        firings = 1.5 if mode == DUAL_RETURN else 3.0
        return max(0, round(gap_us / (firings * CYCLE_US)) - 1) if gap_us < 1_000_000 else 0


class TurnImage:
    """The range image of the turn that is coming; the head's rate is taken from its packets."""

    def __init__(self, packets: int = 0) -> None:
        self._beams = _beams(0.0)
        self._rows = ImageRows(32, packets * BLOCKS)

    def add(self, packets: list[bytes]) -> None:
        """The next packets."""
        raw, room = joined(packets), self._rows.room(len(packets) * BLOCKS)
        self._beams = _beams(_head_rate_deg_per_s(raw))
        self._rows.fill(
            _decode(raw, _COS_SIN, room["range_m"], room["intensity"], room["cos"], room["sin"], room["bank"])
        )

    def take(self) -> RangeImage:
        """The image; the next turn begins."""
        return self._rows.take(self._beams)


DECODER = PacketDecoder(TurnImage)


def decode_nothing() -> None:
    """Compile or load what decodes, before the first packet comes."""
    TurnImage().add([bytes(PACKET_BYTES)])


@lru_cache(maxsize=64)
def _beams(rate_deg_per_s: float) -> np.ndarray:
    """(7, 128) float32, see ``RangeImage``. Azimuths come in hundredths of a degree, so only few rates do."""
    turned, flat = np.radians(rate_deg_per_s * _DELAY_S - _OFFSET_DEG), np.cos(_ELEVATION)  # since its block began
    direction = [flat * np.cos(turned), -flat * np.sin(turned), np.sin(_ELEVATION)]  # turns clockwise from above
    return np.stack([*direction, 0 * flat, 0 * flat, -FOCUS_M * np.tan(_ELEVATION), RING]).astype(np.float32)


@kernel
def _head_rate_deg_per_s(raw):  # type: ignore[no-untyped-def]
    """Median over packets (P, 1206) uint8 of the turn from the first to the last block."""
    turned = np.empty(len(raw))
    for p in range(len(raw)):
        first, last = raw[p, 2] + 256 * raw[p, 3], raw[p, 1102] + 256 * raw[p, 1103]
        turned[p] = (last - first) % 36000 * (1.0 if raw[p, MODE_AT] == DUAL_RETURN else 0.5)
    sort_rising(turned)
    middle = 0.5 * (turned[(len(turned) - 1) // 2] + turned[len(turned) // 2])
    return middle / (100.0 * CYCLE_US * 1e-6)


@kernel
def _decode(raw, cos_sin, range_m, intensity, cos, sin, bank):  # type: ignore[no-untyped-def]
    """raw (P, 1206) uint8 to the rows of an image, one for each block; returns how many. cos_sin (36000, 2)."""
    m = 0
    for p in range(raw.shape[0]):
        for b in range(BLOCKS):
            at = 100 * b
            flag = raw[p, at + 1]
            if raw[p, at] != 0xFF or flag < 0xBB or flag > 0xEE or (flag - 0xBB) % 0x11 != 0:
                continue
            azimuth = raw[p, at + 2] + 256 * raw[p, at + 3]
            if azimuth >= 36000:
                continue
            bank[m], cos[m], sin[m] = (0xEE - flag) // 0x11, cos_sin[azimuth, 0], -cos_sin[azimuth, 1]
            for k in range(32):
                at_return = at + 4 + 3 * k
                steps = raw[p, at_return] + 256 * raw[p, at_return + 1]
                range_m[m, k] = np.float32(steps) * np.float32(DISTANCE_STEP_M)
                intensity[m, k] = raw[p, at_return + 2]
            m += 1
    return m
