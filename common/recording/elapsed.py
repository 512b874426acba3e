"""Time into a recording, also where a clock was set while it was recorded."""

from __future__ import annotations

SET_NS = 100_000_000  # what counts to have passed where the clock was set
FARTHEST_S, FARTHEST_BACK_S = 60.0, 1.0  # from one message to the next: a service says something every second


class Elapsed:
    """Nanoseconds since the first message, of messages in the order in which they were recorded.

    Each counts with its step from the one before. A step of more than ``farthest_s``, or back by more than a second, is
    one of the clock, or to a recording of another day: there a tenth of a second counts.
    """

    def __init__(self, farthest_s: float = FARTHEST_S) -> None:
        self._farthest_ns = round(farthest_s * 1e9)
        self._last_ns: int | None = None
        self._into_ns = 0

    def at(self, stamp_ns: int) -> int:
        """Of the next message, by its UTC ns."""
        step_ns = 0 if self._last_ns is None else stamp_ns - self._last_ns
        self._into_ns += step_ns if -FARTHEST_BACK_S * 1e9 <= step_ns <= self._farthest_ns else SET_NS
        self._last_ns = stamp_ns
        return self._into_ns
