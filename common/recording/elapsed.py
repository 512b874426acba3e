"""Time into a recording, also where a clock was set while it was recorded."""

from __future__ import annotations

SET_NS = 100_000_000  # what counts to have passed where the clock was set
FARTHEST_NS, FARTHEST_BACK_NS = 3600 * 10**9, 10**9  # from one message to the next; a longer step is of the clock


class Elapsed:
    """Nanoseconds since the first message, of messages in the order in which they were recorded.

    Each counts with its step from the one before. A step of more than an hour, or back by more than a second, is one of
    the clock, or to a recording of another day: there a tenth of a second counts.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._into_ns = 0

    def at(self, stamp_ns: int) -> int:
        """Of the next message, by its UTC ns."""
        step_ns = 0 if self._last_ns is None else stamp_ns - self._last_ns
        self._into_ns += step_ns if -FARTHEST_BACK_NS <= step_ns <= FARTHEST_NS else SET_NS
        self._last_ns = stamp_ns
        return self._into_ns
