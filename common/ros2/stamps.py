"""When a message of ROS 2 was measured. Pure.

``header.stamp`` is the measurement's time by the clock of the driver's machine. It is believed within what fusion
could still use: a stamp from the future or from long ago is a clock that is not synchronised, or simulated time.
"""

from __future__ import annotations

from typing import Literal

NS = 1_000_000_000
AHEAD_NS = 50_000_000  # as fusion and gate allow
BEHIND_NS = 1_000_000_000  # twice the age at which a sensor is stale: beyond that it is no transport
By = Literal["header", "arrival"]


class StampError(ValueError):
    """A stamp that cannot be that of a measurement just made; the text says why and what to do."""


def measured_ns(stamp_ns: int, arrived_ns: int, by: By = "header") -> int:
    """UTC ns of the measurement of a message that arrived at ``arrived_ns``; by "arrival" that is when it came.

    Raises:
        StampError: the stamp is missing, ahead, or far behind.
    """
    if by == "arrival":
        return arrived_ns
    advice = "synchronise the clocks (chrony, PTP), or date by arrival with ?stamp=arrival"
    if stamp_ns <= 0:
        raise StampError("header.stamp is zero; date by arrival with ?stamp=arrival")
    late_ns = arrived_ns - stamp_ns
    if late_ns < -AHEAD_NS:
        raise StampError(f"header.stamp is {-late_ns / NS:.2f} s ahead of this machine's clock; {advice}")
    if late_ns > BEHIND_NS:
        raise StampError(f"header.stamp is {_spoken(late_ns)} behind this machine's clock; {advice}")
    return stamp_ns


def _spoken(ns: int) -> str:
    return f"{ns / NS:.2f} s" if ns < 3600 * NS else f"{ns / NS / 86400:.1f} days"
