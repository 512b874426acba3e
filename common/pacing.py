"""When a source's next frame is due, and what becomes of frames that are late.

================  ==========================================================================================
``ticks``         live: due times stay whole periods apart; of those that have passed only the newest comes
``Playback``      played: every frame comes; a reader that is late by more than one gap moves the schedule
``steady``        the same with one period, for a loop that somebody else stops
``wait_until``    the moment is the caller's own: nothing is skipped or moved, and late frames catch up
================  ==========================================================================================
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

from common.clock import monotonic_s

Wait = Callable[[float], object]  # takes seconds; the ``wait`` of an event may end sooner


def wait_until(due_s: float, wait: Wait | None = None) -> None:
    """Return at ``due_s`` on the monotonic clock, or at once where that has passed. Without ``wait`` it sleeps."""
    (wait or time.sleep)(max(0.0, due_s - monotonic_s()))


def ticks(
    period_s: float, first_s: float | None = None, skipped: Callable[[int], object] | None = None
) -> Iterator[float]:
    """Due times, monotonic seconds, each when it has come; the first at ``first_s``, or now.

    While the reader was busy for more than a period, due times are skipped, and ``skipped`` is told how many.
    """
    begin_s, number = monotonic_s() if first_s is None else first_s, 0
    while True:
        due_s = begin_s + number * period_s
        wait_until(due_s)
        yield due_s
        behind = int((monotonic_s() - due_s) / period_s)
        if skipped and behind > 1:
            skipped(behind - 1)
        number += max(1, behind)


class Playback:
    """Due times with given gaps between them, beginning now."""

    def __init__(self, wait: Wait | None = None) -> None:
        self._wait = wait
        self._due_s = monotonic_s()

    def next_s(self, gap_s: float) -> float:
        """Wait until ``gap_s`` seconds after the last due time; the new one, monotonic seconds."""
        self._due_s += gap_s
        now_s = monotonic_s()
        if now_s - self._due_s > gap_s:
            self._due_s = now_s
        wait_until(self._due_s, self._wait)
        return self._due_s


def steady(period_s: float, stop: threading.Event) -> Iterator[float]:
    """Due times, monotonic seconds: now, and then with ``period_s`` between them until ``stop`` is set."""
    playback = Playback(stop.wait)
    due_s = playback.next_s(0.0)
    while not stop.is_set():
        yield due_s
        due_s = playback.next_s(period_s)
