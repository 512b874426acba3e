"""Packets to revolutions: packets are collected until the head passes the cut; losses and gaps are counted.

A revolution is decoded while it comes, some hundred packets at a time, so that little is left to do after its last
packet.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from services.infra_lidar.input.range_image import RangeImage
from services.infra_lidar.sensor_health import FrameQuality

FULL_COVERAGE = 0.97  # of the directions that the sensor sends: then a revolution is complete
WINDOW_REVOLUTIONS = 10  # the field of view is what was covered in any of the last revolutions, this many
NARROWEST_DARK_DEG = 45  # gaps wider than this count as outside the window
RECENT_PACKETS = 32  # a mirror port sends a packet again right behind itself, a switch swaps neighbours
BATCH_BYTES = 1 << 18  # of packets decoded together, a third of a revolution or less
MAX_PACKETS = 8192  # of a revolution: a slow one with two returns has 7200. A stuck head never passes the cut


@dataclass(frozen=True)
class Revolution:
    """One revolution of the head.

    stamp_ns: UTC ns of its last packet. packets: what it was decoded from. metadata, kind: of the sensor, what is
    needed to decode them again.
    """

    range_image: RangeImage
    stamp_ns: int
    quality: FrameQuality
    packets: list[bytes] = field(default_factory=list)
    metadata: str = ""
    kind: str = "velodyne"

    @property
    def points(self) -> np.ndarray:
        """(R W, 5) float32 x, y, z (m, sensor frame), intensity, ring; zeros where there is no return."""
        return self.range_image.points


@dataclass(frozen=True)
class PacketDecoder:
    """How a sensor's packets become range images.

    decode: packets (P, B) uint8 to the rows that they hold. metadata: what is needed to decode beside them, "" =
    nothing. kind: of the sensor, as in ``models.KINDS``.
    """

    decode: Callable[[np.ndarray], RangeImage]
    metadata: str = ""
    kind: str = "velodyne"


def stack_packets(packets: Sequence[bytes]) -> np.ndarray:
    """(P, B) uint8 of packets of one size."""
    return np.frombuffer(b"".join(packets), np.uint8).reshape(len(packets), -1)


def join_rows(parts: Sequence[RangeImage]) -> RangeImage:
    """One range image of the rows of all parts (at least one), with the beams of the longest.

    Beams hold the speed of the head, which few packets determine badly.
    """

    def join(name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts])

    return RangeImage(
        join("range_m"), join("intensity"), join("cos"), join("sin"), join("bank"), max(parts, key=len).beams
    )


def batch_of(packet_bytes: int) -> int:
    """Number of packets of this size that are decoded together."""
    return max(1, BATCH_BYTES // max(1, packet_bytes))


def decode_revolution(raw: np.ndarray, decoder: PacketDecoder) -> RangeImage:
    """The range image of packets (P, B) uint8, the same as if they came one by one."""
    batch = batch_of(raw.shape[1])
    firsts = range(0, max(len(raw), 1), batch)
    return join_rows([decoder.decode(raw[first : first + batch]) for first in firsts])


class PacketOrder:
    """Detects doubled and late packets and gaps by the sensor's own counter.

    ``counters`` holds ``packet doubled`` and ``packet late``.

    Args:
        period: where the counter begins again at 0.
        farthest: a larger step of the counter is not a gap: the sensor has restarted.
    """

    def __init__(self, period: int, farthest: int) -> None:
        self.counters: Counter[str] = Counter()
        self._period, self._farthest = period, farthest
        self._recent: deque[int] = deque(maxlen=RECENT_PACKETS)
        self._newest: int | None = None

    @property
    def newest(self) -> int | None:
        """The position of the newest packet; None before the first."""
        return self._newest

    def follow(self, positions: Sequence[int]) -> None:
        """Packets that follow the newest one and each other, none missing."""
        self._recent.extend(positions[-RECENT_PACKETS:])
        self._newest = positions[-1]

    def missing(self, position: int, step: float) -> int | None:
        """Packets missing before the one at ``position``, ``step`` is from one to the next; None = it is a double.

        -1: it is late, and was counted as missing before.
        """
        half = self._period // 2
        ahead = 0 if self._newest is None else (position - self._newest + half) % self._period - half
        if not 0 < ahead < 2 * step and position in self._recent:
            self.counters["packet doubled"] += 1
            return None
        self._recent.append(position)
        if -RECENT_PACKETS * step < ahead < 0:
            self.counters["packet late"] += 1
            return -1
        self._newest = position
        return max(0, round(ahead / step) - 1) if 0 < ahead < self._farthest else 0


class FieldOfView:
    """The degrees that the sensor sends. On a mast a window is often set in the sensor, so it is learned.

    A wide sector that no recent revolution covered is outside the window; a narrower gap is packet loss.
    """

    def __init__(self) -> None:
        self._recent: deque[int] = deque(maxlen=WINDOW_REVOLUTIONS)  # a bit for each degree
        self._seen = -1  # in any of them
        self.degrees = (1 << 360) - 1  # a bit for each degree that is expected; all of them in the first revolution

    def add(self, covered: int) -> None:
        """Add the covered degrees of a revolution, one bit each."""
        self._recent.append(covered)
        seen = 0
        for degrees in self._recent:
            seen |= degrees
        if seen == self._seen:
            return
        self._seen = seen
        places = [k for k in range(360) if seen >> k & 1]
        for here, following in pairwise([*places, *(k + 360 for k in places[:1])]):
            if following - here <= NARROWEST_DARK_DEG:
                for k in range(here + 1, following):
                    seen |= 1 << k % 360
        self.degrees = seen

    def share(self, last_deg: float, first_deg: float) -> float:
        """Share of the whole degrees between the end of a packet and the beginning of the next that is expected."""
        count = (int(first_deg) - int(last_deg) - 1) % 360
        between = [(int(last_deg) + 1 + k) % 360 for k in range(count)]
        return sum(self.degrees >> k & 1 for k in between) / count if count and count < 359 else 1.0


class RevolutionAssembler:
    """Collects the packets of a revolution and decodes them."""

    def __init__(self, decoder: PacketDecoder) -> None:
        self._decoder = decoder
        self._packets: list[bytes] = []
        self._undecoded = 0  # the newest of them
        self._parts: list[RangeImage] = []
        self._covered = 0  # a bit for each degree
        self._view = FieldOfView()
        self._last_deg = 0.0
        self._lost = 0
        self._stamp_ns = 0

    def add(self, packets: Sequence[bytes], first_deg: float, last_deg: float, stamp_ns: int, lost: int) -> None:
        """Packets of one size that saw the directions from ``first_deg`` to ``last_deg``, ``lost`` missing before them.

        -1: it is one of those that were missing. What lies outside the sensor's field of view is not lost. ``stamp_ns``
        is of the latest.
        """
        self._packets += packets
        self._undecoded += len(packets)
        batch = batch_of(len(packets[0]))
        while self._undecoded >= batch:
            self._decode(batch)
        first, last = int(first_deg), int(last_deg)
        if first <= last:
            self._covered |= (2 << last) - (1 << first)
        if lost:
            self._lost += round(lost * self._view.share(self._last_deg, first_deg)) if lost > 0 else lost
        self._last_deg = last_deg
        self._stamp_ns = max(stamp_ns, self._stamp_ns)

    @property
    def room(self) -> int:
        """How many more packets a revolution may have; with no room left it ends, as an incomplete one."""
        return MAX_PACKETS - len(self._packets)

    def finish(self) -> Revolution | None:
        """The revolution that ends here; None if no packet has come since the last one."""
        if not self._packets:
            return None
        if self._undecoded:
            self._decode(self._undecoded)
        expected = self._view.degrees
        turned = self.room > 0  # else the head is stuck
        complete = turned and (self._covered & expected).bit_count() >= FULL_COVERAGE * expected.bit_count()
        if turned:
            self._view.add(self._covered)
        quality = FrameQuality(len(self._packets), max(0, self._lost), complete)
        image = join_rows(self._parts)
        decoder = self._decoder
        revolution = Revolution(image, self._stamp_ns, quality, self._packets, decoder.metadata, decoder.kind)
        self._packets, self._parts, self._lost, self._covered, self._stamp_ns = [], [], 0, 0, 0
        return revolution

    def _decode(self, count: int) -> None:
        """The oldest ``count`` packets that are not decoded yet."""
        first = len(self._packets) - self._undecoded
        self._parts.append(self._decoder.decode(stack_packets(self._packets[first : first + count])))
        self._undecoded -= count
