"""Pauses between attempts that fail one after the other."""

from __future__ import annotations


class Backoff:
    """Exponential back-off: the pause doubles with every attempt from ``first_s`` up to ``longest_s`` seconds."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self._pause_s = first_s

    def next_s(self) -> float:
        """The pause before the next attempt, in seconds."""
        pause_s = self._pause_s
        self._pause_s = min(2.0 * pause_s, self._longest_s)
        return pause_s

    def reset(self) -> None:
        """After a success: the next pause is the first one again."""
        self._pause_s = self._first_s
