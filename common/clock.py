"""The two clocks. Stamps are UTC nanoseconds; ages and time-outs are monotonic seconds, never the other way round."""

from __future__ import annotations

import os
import time

# A fault drill shifts this process's wall clock, as a bad NTP step would; unset in every deployment.
_DRILL_OFFSET_NS = int(float(os.environ.get("SPOTTER_DRILL_CLOCK_OFFSET_S", "0")) * 1e9)


def utc_ns() -> int:
    """UTC nanoseconds since 1970: for stamps only."""
    return time.time_ns() + _DRILL_OFFSET_NS


def monotonic_s() -> float:
    """Seconds on the monotonic clock: for ages and time-outs only."""
    return time.monotonic()
