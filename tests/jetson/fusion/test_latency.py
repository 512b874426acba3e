"""What each input took from its measurement to the verdict, and who is over its budget."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.jetson.fusion.evidence import SensorInput
from services.jetson.fusion.latency import WINDOW, LatencyBook


def book(ages_ms: list[float], budget_ms: float = 80.0) -> LatencyBook:
    """One message of the lidar for each age."""
    latency = LatencyBook({"lidar": budget_ms, "radar": budget_ms})
    for number, age_ms in enumerate(ages_ms, 1):
        latency.add({"lidar": SensorInput("online", None, age_ms / 1e3, stamp_ns=number, stage_ms={"fusion": 2.0})})
    return latency


@given(ages_ms=st.lists(st.floats(0.0, 1e4), min_size=1, max_size=WINDOW))
def test_percentiles_are_those_of_numpy(ages_ms: list[float]) -> None:
    summary, (p50, p99) = book(ages_ms).summary(), np.percentile(ages_ms, (50, 99))
    assert (summary["lidar_p50"], summary["lidar_p99"]) == pytest.approx((p50, p99), abs=2e-3)
    assert (summary["fusion_p50"], summary["fusion_p99"]) == (2.0, 2.0)


def test_a_message_counts_once() -> None:
    latency = book([10.0])
    latency.add({"lidar": SensorInput("online", None, 0.5, stamp_ns=1)})
    assert latency.summary()["lidar_p99"] == 10.0


def test_an_input_without_age_or_stamp_does_not_count() -> None:
    latency = book([])
    latency.add({"lidar": SensorInput("disconnected", None), "radar": SensorInput("online", None, 0.5)})
    assert latency.summary() == {}
    assert latency.over_budget() == {}


def test_three_late_messages_of_a_whole_window_are_over_the_budget() -> None:
    assert "lidar" in book([20.0] * (WINDOW - 3) + [500.0] * 3).over_budget()
    assert book([20.0] * (WINDOW - 2) + [500.0] * 2).over_budget() == {}


def test_one_late_message_of_a_hundred_is_within_the_budget_and_three_are_not() -> None:
    assert book([20.0] * 99 + [500.0]).over_budget() == {}
    said = book([20.0] * 97 + [500.0] * 3).over_budget()
    assert said == {"lidar": "late: p99 500 ms from measurement to verdict, budget 80 ms"}


def test_what_was_late_long_ago_is_forgotten() -> None:
    assert book([500.0] * 10 + [20.0] * WINDOW).over_budget() == {}
