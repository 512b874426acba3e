"""Packets to revolutions: packets are collected until the head passes the cut; losses and gaps are counted.

A turn is decoded while it comes, some packets at a time: when its last packet is there, little is left to do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from services.infra_lidar.blindness import FrameQuality

FULL_TURN_SHARE = 0.97
TOGETHER = 64  # packets, a tenth of a turn
MOST_PACKETS = 4096  # of a turn; a slow one with two returns has 2400. A head that is stuck ends no turn by itself


@dataclass(frozen=True)
class Revolution:
    """points: (N, 5) float32 x y z (m, sensor frame) intensity ring. stamp_ns: UTC ns of its last packet.

    packets: what it was decoded from; metadata: what one needs to decode them again (Ouster).
    """

    points: np.ndarray
    stamp_ns: int
    quality: FrameQuality
    packets: list[bytes] = field(default_factory=list)
    metadata: str = ""


@dataclass(frozen=True)
class PacketDecoder:
    """How packets of a sensor become points.

    decode: (P, B) uint8, packets of one turn, into (P * points_per_packet, 5) float32, x y z (m, sensor frame)
    intensity ring; returns how many points they hold. metadata: what one needs to decode them again (Ouster).
    """

    points_per_packet: int
    decode: Callable[[np.ndarray, np.ndarray], int]
    metadata: str = ""


class TurnPoints:
    """The points of the turn that is coming."""

    def __init__(self, decoder: PacketDecoder, packets: int = 0) -> None:
        self._decoder = decoder
        self._points, self._filled = np.empty((0, 5), np.float32), 0
        self._needed, self._usual = 0, packets * decoder.points_per_packet  # room: for this turn, for a turn

    def add(self, packets: list[bytes]) -> None:
        """The next packets, all of one size."""
        raw = np.frombuffer(b"".join(packets), np.uint8).reshape(len(packets), -1)
        self._needed = self._filled + len(packets) * self._decoder.points_per_packet
        if self._needed > len(self._points):
            larger = np.empty((max(_and_an_eighth(self._needed), self._usual), 5), np.float32)
            larger[: self._filled] = self._points[: self._filled]
            self._points = larger
        self._filled += self._decoder.decode(raw, self._points[self._filled :])

    def take(self) -> np.ndarray:
        """(N, 5) float32: all of them; the next turn begins."""
        points = self._points[: self._filled]
        self._points, self._filled = np.empty((0, 5), np.float32), 0
        self._needed, self._usual = 0, _and_an_eighth(self._needed)
        return points


def _and_an_eighth(room: int) -> int:
    return room + room // 8


def decode_turn(packets: list[bytes], decoder: PacketDecoder) -> np.ndarray:
    """The points of a whole turn, (N, 5) float32, the same as if its packets came one by one."""
    points = TurnPoints(decoder, len(packets))
    for first in range(0, len(packets), TOGETHER):
        points.add(packets[first : first + TOGETHER])
    return points.take()


class TurnCollector:
    """Collects packets. ``incomplete`` counts turns that leave part of the circle out."""

    def __init__(self, decoder: PacketDecoder) -> None:
        self._metadata = decoder.metadata
        self._points = TurnPoints(decoder)
        self._packets: list[bytes] = []
        self._covered = 0  # a bit a degree
        self._lost = 0
        self._stamp_ns = 0
        self.turns = 0
        self.incomplete = 0
        self.lost = 0

    def add(self, packet: bytes, first_deg: float, last_deg: float, stamp_ns: int, lost: int) -> None:
        """One packet that saw the directions from ``first_deg`` to ``last_deg``, with ``lost`` missing before it."""
        self._packets.append(packet)
        if len(self._packets) % TOGETHER == 0:
            self._points.add(self._packets[-TOGETHER:])
        first, last = int(first_deg), int(last_deg)
        if first <= last:
            self._covered |= (2 << last) - (1 << first)
        self._lost += lost
        self.lost += lost
        self._stamp_ns = stamp_ns

    @property
    def full(self) -> bool:
        """Whether there are more packets than any turn has: then it is ended, as an incomplete one."""
        return len(self._packets) >= MOST_PACKETS

    def finish(self) -> Revolution | None:
        """The turn that ends here, None if nothing has come yet."""
        if not self._packets:
            return None
        left = len(self._packets) % TOGETHER
        if left:
            self._points.add(self._packets[-left:])
        complete = self._covered.bit_count() >= FULL_TURN_SHARE * 360
        quality = FrameQuality(len(self._packets), self._lost, complete)
        turn = Revolution(self._points.take(), self._stamp_ns, quality, self._packets, self._metadata)
        self.turns += 1
        self.incomplete += not complete
        self._packets, self._lost, self._covered = [], 0, 0
        return turn
