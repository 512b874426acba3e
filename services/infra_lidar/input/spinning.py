"""The decoder contract: the packet format of a spinning lidar, and the parser that all of them share. No I/O.

A sensor gives two pure functions. ``head`` reads the few bytes with a packet's place in the revolution, for every
packet as it comes. ``decode`` makes ranges of many packets at once. What a sensor needs beside its packets (beam
angles, firing times) is in the format from the start; its text form is ``metadata``, from which the format can be made
again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from services.infra_lidar.input.range_image import RangeImage
from services.infra_lidar.input.revolution import PacketDecoder, PacketOrder, Revolution, RevolutionAssembler

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

    kind: as in ``models.KINDS``. head: of a packet, None if it is not this sensor's. decode: packets (P, B) uint8 of
    one size, each with a head, to the rows that they hold. period: where ``position`` begins again. farthest: a step
    beyond this is no gap but a sensor that has started anew. metadata: what the format was made of, "" where nothing is
    needed.
    """

    kind: str
    head: Callable[[bytes], PacketHead | None]
    decode: Callable[[np.ndarray], RangeImage]
    period: int
    farthest: int
    metadata: str = ""

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
        head = self._sensor.head(packet)
        if head is None:
            self.rejected += 1
            return None
        first_deg, last_deg, position, step = head
        lost = self.order.missing(position, step)
        if lost is None:
            return None
        first_deg, last_deg = (first_deg - self._cut_deg) % 360.0, (last_deg - self._cut_deg) % 360.0
        changed = len(packet) != self._size  # the sensor has been set to another layout
        if lost < 0:
            back = False  # late
            if first_deg > self._previous_deg + 180.0 or changed:
                return None  # its revolution has ended
        else:
            back = first_deg < self._previous_deg - BACK_DEG  # a window in the sensor ends anywhere
            self._watch_direction(first_deg - self._previous_deg)
            self._previous_deg = first_deg
        ended = self.assembler.finish() if back or changed or self.assembler.full else None
        self._size = len(packet)
        self.assembler.add(packet, first_deg, last_deg, stamp_ns, lost)
        return ended

    def _watch_direction(self, step_deg: float) -> None:
        """Count, once in BACKWARD_PACKETS, that the head turns the other way, in which revolutions cannot be cut."""
        if step_deg > 0.0:
            self._backward = 0
        elif -BACK_DEG <= step_deg < 0.0:
            self._backward += 1
        if self._backward == BACKWARD_PACKETS:
            self.order.counters[WRONG_WAY] += 1
            self._backward = 0
