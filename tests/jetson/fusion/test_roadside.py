"""Roadside tracks: carried to now, into the vehicle's frame, and into its outline; they raise and never lower."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.geometry import pose_2d
from common.messages import ObjectTrack, ObjectTracks
from services.jetson.fusion.config import RoadsideConfig
from services.jetson.fusion.outlines import Outline
from services.jetson.fusion.roadside import RoadsideAlarm, RoadsideWatch, Threat, counting, find_threat, look_around
from services.jetson.fusion.vehicle import Vehicle, rigid

HERE = np.eye(4)
SQUARE = {"sigmas": 0.0, "acceleration_mps2": 0.0, "front_m": 0.5, "rear_m": 0.5, "half_width_m": 0.5}


def track(x_m: float, y_m: float, vx_mps: float, vy_mps: float, **more: Any) -> ObjectTrack:
    fields: dict[str, Any] = {
        "track_id": 3, "label": "car", "label_confidence": 0.9, "position_m": (x_m, y_m, 0.8),
        "velocity_mps": (vx_mps, vy_mps, 0.0), "covariance": (np.eye(6) * 1e-6).tolist(), "size_m": (1.0, 1.0, 1.5),
        "yaw_rad": 0.0, "age_s": 3.0, "score": 0.9, "state": "confirmed", "points": 50,
    }  # fmt: skip
    return ObjectTrack(**(fields | more))


def around(*tracks: ObjectTrack, age_s: float = 0.0, pose: np.ndarray = HERE, own: Outline | None = None) -> Any:
    return look_around(counting(list(tracks)), age_s, pose, own or Outline(0.5, 0.5, 0.5), 2.0)


def threat(
    *tracks: ObjectTrack, age_s: float = 0.0, pose: np.ndarray = HERE, speed: float = 0.0, yaw_rate: float = 0.0,
    **settings: Any,
) -> Any:  # fmt: skip
    own_id = settings.pop("own_id", None)
    config = RoadsideConfig(**(SQUARE | settings))
    own = Outline(config.front_m, config.rear_m, config.half_width_m, speed, yaw_rate)
    seen = look_around(counting(list(tracks)), age_s, pose, own, config.acceleration_mps2)
    return find_threat(seen, own, own_id, config)


def test_a_car_that_comes_straight_at_us() -> None:
    """10 m ahead at 4 m/s; outline 0.5 m plus half the car's length of 1 m: 9 m to go, 2.25 s."""
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


def test_touching_just_at_the_limit_is_not_within_it() -> None:
    limits = {"caution_ttc_s": 1.0, "imminent_ttc_s": 0.5}
    assert threat(track(10.0, 0.0, -9.0, 0.0), **limits) is None
    assert threat(track(10.0, 0.0, -9.01, 0.0), **limits) is not None


@pytest.mark.parametrize(
    "harmless",
    [
        track(10.0, 3.0, -4.0, 0.0),  # passes beside
        track(10.0, 0.0, 4.0, 0.0),  # drives away
        track(5.0, 0.0, 0.0, 0.0),  # stands
        track(4.0, -4.0, 0.0, 4.0),  # crosses in front
        track(5.0, 0.0, -4.0, 0.0, state="tentative"),
        track(5.0, 0.0, -4.0, 0.0, label="background"),
        track(5.0, 0.0, -4.0, 0.0, covariance=(np.eye(6) * 9.0).tolist()),  # could be anywhere
    ],
)
def test_what_does_not_run_into_us(harmless: ObjectTrack) -> None:
    assert threat(harmless) is None


def test_the_limits_are_inclusive() -> None:
    assert threat(track(1.4, 0.0, -0.5, 0.0), min_speed_mps=0.5) is not None, "just fast enough"
    assert threat(track(1.4, 0.0, -0.49, 0.0), min_speed_mps=0.5) is None
    for sigma_m, found in ((2.0, True), (2.1, False)):
        covariance = (np.eye(6) * sigma_m**2).tolist()
        assert (threat(track(5.0, 0.0, -4.0, 0.0, covariance=covariance)) is not None) == found


def test_ourselves_are_no_threat_to_us() -> None:
    assert threat(track(0.4, 0.0, -1.0, 0.0)) is not None
    assert threat(track(0.4, 0.0, -1.0, 0.0), own_id=3) is None
    both = (track(0.4, 0.0, -1.0, 0.0), track(5.0, 0.0, -4.0, 0.0, track_id=4))
    assert threat(*both, own_id=3).deciding["track_id"] == 4


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


def test_uncertainty_grows_with_age_and_widens_the_outline_sideways() -> None:
    covariance = np.diag([0.04, 0.04, 0.04, 1.0, 1.0, 1.0]).tolist()
    young, old = (around(track(10.0, 0.0, -4.0, 0.0, covariance=covariance), age_s=age_s) for age_s in (0.0, 0.5))
    assert young.sigma_m[0] == pytest.approx(0.2)
    assert old.sigma_m[0] == pytest.approx(math.sqrt(0.04 + 0.25 * 1.0 + 0.25**2))
    beside = track(10.0, 1.1, -4.0, 0.0, covariance=covariance)
    assert threat(beside) is None
    assert threat(beside, sigmas=1.0) is not None
    straight = track(10.0, 0.0, -4.0, 0.0, covariance=covariance)
    assert threat(straight, sigmas=1.0).deciding["ttc_s"] == 2.25, "how far away it is does not move the moment"


def test_a_turning_vehicle_sees_the_world_turn() -> None:
    seen = around(track(5.0, 2.0, 0.0, 0.0), own=Outline(0.5, 0.5, 0.5, 1.0, 0.2))
    assert seen.boxes.centre_m.tolist() == [[5.0, 2.0]]
    assert seen.relative_mps[0] == pytest.approx([-0.6, -1.0])


def test_a_curve_leads_past_what_lies_straight_ahead_and_into_what_stands_in_it() -> None:
    """2 m/s and 0.5 rad/s: a circle of 4 m radius. What stands 4 m ahead is passed; what stands on the arc is hit."""
    assert threat(track(4.0, 0.0, 0.0, 0.0), speed=2.0) is not None
    assert threat(track(4.0, -0.6, 0.0, 0.0), speed=2.0, yaw_rate=0.5) is None
    on_the_arc = track(4.0 * math.sin(1.0), 4.0 * (1 - math.cos(1.0)), 0.0, 0.0)
    assert threat(on_the_arc, speed=2.0, yaw_rate=0.5) is not None
    assert threat(on_the_arc, speed=2.0) is None


def test_the_larger_uncertainty_in_the_plane_counts() -> None:
    covariance = np.diag([0.01, 0.09, 25.0, 1.0, 1.0, 1.0]).tolist()
    assert around(track(0.0, 0.0, 0.0, 0.0, covariance=covariance)).sigma_m[0] == pytest.approx(0.3)


def turned(track_: ObjectTrack, T: np.ndarray, yaw_rad: float) -> ObjectTrack:
    """The same track in a map that is turned and shifted."""
    both = np.kron(np.eye(2), T[:3, :3])
    return msgspec.structs.replace(
        track_,
        position_m=tuple(T[:3, :3] @ track_.position_m + T[:3, 3]),
        velocity_mps=tuple(T[:3, :3] @ track_.velocity_mps),
        covariance=(both @ np.array(track_.covariance) @ both.T).tolist(),
        yaw_rad=track_.yaw_rad + yaw_rad,
    )


@pytest.mark.parametrize("yaw_rad", [0.7, math.pi / 2, -2.4])
def test_it_does_not_matter_how_the_map_lies(yaw_rad: float) -> None:
    root = np.random.default_rng(5).normal(size=(6, 6))
    covariance = (root @ root.T).tolist()
    seen = track(4.0, -2.0, -3.0, 1.0, covariance=covariance, yaw_rad=0.4, size_m=(5.0, 2.0, 1.5))
    T, own = pose_2d(30.0, -12.0, yaw_rad, 2.0), Outline(0.5, 0.5, 0.5, 1.0, 0.3)
    here, there = around(seen, age_s=0.2, own=own), around(turned(seen, T, yaw_rad), age_s=0.2, pose=T, own=own)
    for one, other in zip([*here.boxes, *here[2:]], [*there.boxes, *there[2:]], strict=True):
        assert one == pytest.approx(other)


def test_the_covariance_is_that_of_place_and_velocity_in_the_plane() -> None:
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    covariance[0, 4] = covariance[4, 0] = 0.5
    plane = around(track(1.0, 2.0, 0.0, 0.0, covariance=covariance.tolist())).boxes.covariance[0]
    assert plane.tolist() == [[1.0, 0.0, 0.0, 0.5], [0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 4.0, 0.0], [0.5, 0.0, 0.0, 5.0]]


def test_nobody_around() -> None:
    seen = around()
    assert (seen.sigma_m.shape, seen.beside_m.shape, seen.boxes.covariance.shape) == ((0,), (0,), (0, 4, 4))


@pytest.mark.parametrize(("own_error_m", "level"), [(0.5, None), (0.49, "IMMINENT")])
def test_exactly_as_far_beside_us_as_allowed_may_be_us(own_error_m: float, level: str | None) -> None:
    """Nobody knows how we move; the track's middle is 0.5 m before the outline and its box touches it."""
    watch = RoadsideWatch(RoadsideConfig(**SQUARE, own_error_m=own_error_m))
    vehicle = Vehicle(None, None, None, HERE, is_configured=False)
    for stamp_ns in range(3):
        watch.take(ObjectTracks(stamp_ns=stamp_ns, tracks=[track(1.0, 0.0, -1.0, 0.0)]), 0.0, vehicle)
    assert watch.level == level


def test_without_a_pose_no_track_can_be_placed() -> None:
    with pytest.raises(ValueError, match="pose"):
        RoadsideWatch(RoadsideConfig()).take(ObjectTracks(stamp_ns=1, tracks=[]), 0.0, Vehicle(None, None, None, None))


@pytest.mark.parametrize(
    ("x_m", "y_m", "beside_m"),
    [(0.5, -0.5, 0.0), (0.75, 0.0, 0.25), (-0.8, 0.0, 0.3), (0.0, -0.9, 0.4), (0.8, 0.9, 0.5), (0.1, 0.2, 0.0)],
)
def test_how_far_beside_our_outline_a_track_is(x_m: float, y_m: float, beside_m: float) -> None:
    assert around(track(x_m, y_m, 0.0, 0.0)).beside_m[0] == pytest.approx(beside_m)


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
        result = alarm.update(None if level is None else Threat(level, 1.0, {}))
        for band in (1, 2):
            if count >= 3 and all(rank >= band for rank in ranks[count - 3 : count]):
                expected = max(expected, band)
        for band in (2, 1):
            if count >= 4 and expected >= band and all(rank < band for rank in ranks[count - 4 : count]):
                expected = band - 1
        assert result == (None, "CAUTION", "IMMINENT")[expected]
