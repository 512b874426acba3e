"""The last seconds of many topics, bounded in time and in bytes. Pure: time comes in as an argument."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Kept:
    """One message as it arrived: key, payload, UTC ns of arrival on this host."""

    key: str
    payload: bytes
    log_ns: int


class Ring:
    """Add messages as they come; ``window`` gives those of an interval that are still there."""

    def __init__(self, keep_s: float, max_bytes: int) -> None:
        self._keep_ns = int(keep_s * 1e9)
        self._max_bytes = max_bytes
        self._kept: deque[Kept] = deque()
        self.size_bytes = 0

    def add(self, kept: Kept) -> None:
        """Keep one message, and drop the oldest ones beyond the ring's time and size."""
        self._kept.append(kept)
        self.size_bytes += len(kept.payload)
        oldest_ns = kept.log_ns - self._keep_ns
        while self._kept and (self._kept[0].log_ns < oldest_ns or self.size_bytes > self._max_bytes):
            self.size_bytes -= len(self._kept.popleft().payload)

    def window(self, from_ns: int, to_ns: int) -> list[Kept]:
        """What was kept between two UTC nanoseconds, both included."""
        return [kept for kept in self._kept if from_ns <= kept.log_ns <= to_ns]
