"""Packets to revolutions: packets are collected until the head passes the cut; losses and gaps are counted.

A turn is decoded while it comes, some packets at a time: when its last packet is there, little is left to do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from services.infra_lidar.blindness import FrameQuality
from services.infra_lidar.range_image import RangeImage

FULL_TURN_SHARE = 0.97
TOGETHER = 64  # packets, a tenth of a turn
MOST_PACKETS = 4096  # of a turn; a slow one with two returns has 2400. A head that is stuck ends no turn by itself


@dataclass(frozen=True)
class Revolution:
    """image: one turn. stamp_ns: UTC ns of its last packet.

    packets: what it was decoded from; metadata: what one needs to decode them again (Ouster).
    """

    image: RangeImage
    stamp_ns: int
    quality: FrameQuality
    packets: list[bytes] = field(default_factory=list)
    metadata: str = ""

    @property
    def points(self) -> np.ndarray:
        """(R W, 5) float32 x y z (m, sensor frame) intensity ring, zeros where there is no return."""
        return self.image.points


class TurnToCome(Protocol):
    """The range image of the turn that is coming."""

    def add(self, packets: list[bytes]) -> None:
        """The next packets, all of one size."""

    def take(self) -> RangeImage:
        """The image; the next turn begins."""


@dataclass(frozen=True)
class PacketDecoder:
    """How packets of a sensor become range images.

    begin: where they are collected, with room for so many packets. metadata: what one needs to decode
    them again (Ouster).
    """

    begin: Callable[[int], TurnToCome]
    metadata: str = ""


class ImageRows:
    """Rows of a range image that grow while a turn comes; for as many as the last turn had, the next one has room."""

    def __init__(self, width: int, room: int = 0) -> None:
        """width: ranges of a row; room: rows that are expected."""
        self._width = width
        self._begin(room)

    def _begin(self, usual: int) -> None:
        self._usual = usual
        self._filled = self._needed = self._room = 0
        self._arrays = self._new(0)

    def room(self, rows: int) -> dict[str, np.ndarray]:
        """Where the next rows go, so many at the most: the arrays of a ``RangeImage`` by name."""
        self._needed = self._filled + rows
        if self._needed > self._room:
            self._room = max(_and_an_eighth(self._needed), self._usual)
            for name, array in self._new(self._room).items():
                array[: self._filled] = self._arrays[name][: self._filled]
                self._arrays[name] = array
        return {name: array[self._filled :] for name, array in self._arrays.items()}

    def fill(self, rows: int) -> None:
        """So many have been written."""
        self._filled += rows

    def take(self, beams: np.ndarray) -> RangeImage:
        """The image of all of them; the next turn begins."""
        rows = {name: array[: self._filled] for name, array in self._arrays.items()}
        self._begin(_and_an_eighth(self._needed))
        return RangeImage(**rows, beams=beams)

    def _new(self, rows: int) -> dict[str, np.ndarray]:
        def array(dtype: type, *width: int) -> np.ndarray:
            return np.empty((rows, *width), dtype)

        wide = {"range_m": array(np.float32, self._width), "intensity": array(np.uint8, self._width)}
        return wide | {"cos": array(np.float32), "sin": array(np.float32), "bank": array(np.uint8)}


def joined(packets: list[bytes]) -> np.ndarray:
    """(P, B) uint8."""
    return np.frombuffer(b"".join(packets), np.uint8).reshape(len(packets), -1)


def _and_an_eighth(room: int) -> int:
    return room + room // 8


def decode_turn(packets: list[bytes], decoder: PacketDecoder) -> RangeImage:
    """The image of a whole turn, the same as if its packets came one by one."""
    turn = decoder.begin(len(packets))
    for first in range(0, len(packets), TOGETHER):
        turn.add(packets[first : first + TOGETHER])
    return turn.take()


class TurnCollector:
    """Collects packets. ``incomplete`` counts turns that leave part of the circle out."""

    def __init__(self, decoder: PacketDecoder) -> None:
        self._metadata = decoder.metadata
        self._coming = decoder.begin(0)
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
            self._coming.add(self._packets[-TOGETHER:])
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
            self._coming.add(self._packets[-left:])
        complete = self._covered.bit_count() >= FULL_TURN_SHARE * 360
        quality = FrameQuality(len(self._packets), self._lost, complete)
        turn = Revolution(self._coming.take(), self._stamp_ns, quality, self._packets, self._metadata)
        self.turns += 1
        self.incomplete += not complete
        self._packets, self._lost, self._covered = [], 0, 0
        return turn
