"""What the roadside's tracks do to the verdict: they raise it, and a roadside that is clear or gone lowers nothing."""

from __future__ import annotations

from typing import Any

import pytest

from common.geometry import pose_2d
from common.messages import EgoMotion
from services.jetson.fusion.config import FusionConfig, RoadsideConfig


def with_roadside(new_bench: Any, **settings: Any) -> Any:
    bench = new_bench(FusionConfig(roadside=RoadsideConfig(enabled=True, **settings)))
    bench.run(1.0)
    return bench


def test_off_by_default(bench: Any, messages: Any) -> None:
    bench.extra["infra_lidar"] = {"tracks": [messages.car()]}
    assert bench.run(1.0).level == "SAFE"
    assert "infra_lidar" not in bench.verdict.inputs


def test_the_roadside_raises_the_verdict_and_says_why(new_bench: Any, messages: Any) -> None:
    bench = with_roadside(new_bench)
    assert bench.verdict.level == "SAFE"
    bench.extra["infra_lidar"] = {"tracks": [messages.car()]}
    assert bench.run(0.2).level == "SAFE", "two messages are not enough"
    verdict = bench.run(0.1)
    assert (verdict.level, verdict.rule) == ("IMMINENT", "I1-roadside")
    assert verdict.deciding["track_id"] == 3
    assert verdict.inputs["infra_lidar"].used
    bench.extra["infra_lidar"] = {}
    assert bench.run(1.0).level == "IMMINENT", "four empty messages to call it clear, then seven that are"
    assert bench.run(0.1).level == "SAFE"


@pytest.mark.parametrize("fault", ["kill", "silent"])
def test_a_roadside_that_is_gone_changes_nothing_else(new_bench: Any, fault: str) -> None:
    bench = with_roadside(new_bench)
    bench.kill("infra_lidar") if fault == "kill" else bench.silent.add("infra_lidar")
    verdict = bench.run(1.0)
    assert (verdict.level, verdict.permission) == ("SAFE", "GO")
    assert (bench.health.colour, bench.health.summary) == (
        "green",
        "ALL VEHICLE SENSORS ONLINE; roadside LiDAR disconnected",
    )
    assert bench.is_in("infra_lidar", "disconnected")
    assert not verdict.inputs["infra_lidar"].used


def test_a_clear_roadside_lowers_nothing(new_bench: Any) -> None:
    bench = with_roadside(new_bench)
    bench.levels["lidar"] = "IMMINENT"
    assert bench.run(0.3).level == "IMMINENT"


def test_ego_motion_places_the_vehicle_and_a_lost_pose_ends_no_alarm(new_bench: Any, messages: Any) -> None:
    bench = with_roadside(new_bench, pose_x_m=500.0)
    bench.extra["infra_lidar"] = {"tracks": [messages.car(103.0)]}
    assert bench.run(0.5).level == "SAFE"
    pose = pose_2d(100.0, 0.0, 0.0).tolist()
    for _ in range(6):
        motion = EgoMotion(stamp_ns=bench.now_ns, speed_mps=0.0, yaw_rate_radps=0.0, T_map_vehicle=pose)
        bench.receive("jetson0/ego/motion", motion)
        bench.tick()
    assert bench.verdict.level == "IMMINENT"
    verdict = bench.run(1.0)
    assert (verdict.level, verdict.rule) == ("IMMINENT", "H1-held")
    assert "pose is unknown" in verdict.inputs["infra_lidar"].why
