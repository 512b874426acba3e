"""Driving where nothing looks, and being blind with somebody else's advice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from common.messages import EgoMotion, ObjectTrack
from services.jetson.fusion.config import FusionConfig, RoadsideConfig, RulesConfig

STOP_OF = {"SAFE": "GO", "CAUTION": "SLOW", "IMMINENT": "STOP"}


def drive(bench: Any, speed_mps: float | None, seconds: float = 0.5) -> Any:
    """The verdict after so long at this speed, told at 20 Hz."""
    for _ in range(round(seconds / 0.05)):
        motion = EgoMotion(stamp_ns=bench.now_ns, speed_mps=speed_mps, yaw_rate_radps=0.0)
        bench.receive("jetson0/ego/motion", motion)
        bench.tick()
    return bench.verdict


@pytest.mark.parametrize(
    ("speed_mps", "rule"),
    [(-1.0, "M1-reversing"), (-0.1, "M1-reversing"), (-0.09, "R0-clear"), (0.0, "R0-clear"), (1.0, "R0-clear"),
     (None, "R0-clear")],
)  # fmt: skip
def test_reversing_is_not_safe_where_nothing_looks(bench: Any, speed_mps: float | None, rule: str) -> None:
    """All three sensors look ahead, are online and see nothing."""
    verdict = drive(bench, speed_mps)
    level = "SAFE" if rule == "R0-clear" else "CAUTION"
    assert (verdict.rule, verdict.level, verdict.permission) == (rule, level, STOP_OF[level])
    if level == "CAUTION":
        assert verdict.because == f"reversing at {-speed_mps:.1f} m/s, and no sensor looks back"
        assert verdict.to_lower == "the vehicle standing or driving forward"


def test_a_motion_that_nobody_renews_is_no_reversing_any_more(bench: Any) -> None:
    drive(bench, -1.0)
    assert bench.run(0.45).rule == "M1-reversing"
    assert bench.run(0.2).level == "SAFE"


def test_reversing_lowers_no_alarm(bench: Any) -> None:
    bench.levels["lidar"] = "IMMINENT"
    assert drive(bench, -1.0).level == "IMMINENT"


def test_a_sensor_that_looks_back_and_sees_nothing_makes_it_safe(new_bench: Any) -> None:
    bench = new_bench(FusionConfig(rules=RulesConfig(looks_back=("camera",))))
    bench.run(1.0)
    assert drive(bench, -1.0).level == "SAFE"
    bench.silent.add("camera")
    assert drive(bench, -1.0, 1.5).rule == "M1-reversing"


@pytest.mark.parametrize("speed_mps", [-8.0, -4.0])
def test_blind_is_said_first_and_the_advice_of_the_roadside_second(new_bench: Any, speed_mps: float) -> None:
    bench = new_bench(FusionConfig(roadside=RoadsideConfig(enabled=True)))
    bench.run(1.0)
    bench.silent |= {"lidar", "radar", "camera"}
    bench.run(2.0)
    own = "blind: LiDAR disconnected, radar disconnected, camera disconnected"
    assert (bench.verdict.rule, bench.verdict.because) == ("R7-blind", own)
    car = ObjectTrack(
        track_id=300_000_001, label="car", label_confidence=0.9, position_m=(11.0, 0.0, 0.8),
        velocity_mps=(speed_mps, 0.0, 0.0), covariance=(np.eye(6) * 1e-4).tolist(), size_m=(4.5, 1.8, 1.5),
        yaw_rad=0.0, age_s=3.0, score=0.9, state="confirmed", points=50,
    )  # fmt: skip
    bench.extra["infra_lidar"] = {"tracks": [car]}
    verdict = bench.run(0.5)
    level = "IMMINENT" if speed_mps == -8.0 else "CAUTION"
    assert (verdict.level, verdict.blind, verdict.permission) == (level, True, "STOP")
    assert verdict.because.startswith(f"{own}; roadside LiDAR {level} at ")
    assert "300" not in verdict.because
