"""Laps are booked under their names, each from the last one on."""

from __future__ import annotations

from common.stopwatch import Stopwatch


def test_laps_are_booked_in_order_and_none_is_negative() -> None:
    watch = Stopwatch()
    watch.lap("first")
    watch.lap("second")
    assert list(watch.stage_ms) == ["first", "second"]
    assert min(watch.stage_ms.values()) >= 0.0
