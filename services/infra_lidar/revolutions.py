"""Packets to revolutions: packets are collected until the head passes the cut; losses and gaps are counted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from services.infra_lidar.blindness import FrameQuality

FULL_TURN_SHARE = 0.97


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
class PacketTurn:
    """The packets of one revolution, in order, before they are decoded."""

    packets: list[bytes]
    stamp_ns: int
    quality: FrameQuality


class TurnCollector:
    """Collects packets. ``incomplete`` counts turns that leave part of the circle out."""

    def __init__(self) -> None:
        self._packets: list[bytes] = []
        self._covered = np.zeros(360, bool)
        self._lost = 0
        self._stamp_ns = 0
        self.turns = 0
        self.incomplete = 0
        self.lost = 0

    def add(self, packet: bytes, first_deg: float, last_deg: float, stamp_ns: int, lost: int) -> None:
        """One packet that saw the directions from ``first_deg`` to ``last_deg``, with ``lost`` missing before it."""
        self._packets.append(packet)
        first, last = int(first_deg), int(last_deg)
        if first <= last:
            self._covered[first : last + 1] = True
        self._lost += lost
        self.lost += lost
        self._stamp_ns = stamp_ns

    def finish(self) -> PacketTurn | None:
        """The turn that ends here, None if nothing has come yet."""
        if not self._packets:
            return None
        complete = bool(self._covered.mean() >= FULL_TURN_SHARE)
        turn = PacketTurn(self._packets, self._stamp_ns, FrameQuality(len(self._packets), self._lost, complete))
        self.turns += 1
        self.incomplete += not complete
        self._packets, self._lost = [], 0
        self._covered[:] = False
        return turn
