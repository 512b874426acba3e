"""A timer whose time is an argument."""

from __future__ import annotations

from common.periodic import Periodic


def test_the_first_call_is_due_and_then_once_per_period() -> None:
    timer = Periodic(1.0)
    assert [timer.due(now_s) for now_s in (5.0, 5.5, 6.0, 6.9, 7.0)] == [True, False, True, False, True]


def test_with_a_start_the_first_period_has_to_pass() -> None:
    timer = Periodic(2.0, start_s=10.0)
    assert [timer.due(now_s) for now_s in (10.0, 11.9, 12.0)] == [False, False, True]


def test_missed_periods_are_not_caught_up() -> None:
    timer = Periodic(1.0, start_s=0.0)
    assert [timer.due(now_s) for now_s in (5.5, 5.6, 6.4, 6.5)] == [True, False, False, True]
