"""The two clocks. Stamps are UTC nanoseconds; ages and time-outs are monotonic seconds, never the other way round."""

from __future__ import annotations

import os
import time

WRONG_CLOCK_S = 3600.0  # no network holds a message back this long: the sender's clock is wrong
_UNITS = ((365.25 * 86400.0, "year"), (86400.0, "day"), (3600.0, "hour"), (60.0, "minute"), (1.0, "second"))


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
    return utc_of_kernel(time.time_ns())


def utc_of_kernel(stamp_ns: int) -> int:
    """UTC nanoseconds of a stamp that the kernel has just made, for example of a packet."""
    shifted = _DRILL_SHIFT_NS and time.monotonic() >= _DRILL_FROM_S
    return stamp_ns + _DRILL_SHIFT_NS if shifted else stamp_ns


def monotonic_s() -> float:
    """Seconds on the monotonic clock: for ages and time-outs only."""
    return time.monotonic()


def utc_at(moment_s: float) -> int:
    """UTC nanoseconds of a moment on the monotonic clock, by what the UTC clock says now."""
    return utc_ns() - round((monotonic_s() - moment_s) * 1e9)


def clock_words(host: str, offset_s: float) -> str:
    """``clock of pi0 is 56 years behind``; ``offset_s`` is their clock minus ours."""
    size_s, unit = next((one for one in _UNITS if abs(offset_s) >= one[0]), _UNITS[-1])
    count = round(abs(offset_s) / size_s)
    return f"clock of {host} is {count} {unit}{'' if count == 1 else 's'} {'behind' if offset_s < 0 else 'ahead'}"
