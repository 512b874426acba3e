"""Waiting for what a benchmark has caused."""

from __future__ import annotations

import threading
from collections.abc import Callable

from common.clock import monotonic_s


def wait_for(condition: Callable[[], bool], poll_s: float = 0.002, give_up_s: float = 60.0) -> float:
    """Look every ``poll_s`` until the condition holds; the seconds that it took.

    Raises:
        TimeoutError: it does not hold after ``give_up_s`` seconds.
    """
    begun_s, pause = monotonic_s(), threading.Event()
    while not condition():
        if monotonic_s() - begun_s > give_up_s:
            raise TimeoutError(f"not within {give_up_s:.0f} s")
        pause.wait(poll_s)
    return monotonic_s() - begun_s
