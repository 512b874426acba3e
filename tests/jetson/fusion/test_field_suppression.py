"""Cases from the field: what an empty picture may hold back, and what it may not. The pipeline in simulated time."""

from __future__ import annotations

from typing import Any

import pytest

from services.jetson.fusion.config import FusionConfig, RulesConfig


@pytest.fixture
def holding_back(new_bench: Any) -> Any:
    """A bench on which the camera may suppress; by default it may not."""
    bench = new_bench(FusionConfig(rules=RulesConfig(suppression="limited")))
    bench.run(1.0)
    return bench


def test_a_confirmed_detection_is_never_held_back_again(holding_back: Any) -> None:
    """Person at 1.1 m, everything healthy, the detector misses pictures in the first second."""
    holding_back.levels["lidar"] = "CAUTION"
    holding_back.run(0.1)
    holding_back.levels["camera"] = "CAUTION"
    holding_back.run(0.1)
    before = len(holding_back.verdicts)
    for step in range(20):
        holding_back.levels["camera"] = None if step % 2 else "CAUTION"
        holding_back.run(0.1)
    holding_back.levels["camera"] = None
    holding_back.run(2.0)
    assert {verdict.level for verdict in holding_back.verdicts[before:]} == {"CAUTION"}


def test_what_was_imminent_is_never_held_back(holding_back: Any) -> None:
    """IMMINENT for 0.33 s, then CAUTION at 0.82 m, unknown to the detector."""
    holding_back.levels["lidar"] = "IMMINENT"
    holding_back.run(0.3)
    holding_back.levels["lidar"] = "CAUTION"
    assert {level for level, _ in holding_back.outcomes(5.0)} == {"IMMINENT", "CAUTION"}
    assert not any(verdict.suppressed for verdict in holding_back.verdicts)


def test_one_missed_message_does_not_refill_the_suppression(holding_back: Any) -> None:
    """The lidar sees something for 0.9 s, misses one message, and so on."""
    before = len(holding_back.verdicts)
    for _ in range(10):
        holding_back.levels["lidar"] = "CAUTION"
        holding_back.run(0.9)
        holding_back.levels["lidar"] = "SAFE"
        holding_back.run(0.1)
    assert {verdict.level for verdict in holding_back.verdicts[before + 22 :]} == {"CAUTION"}


def test_by_default_nothing_is_held_back(bench: Any) -> None:
    bench.levels["lidar"] = "CAUTION"
    assert bench.run(0.1).level == "CAUTION"
