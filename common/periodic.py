"""Work that a loop does once per period, independent of how often the loop runs."""

from __future__ import annotations

import math


class Periodic:
    """A timer without a clock of its own: times are monotonic seconds, given by the caller.

    Args:
        period_s: from one due time to the next. A late call does not catch up on periods that were missed.
        start_s: the first due time is one period later; without it the first call is due.
    """

    def __init__(self, period_s: float, start_s: float = -math.inf) -> None:
        self._period_s = period_s
        self._due_s = start_s + period_s

    def due(self, now_s: float) -> bool:
        """Whether a period has passed; if so, the next one begins at ``now_s``."""
        if now_s < self._due_s:
            return False
        self._due_s = now_s + self._period_s
        return True
