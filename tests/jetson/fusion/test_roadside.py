"""Roadside tracks: carried to now, into the vehicle's frame, and into its outline; they raise and never lower."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.geometry import pose_2d
from common.messages import EgoMotion, ObjectTrack
from services.jetson.fusion.config import FusionConfig, RoadsideConfig
from services.jetson.fusion.roadside import (
    RoadsideAlarm,
    Threat,
    compensate,
    find_threat,
    relative_motion,
    tabulate,
    time_to_enter,
)
from services.jetson.fusion.vehicle import rigid

CONFIG = RoadsideConfig(sigmas=0.0, acceleration_mps2=0.0, front_m=0.5, rear_m=0.5, half_width_m=0.5)
HERE = np.eye(4)


def track(x_m: float, y_m: float, vx_mps: float, vy_mps: float, **more: Any) -> ObjectTrack:
    fields: dict[str, Any] = {
        "track_id": 3, "label": "car", "label_confidence": 0.9, "position_m": (x_m, y_m, 0.8),
        "velocity_mps": (vx_mps, vy_mps, 0.0), "covariance": (np.eye(6) * 1e-6).tolist(), "size_m": (1.0, 1.0, 1.5),
        "yaw_rad": 0.0, "age_s": 3.0, "score": 0.9, "state": "confirmed", "points": 50,
    }  # fmt: skip
    return ObjectTrack(**(fields | more))


def threat(*tracks: ObjectTrack, age_s: float = 0.0, pose: np.ndarray = HERE, speed: float = 0.0, **config: Any) -> Any:
    settings = {"sigmas": 0.0, "acceleration_mps2": 0.0, "front_m": 0.5, "rear_m": 0.5, "half_width_m": 0.5} | config
    return find_threat(tabulate(list(tracks)), age_s, pose, speed, 0.0, RoadsideConfig(**settings))


def test_a_car_that_comes_straight_at_us() -> None:
    """10 m ahead at 4 m/s; outline 0.5 m plus the car's radius 0.5 m: 9 m to go, 2.25 s."""
    found = threat(track(10.0, 0.0, -4.0, 0.0))
    assert found is not None
    assert (found.level, found.deciding["ttc_s"], found.deciding["track_id"]) == ("CAUTION", 2.25, 3)
    assert found.distance_m == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("speed_mps", "level"),
    [(2.9, None), (3.0, None), (3.01, "CAUTION"), (5.9, "CAUTION"), (6.0, "CAUTION"), (6.01, "IMMINENT")],
)
def test_the_limits_of_time_to_collision(speed_mps: float, level: str | None) -> None:
    found = threat(track(10.0, 0.0, -speed_mps, 0.0))
    assert (found.level if found else None) == level


@pytest.mark.parametrize(
    "harmless",
    [
        track(10.0, 3.0, -4.0, 0.0),  # passes beside
        track(10.0, 0.0, 4.0, 0.0),  # drives away
        track(5.0, 0.0, 0.0, 0.0),  # stands
        track(4.0, -4.0, 0.0, 4.0),  # crosses in front
        track(0.1, 0.1, -1.0, 0.0),  # is the vehicle itself
        track(5.0, 0.0, -4.0, 0.0, state="tentative"),
        track(5.0, 0.0, -4.0, 0.0, label="background"),
        track(5.0, 0.0, -4.0, 0.0, covariance=(np.eye(6) * 9.0).tolist()),  # could be anywhere
    ],
)
def test_what_does_not_run_into_us(harmless: ObjectTrack) -> None:
    assert threat(harmless) is None


def test_the_limits_are_inclusive() -> None:
    low, high = np.array([[-1.0, -1.0]]), np.array([[1.0, 1.0]])
    for edge in (1.0, -1.0):
        assert time_to_enter(np.array([[5.0, edge]]), np.array([[-1.0, 0.0]]), low, high).tolist() == [4.0]
    assert time_to_enter(np.array([[1.0, 0.0]]), np.array([[1.0, 0.0]]), low, high).tolist() == [0.0], "leaves now"
    assert time_to_enter(np.array([[-2.0, 0.0]]), np.array([[1.0, 1.0]]), low, high).tolist() == [1.0], "a corner"
    assert threat(track(1.4, 0.0, -0.5, 0.0), min_speed_mps=0.5) is not None, "just fast enough"
    assert threat(track(1.4, 0.0, -0.49, 0.0), min_speed_mps=0.5) is None
    for sigma_m, found in ((2.0, True), (2.1, False)):
        covariance = (np.eye(6) * sigma_m**2).tolist()
        assert (threat(track(5.0, 0.0, -4.0, 0.0, covariance=covariance)) is not None) == found


@pytest.mark.parametrize(("vx_mps", "found"), [(-0.01, True), (0.0, False), (0.05, False)])
def test_only_what_comes_nearer_counts_even_beside_us(vx_mps: float, found: bool) -> None:
    assert (threat(track(1.0, 0.0, vx_mps, 1.0)) is not None) == found


def test_the_explanation_is_rounded_for_people() -> None:
    covariance = (np.eye(6) * 0.05).tolist()
    found = threat(track(10.004, 0.0, -3.304, 0.0, covariance=covariance))
    assert found is not None
    assert (found.deciding["position_m"], found.deciding["velocity_mps"]) == ([10.0, 0.0], [-3.3, 0.0])
    assert (found.deciding["ttc_s"], found.deciding["sigma_m"]) == (2.73, 0.22)


def test_what_has_no_class_keeps_its_right_to_alarm() -> None:
    assert threat(track(5.0, 0.0, -4.0, 0.0, label="unknown")) is not None


def test_the_most_urgent_track_decides() -> None:
    found = threat(track(10.0, 0.0, -4.0, 0.0, track_id=1), track(0.0, -6.0, 0.0, 4.0, track_id=2))
    assert found is not None
    assert (found.level, found.deciding["track_id"]) == ("IMMINENT", 2)


def test_latency_is_compensated() -> None:
    """Seen 0.5 s ago at 10 m: it is at 8 m now, 7 m to go, 1.75 s."""
    found = threat(track(10.0, 0.0, -4.0, 0.0), age_s=0.5)
    assert found is not None
    assert found.deciding["ttc_s"] == 1.75


def test_our_own_motion_counts() -> None:
    found = threat(track(10.0, 0.0, 0.0, 0.0), speed=4.0)
    assert found is not None
    assert found.deciding["ttc_s"] == 2.25
    assert threat(track(10.0, 0.0, 4.0, 0.0), speed=4.0) is None, "drives ahead of us at our speed"


def test_the_vehicles_pose_places_the_track() -> None:
    """We stand at (100, 50) and look along y: a car coming down the y axis is ahead of us."""
    pose = pose_2d(100.0, 50.0, math.pi / 2)
    found = threat(track(100.0, 60.0, 0.0, -4.0), pose=pose)
    assert found is not None
    assert found.deciding["position_m"] == [10.0, 0.0]
    assert threat(track(10.0, 0.0, -4.0, 0.0), pose=pose) is None


def test_uncertainty_grows_with_age_and_widens_the_outline() -> None:
    covariance = np.diag([0.04, 0.04, 0.04, 1.0, 1.0, 1.0])
    table = tabulate([track(10.0, 0.0, -4.0, 0.0, covariance=covariance.tolist())])
    _, young = compensate(table, 0.0, 2.0)
    _, old = compensate(table, 0.5, 2.0)
    assert young[0] == pytest.approx(0.2)
    assert old[0] == pytest.approx(math.sqrt(0.04 + 0.25 * 1.0 + 0.25**2))
    beside = track(10.0, 1.1, -4.0, 0.0, covariance=covariance.tolist())
    assert threat(beside) is None
    assert threat(beside, sigmas=1.0) is not None


def test_a_turning_vehicle_sees_the_world_turn() -> None:
    position, velocity = relative_motion(np.array([[5.0, 2.0, 7.0]]), np.zeros((1, 3)), HERE, 1.0, 0.2)
    assert position.tolist() == [[5.0, 2.0]]
    assert velocity[0] == pytest.approx([-0.6, -1.0])


def test_the_longer_side_and_the_larger_uncertainty_count() -> None:
    for size_m in ((1.0, 3.0, 9.0), (3.0, 1.0, 9.0)):
        assert tabulate([track(0.0, 0.0, 0.0, 0.0, size_m=size_m)]).radius_m.tolist() == [1.5]
    covariance = np.diag([0.01, 0.09, 25.0, 1.0, 1.0, 1.0]).tolist()
    _, sigma_m = compensate(tabulate([track(0.0, 0.0, 0.0, 0.0, covariance=covariance)]), 0.0, 0.0)
    assert sigma_m[0] == pytest.approx(0.3)


@pytest.mark.parametrize("at", [(0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)])
def test_the_edge_of_the_outline_is_still_the_vehicle_itself(at: tuple[float, float]) -> None:
    assert threat(track(*at, -2.0 * at[0], -2.0 * at[1])) is None


MILLIMETRES = st.integers(-20_000, 20_000).map(lambda value: value / 1000)


@given(st.tuples(MILLIMETRES, MILLIMETRES), st.tuples(MILLIMETRES, MILLIMETRES))
def test_entering_agrees_with_small_steps(start: tuple[float, float], velocity: tuple[float, float]) -> None:
    position, speed = np.array([start]), np.array([velocity])
    low, high = np.array([[-1.0, -1.0]]), np.array([[1.0, 1.0]])
    (enter_s,) = time_to_enter(position, speed, low, high)
    times = np.arange(0.0, 10.0, 0.01)
    path = position + times[:, None] * speed
    inside = (np.abs(path) <= 1.0 - 1e-9).all(axis=1)
    if inside.any():
        assert enter_s <= times[inside][0] + 1e-9
        assert enter_s >= times[inside][0] - 0.01 - 1e-9
    elif np.isfinite(enter_s) and enter_s < 9.9:
        grazed = position + enter_s * speed
        assert np.abs(grazed).max() <= 1.0 + 1e-6, "a corner cut between two steps"


def test_rigid_transforms_only() -> None:
    assert rigid(pose_2d(3.0, 4.0, 0.5)) is not None
    for bad in (np.zeros((4, 4)), 2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0])):
        assert rigid(bad) is None


@given(st.lists(st.sampled_from([None, "CAUTION", "IMMINENT"]), max_size=40))
def test_raise_three_clear_four(levels: list[Any]) -> None:
    """Against a plain rule: a level stands when the last three were all at it, and until four were all below it."""
    alarm = RoadsideAlarm(RoadsideConfig())
    ranks = [0 if level is None else 1 + (level == "IMMINENT") for level in levels]
    expected = 0
    for count, level in enumerate(levels, start=1):
        told = alarm.update(None if level is None else Threat(level, 1.0, {}))
        for band in (1, 2):
            if count >= 3 and all(rank >= band for rank in ranks[count - 3 : count]):
                expected = max(expected, band)
        for band in (2, 1):
            if count >= 4 and expected >= band and all(rank < band for rank in ranks[count - 4 : count]):
                expected = band - 1
        assert told == (None, "CAUTION", "IMMINENT")[expected]


def with_roadside(new_bench: Any, **settings: Any) -> Any:
    bench = new_bench(FusionConfig(roadside=RoadsideConfig(enabled=True, **settings)))
    bench.run(1.0)
    return bench


def test_off_by_default(bench: Any) -> None:
    bench.extra["infra_lidar"] = {"tracks": [track(3.0, 0.0, -4.0, 0.0)]}
    assert bench.run(1.0).level == "SAFE"
    assert "infra_lidar" not in bench.verdict.inputs


def test_the_roadside_raises_the_verdict_and_says_why(new_bench: Any) -> None:
    bench = with_roadside(new_bench)
    assert bench.verdict.level == "SAFE"
    bench.extra["infra_lidar"] = {"tracks": [track(3.0, 0.0, -4.0, 0.0)]}
    assert bench.run(0.2).level == "SAFE", "two messages are not enough"
    verdict = bench.run(0.1)
    assert (verdict.level, verdict.rule) == ("IMMINENT", "I1-roadside")
    assert verdict.deciding["track_id"] == 3
    assert verdict.inputs["infra_lidar"].used
    bench.extra["infra_lidar"] = {}
    assert bench.run(0.3).level == "IMMINENT", "three empty messages are not enough"
    assert bench.run(0.1).level == "SAFE"


@pytest.mark.parametrize("fault", ["kill", "silent"])
def test_a_roadside_that_is_gone_changes_nothing_else(new_bench: Any, fault: str) -> None:
    bench = with_roadside(new_bench)
    bench.kill("infra_lidar") if fault == "kill" else bench.silent.add("infra_lidar")
    verdict = bench.run(1.0)
    assert (verdict.level, verdict.permission) == ("SAFE", "GO")
    assert (bench.health.colour, bench.health.summary) == ("green", "ALL SENSORS ONLINE")
    assert bench.is_in("infra_lidar", "disconnected")
    assert not verdict.inputs["infra_lidar"].used


def test_a_clear_roadside_lowers_nothing(new_bench: Any) -> None:
    bench = with_roadside(new_bench)
    bench.levels["lidar"] = "IMMINENT"
    assert bench.run(0.3).level == "IMMINENT"


def test_ego_motion_places_the_vehicle_and_a_lost_pose_ends_the_help(new_bench: Any) -> None:
    bench = with_roadside(new_bench, pose_x_m=500.0)
    bench.extra["infra_lidar"] = {"tracks": [track(103.0, 0.0, -4.0, 0.0)]}
    assert bench.run(0.5).level == "SAFE"
    pose = pose_2d(100.0, 0.0, 0.0).tolist()
    for _ in range(6):
        motion = EgoMotion(stamp_ns=bench.now_ns, speed_mps=0.0, yaw_rate_radps=0.0, T_map_vehicle=pose)
        bench.receive("jetson0/ego/motion", motion)
        bench.tick()
    assert bench.verdict.level == "IMMINENT"
    verdict = bench.run(1.0)
    assert verdict.level == "SAFE"
    assert "pose is unknown" in verdict.inputs["infra_lidar"].why
