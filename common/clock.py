"""The two clocks. Stamps are UTC nanoseconds; ages and time-outs are monotonic seconds, never the other way round."""

from __future__ import annotations

import os
import time


def _drill_shift() -> tuple[int, float]:
    """Nanoseconds by which a fault drill shifts this process's wall clock, and the monotonic time from which on.

    ``SECONDS`` shifts it for good, ``SECONDS@MONOTONIC_S`` steps it then, as a bad NTP server would; unset in every
    deployment.
    """
    seconds, _, from_s = os.environ.get("SPOTTER_DRILL_CLOCK_OFFSET_S", "0").partition("@")
    return int(float(seconds) * 1e9), float(from_s or 0.0)


_DRILL_SHIFT_NS, _DRILL_FROM_S = _drill_shift()


def utc_ns() -> int:
    """UTC nanoseconds since 1970: for stamps only."""
    if _DRILL_SHIFT_NS and time.monotonic() >= _DRILL_FROM_S:
        return time.time_ns() + _DRILL_SHIFT_NS
    return time.time_ns()


def monotonic_s() -> float:
    """Seconds on the monotonic clock: for ages and time-outs only."""
    return time.monotonic()


def utc_at(moment_s: float) -> int:
    """UTC nanoseconds of a moment on the monotonic clock, by what the UTC clock says now."""
    return utc_ns() - round((monotonic_s() - moment_s) * 1e9)
