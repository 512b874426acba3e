"""Whether a measured value can be true: within limits, not jumping, not stuck. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

CONFIRMING = 3  # values in a row that agree with each other: then the jump was real


class Limits(NamedTuple):
    """Of one signal. ``noisy``: a living sensor never gives the same value for long, not even zero."""

    maximum: float
    rate: float  # per second: more is a jump
    stuck_s: float
    noisy: bool = False
    tolerance: float = 0.05  # a step of this size is never a jump


class SignalCheck:
    """``fault`` for every value: "" when it may be used, else "nonsense", "jump" or "stuck"."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._good: tuple[float, float] | None = None  # (monotonic seconds, value)
        self._doubtful: list[tuple[float, float]] = []
        self._same: tuple[float, float] | None = None  # (since, value)

    def fault(self, at_s: float, value: float) -> str:
        """What is wrong with ``value`` at ``at_s`` (monotonic)."""
        if not math.isfinite(value) or abs(value) > self._limits.maximum:
            return "nonsense"
        if self._is_stuck(at_s, value):
            return "stuck"
        jumped = self._good is not None and not self._follows(self._good, at_s, value)
        if jumped and not self._confirmed(at_s, value):
            return "jump"
        self._good, self._doubtful = (at_s, value), []
        return ""

    def _follows(self, before: tuple[float, float], at_s: float, value: float) -> bool:
        reach = self._limits.tolerance + self._limits.rate * max(0.0, at_s - before[0])
        return abs(value - before[1]) <= reach

    def _confirmed(self, at_s: float, value: float) -> bool:
        """Enough values in a row that agree: what was taken for good before was wrong, or time has passed."""
        if self._doubtful and not self._follows(self._doubtful[-1], at_s, value):
            self._doubtful = []
        self._doubtful.append((at_s, value))
        return len(self._doubtful) >= CONFIRMING

    def _is_stuck(self, at_s: float, value: float) -> bool:
        if self._same is None or value != self._same[1]:
            self._same = (at_s, value)
        rests = value == 0.0 and not self._limits.noisy
        return not rests and at_s - self._same[0] > self._limits.stuck_s
