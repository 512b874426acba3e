"""The last seconds of many topics, bounded in time and in bytes. Pure: time comes in as an argument."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Kept:
    """One message as it arrived on this host: at UTC ``log_ns`` and at monotonic ``at_s``.

    The ring and the window of an incident go by ``at_s``, which no setting of the clock moves.
    """

    key: str
    payload: bytes
    log_ns: int
    at_s: float


class Ring:
    """Add messages as they come; ``window`` gives those of an interval that are still there."""

    def __init__(self, keep_s: float, max_bytes: int) -> None:
        self._keep_s = keep_s
        self._max_bytes = max_bytes
        self._kept: deque[Kept] = deque()
        self.size_bytes = 0

    def add(self, kept: Kept) -> None:
        """Keep one message, and drop the oldest ones beyond the ring's time and size."""
        self._kept.append(kept)
        self.size_bytes += len(kept.payload)
        oldest_s = kept.at_s - self._keep_s
        while self._kept and (self._kept[0].at_s < oldest_s or self.size_bytes > self._max_bytes):
            self.size_bytes -= len(self._kept.popleft().payload)

    def window(self, from_s: float, to_s: float) -> list[Kept]:
        """What was kept between two monotonic seconds, both included."""
        return [kept for kept in self._kept if from_s <= kept.at_s <= to_s]
