"""A clock that is run by hand: the emulated chip and the driver on it need no waiting."""

from __future__ import annotations

from collections.abc import Callable

START_S = 1000.0
EPOCH_NS = 1_700_000_000_000_000_000


class ManualClock:
    """Time passes when somebody sleeps; planned events happen on the way."""

    def __init__(self) -> None:
        self.now_s = START_S
        self._events: list[tuple[float, Callable[[], None]]] = []

    def monotonic_s(self) -> float:
        return self.now_s

    def utc_ns(self) -> int:
        return EPOCH_NS + round(self.now_s * 1e9)

    def sleep(self, seconds: float) -> None:
        end_s = self.now_s + max(seconds, 0.0)
        while self._events and self._events[0][0] <= end_s:
            at_s, happen = self._events.pop(0)
            self.now_s = max(self.now_s, at_s)
            happen()
        self.now_s = max(self.now_s, end_s)

    def at(self, delay_s: float, happen: Callable[[], None]) -> None:
        """Let something happen so long after the clock's start."""
        self._events.append((START_S + delay_s, happen))
        self._events.sort(key=lambda event: event[0])
