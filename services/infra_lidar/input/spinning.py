"""The decoder contract: the packet format of a spinning lidar, and the parser that all of them share. No I/O.

A sensor gives two pure functions. ``heads`` reads the few bytes that tell where packets lie in the revolution, as they
come. ``decode`` makes ranges of many packets at once. What a sensor needs beside its packets (beam angles, firing
times) is in the format from the start; its text form is ``metadata``, from which the format can be made again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import NamedTuple, Protocol

import numpy as np

from services.infra_lidar.input.range_image import RangeImage
from services.infra_lidar.input.revolution import (
    PacketDecoder,
    PacketOrder,
    Revolution,
    RevolutionAssembler,
    stack_packets,
)
from services.infra_lidar.jit import kernel

BACK_DEG = 2.0  # the head turns one way: an azimuth that falls by more begins a new revolution
BACKWARD_PACKETS = 200  # whose azimuths fall by less: the head turns the other way
WRONG_WAY = "head turns counter-clockwise, set the sensor to clockwise"


class PacketHead(NamedTuple):
    """Where a packet lies: azimuths of its first and last block in degrees, and its place in the sensor's own count."""

    first_deg: float
    last_deg: float
    position: int
    step: float  # by which ``position`` grows from one packet to the next


@dataclass(frozen=True)
class SensorFormat:
    """The packet format of one sensor.

    kind: as in ``models.KINDS``. heads: of packets (P, B) uint8 of one size, (P, 4) float64 rows of ``PacketHead``, NaN
    where one is not this sensor's. decode: packets (P, B), each with a head, to the rows that they hold. period: where
    ``position`` begins again. farthest: a step beyond this is no gap but a sensor that has started anew. metadata: what
    the format was made of, "" where nothing is needed.
    """

    kind: str
    heads: Callable[[np.ndarray], np.ndarray]
    decode: Callable[[np.ndarray], RangeImage]
    period: int
    farthest: int
    metadata: str = ""

    def head(self, packet: bytes) -> PacketHead | None:
        """Where a packet lies; None if it is not this sensor's."""
        first_deg, last_deg, position, step = self.heads(stack_packets([packet]))[0].tolist()
        return None if math.isnan(first_deg) else PacketHead(first_deg, last_deg, int(position), step)

    @property
    def decoder(self) -> PacketDecoder:
        """The part of it that makes ranges."""
        return PacketDecoder(self.decode, self.metadata, self.kind)


class PacketParser(Protocol):
    """What the parsers of all sensors have in common.

    ``rejected`` counts packets of another kind, ``order`` doubled, late and damaged ones. ``assembler`` holds the
    revolution that is not complete yet.
    """

    rejected: int
    order: PacketOrder
    assembler: RevolutionAssembler

    def accepts(self, packet: bytes) -> bool:
        """Whether the packet is of this kind of sensor."""

    def feed(self, packet: bytes, stamp_ns: int) -> Revolution | None:
        """One packet and the UTC ns at which it came; the revolution that ended before it, if one did."""

    def feed_all(self, packets: Sequence[bytes], stamps_ns: Sequence[int]) -> list[Revolution]:
        """Packets as ``feed`` takes them, one after the other; the revolutions that ended."""


class SpinningParser:
    """Feed it packets; it returns whole revolutions, cut where the head passes ``cut_deg``. See ``PacketParser``."""

    def __init__(self, sensor: SensorFormat, cut_deg: float = 0.0) -> None:
        self._sensor = sensor
        self._cut_deg = cut_deg
        self._previous_deg = -1.0
        self._size = 0  # of the packets of this revolution
        self._backward = 0  # packets one after the other
        self.order = PacketOrder(sensor.period, sensor.farthest)
        self.assembler = RevolutionAssembler(sensor.decoder)
        self.rejected = 0

    def accepts(self, packet: bytes) -> bool:
        """Whether this is a data packet of the sensor."""
        return self._sensor.head(packet) is not None

    def feed(self, packet: bytes, stamp_ns: int) -> Revolution | None:
        """One packet and the UTC ns at which it came; the revolution that ended before it, if one did."""
        ended = self.feed_all([packet], [stamp_ns])
        return ended[0] if ended else None

    def feed_all(self, packets: Sequence[bytes], stamps_ns: Sequence[int]) -> list[Revolution]:
        """Packets as ``feed`` takes them, one after the other; the revolutions that ended."""
        ended: list[Revolution] = []
        sizes = [len(packet) for packet in packets]
        end = 0
        for _, alike in groupby(sizes):
            first, end = end, end + len(list(alike))
            ended += self._feed_alike(packets[first:end], stamps_ns[first:end])
        return ended

    def _feed_alike(self, packets: Sequence[bytes], stamps_ns: Sequence[int]) -> list[Revolution]:
        """Packets of one size. Most of them simply follow the one before: such a run is added at once."""
        heads = self._sensor.heads(stack_packets(packets))
        unknown = np.isnan(heads[:, 0])
        if unknown.any():
            ours = np.flatnonzero(~unknown).tolist()
            self.rejected += len(packets) - len(ours)
            packets, stamps_ns, heads = [packets[k] for k in ours], [stamps_ns[k] for k in ours], heads[ours]
        ended = []
        for first, end in pairwise(_run_bounds(heads, self._cut_deg).tolist()):
            ended.append(self._add(packets[first], heads[first], stamps_ns[first]))
            rest = range(first + 1, end)
            if 0 < len(rest) <= self.assembler.room and self._is_newest(packets[first], heads[first]):
                self._add_run(packets[first + 1 : end], heads[first + 1 : end], max(stamps_ns[first + 1 : end]))
            else:
                ended += [self._add(packets[k], heads[k], stamps_ns[k]) for k in rest]
        return [revolution for revolution in ended if revolution is not None]

    def _add(self, packet: bytes, head: np.ndarray, stamp_ns: int) -> Revolution | None:
        """A packet with its ``PacketHead`` (4,), degrees from the cut; the revolution that ended before it."""
        first_deg, last_deg, position, step = head.tolist()
        lost = self.order.missing(int(position), step)
        if lost is None:
            return None
        changed = len(packet) != self._size  # the sensor has been set to another layout
        if lost < 0:
            back = False  # late
            if first_deg > self._previous_deg + 180.0 or changed:
                return None  # its revolution has ended
        else:
            back = first_deg < self._previous_deg - BACK_DEG  # a window in the sensor ends anywhere
            self._watch_direction(first_deg - self._previous_deg)
            self._previous_deg = first_deg
        ended = self.assembler.finish() if back or changed or self.assembler.room <= 0 else None
        self._size = len(packet)
        self.assembler.add([packet], first_deg, last_deg, stamp_ns, lost)
        return ended

    def _is_newest(self, packet: bytes, head: np.ndarray) -> bool:
        """Whether the packet is of this revolution and none after it has come."""
        newest = self._previous_deg, self.order.newest, self._size
        return (head[0], head[2], len(packet)) == newest

    def _add_run(self, packets: Sequence[bytes], heads: np.ndarray, stamp_ns: int) -> None:
        """Packets that follow the newest one and each other, with heads (P, 4)."""
        self._previous_deg, self._backward = float(heads[-1, 0]), 0
        self.order.follow(heads[:, 2].astype(np.int64).tolist())
        self.assembler.add(packets, heads[0, 0], heads[-1, 1], stamp_ns, 0)

    def _watch_direction(self, step_deg: float) -> None:
        """Count, once in BACKWARD_PACKETS, that the head turns the other way, in which revolutions cannot be cut."""
        if step_deg > 0.0:
            self._backward = 0
        elif -BACK_DEG <= step_deg < 0.0:
            self._backward += 1
        if self._backward == BACKWARD_PACKETS:
            self.order.counters[WRONG_WAY] += 1
            self._backward = 0


@kernel
def _run_bounds(heads: np.ndarray, cut_deg: float) -> np.ndarray:
    """Where runs of packets begin, and the number of packets: (R + 1,) int64.

    heads: (P, 4) float64 rows of ``PacketHead`` of packets of one size; degrees from the cut are written to it. In a
    run each is the next one in the sensor's count and begins where the one before ended, to a degree.
    """
    bounds, runs = np.zeros(len(heads) + 1, np.int64), 0
    for p in range(len(heads)):
        heads[p, 0], heads[p, 1] = (heads[p, 0] - cut_deg) % 360.0, (heads[p, 1] - cut_deg) % 360.0
        before = heads[max(p - 1, 0)]
        ahead, turned_deg, gap_deg = heads[p, 2] - before[2], heads[p, 0] - before[0], heads[p, 0] - before[1]
        is_next = 0.0 < ahead < 1.5 * heads[p, 3] and turned_deg > 0.0 and gap_deg < 1.0
        if not is_next or heads[p, 1] < heads[p, 0]:
            bounds[runs] = p
            runs += 1
    bounds[runs] = len(heads)
    return bounds[: runs + 1]
