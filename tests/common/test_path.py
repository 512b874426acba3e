"""The way ahead: the swept strip and times to contact against a slow vehicle that is moved step by step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from common.path import (
    Motion,
    MovingPoint,
    Path,
    PathConfig,
    carried,
    is_driving,
    pose_after,
    safe_speed_mps,
    stopping_m,
)

CONFIG = PathConfig()
CERTAIN = np.zeros((4, 4))
speeds = st.floats(0.3, 6.0)
yaw_rates = st.floats(-1.5, 1.5)


def standing(x_m: float, y_m: float, sigma_m: float = 0.0) -> MovingPoint:
    covariance = np.zeros((4, 4))
    covariance[0, 0] = covariance[1, 1] = sigma_m**2
    return MovingPoint(np.array([x_m, y_m]), np.zeros(2), covariance)


def moving(x_m: float, y_m: float, u_mps: float, v_mps: float) -> MovingPoint:
    return MovingPoint(np.array([x_m, y_m]), np.array([u_mps, v_mps]), CERTAIN)


def slow_contact_s(point: MovingPoint, motion: Motion, horizon_s: float, side_m: float) -> float | None:
    """The vehicle moved in steps of a millisecond, its outline as a rectangle."""
    x = y = heading = 0.0
    dt = 1e-3
    for step in range(round(horizon_s / dt)):
        gone = point.position_m + point.velocity_mps * step * dt - (x, y)
        ahead = math.cos(heading) * gone[0] + math.sin(heading) * gone[1]
        left = math.cos(heading) * gone[1] - math.sin(heading) * gone[0]
        if -CONFIG.rear_m <= ahead <= CONFIG.front_m and abs(left) <= CONFIG.width_m / 2 + side_m:
            return step * dt
        middle = heading + motion.yaw_rate_radps * dt / 2
        x, y = x + motion.speed_mps * dt * math.cos(middle), y + motion.speed_mps * dt * math.sin(middle)
        heading += motion.yaw_rate_radps * dt
    return None


@pytest.mark.parametrize(
    ("speed_mps", "expected_m"),
    [(0.0, 0.0), (0.09, 0.0), (1.0, 0.5 + 1 / 6 + 0.1), (2.0, 1.0 + 4 / 6 + 0.1), (-1.0, 0.5 + 1 / 6 + 0.1)],
)
def test_the_stopping_distance_is_reaction_braking_and_margin(speed_mps: float, expected_m: float) -> None:
    assert stopping_m(speed_mps, CONFIG) == pytest.approx(expected_m)


@given(st.floats(0.15, 20.0))
def test_the_safe_speed_is_the_inverse_of_the_stopping_distance(speed_mps: float) -> None:
    assert safe_speed_mps(stopping_m(speed_mps, CONFIG), CONFIG) == pytest.approx(speed_mps)


def test_no_room_is_no_speed() -> None:
    assert safe_speed_mps(0.0, CONFIG) == 0.0
    assert safe_speed_mps(CONFIG.stop_margin_m, CONFIG) == 0.0


@pytest.mark.parametrize(
    ("motion", "driving"),
    [(None, False), (Motion(0.0), False), (Motion(0.1), True), (Motion(0.09), False), (Motion(-1.0), False)],
)
def test_driving_is_forward_and_known(motion: Motion | None, driving: bool) -> None:
    assert is_driving(motion, CONFIG) is driving


def test_straight_ahead_is_counted_from_the_bumper() -> None:
    ahead, beside = Path(CONFIG, Motion(2.0)).locate(np.array([[1.2, 0.3], [0.2, -0.1], [-0.3, 0.0]]))
    assert ahead == pytest.approx([1.0, 0.0, -0.5])
    assert beside == pytest.approx([0.3, -0.1, 0.0])


def test_a_standing_or_unknown_vehicle_looks_straight_ahead() -> None:
    for motion in (None, Motion(0.0, 1.0), Motion(0.05, -0.5)):
        path = Path(CONFIG, motion)
        assert path.curvature_per_m == 0.0
        assert path.stopping_m == 0.0
        assert path.spread_m(np.array([3.0]))[0] == 0.0


@given(speeds, yaw_rates, st.floats(0.0, 3.0), st.floats(-0.3, 0.3))
def test_locate_and_place_are_inverse(speed_mps: float, yaw_radps: float, ahead_m: float, beside_m: float) -> None:
    path = Path(CONFIG, Motion(speed_mps, yaw_radps))
    assume(abs(path.curvature_per_m) * (ahead_m + 0.4) < 2.5)  # less than most of a turn
    assume(abs(path.curvature_per_m) < 1.5)
    point = path.place(np.array([ahead_m]), np.array([beside_m]))
    ahead, beside = path.locate(point)
    assert ahead[0] == pytest.approx(ahead_m, abs=1e-6)
    assert beside[0] == pytest.approx(beside_m, abs=1e-6)


@given(speeds, yaw_rates, st.floats(0.2, 4.0), st.floats(-1.5, 1.5))
def test_left_and_right_are_mirrored(speed_mps: float, yaw_radps: float, x_m: float, y_m: float) -> None:
    path, mirror = Path(CONFIG, Motion(speed_mps, yaw_radps)), Path(CONFIG, Motion(speed_mps, -yaw_radps))
    (ahead,), (beside,) = path.locate(np.array([[x_m, y_m]]))
    (ahead_m,), (beside_m,) = mirror.locate(np.array([[x_m, -y_m]]))
    assert (ahead, beside) == pytest.approx((ahead_m, -beside_m))
    assert (path.left_m, path.right_m) == pytest.approx((mirror.right_m, mirror.left_m))


@pytest.mark.parametrize("yaw_radps", [-1.0, -0.4, 0.0, 0.3, 1.0])
@pytest.mark.parametrize("speed_mps", [0.8, 2.0])
def test_the_strip_is_what_the_outline_sweeps(speed_mps: float, yaw_radps: float) -> None:
    """Points near the edges: inside the strip exactly when the slow vehicle touches them, and as far ahead."""
    motion = Motion(speed_mps, yaw_radps)
    path = Path(CONFIG, motion)
    for ahead_m in (0.3, 1.0):
        for edge_m in (path.left_m, -path.right_m):
            for beyond_m, hit in ((-0.015, True), (0.015, False)):
                beside_m = edge_m + math.copysign(beyond_m, beyond_m * edge_m)
                (point,) = path.place(np.array([ahead_m]), np.array([beside_m]))
                contact_s = slow_contact_s(standing(*point), motion, 3.0, 0.0)
                assert (contact_s is not None) is hit
                inside = abs(beside_m) <= (path.left_m if edge_m > 0 else path.right_m)
                assert inside is hit
    (point,) = path.place(np.array([1.0]), np.array([0.0]))
    assert slow_contact_s(standing(*point), motion, 3.0, 0.0) == pytest.approx(1.0 / speed_mps, abs=2e-3)


def test_the_strip_holds_the_margin_and_the_uncertainty() -> None:
    path = Path(CONFIG, Motion(2.0))
    edge = CONFIG.width_m / 2 + CONFIG.side_margin_m
    ahead, beside = np.array([1.0, 1.0, -0.1]), np.array([edge - 0.01, edge + 0.01, 0.0])
    assert path.contains(ahead, beside).tolist() == [True, False, False]
    assert path.contains(ahead, -beside, 0.02).tolist() == [True, True, False]


def test_the_path_spreads_with_the_uncertainty_of_the_yaw_rate() -> None:
    path = Path(CONFIG, Motion(2.0, 0.0, 0.05, 0.1))
    assert path.spread_m(np.array([0.8, 1.8])) == pytest.approx([0.025, 0.1])


@given(speeds, yaw_rates, st.floats(0.3, 4.0), st.floats(-1.0, 1.0), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_time_to_contact_is_that_of_the_slow_vehicle(
    speed_mps: float, yaw_radps: float, x_m: float, y_m: float, u_mps: float, v_mps: float
) -> None:
    motion, point = Motion(speed_mps, yaw_radps, 0.0, 0.0), moving(x_m, y_m, u_mps, v_mps)
    margin = CONFIG.side_margin_m
    touched, widely = (slow_contact_s(point, motion, 1.5, m) for m in (margin - 0.06, margin + 0.06))
    found = Path(CONFIG, motion).time_to_contact_s(point, 1.5)
    if touched is not None and touched < 1.4:  # found whenever it touches well inside ...
        assert found is not None
        assert found < touched + 0.06
    if found is not None and found < 1.45:  # ... and never when it passes well outside
        assert widely is not None
        assert widely < found + 0.06


@pytest.mark.parametrize(
    ("point", "expected_s"),
    [
        (standing(3.2, 0.0), 1.5),  # 3 m ahead of the bumper at 2 m/s
        (standing(3.2, 0.9), None),  # a parked car beside
        (moving(2.2, 1.5, 0.0, -1.5), 1.0),  # walks into the way
        (moving(2.2, 3.0, 0.0, -1.5), None),  # comes when we have passed
        (moving(3.2, 1.0, -2.0, 0.0), None),  # oncoming, beside
        (moving(3.2, 0.0, -2.0, 0.0), 0.75),
        (moving(3.2, 0.0, 2.0, 0.0), None),  # drives with us
        (standing(0.1, 0.05), 0.0),  # inside
        (standing(-1.0, 0.0), None),  # behind
    ],
)
def test_what_meets_a_straight_drive(point: MovingPoint, expected_s: float | None) -> None:
    found = Path(CONFIG, Motion(2.0, 0.0, 0.0, 0.0)).time_to_contact_s(point, 4.0)
    assert found == (None if expected_s is None else pytest.approx(expected_s, abs=0.06))


def test_uncertainty_widens_to_the_side_only() -> None:
    path = Path(CONFIG, Motion(2.0, 0.0, 0.0, 0.0))
    assert path.time_to_contact_s(standing(3.2, 0.5), 4.0) is None
    assert path.time_to_contact_s(standing(3.2, 0.5, 0.4), 4.0) == pytest.approx(1.5, abs=1e-6)
    assert path.time_to_contact_s(standing(3.2, 0.5, 0.2), 4.0) is None
    assert path.time_to_contact_s(standing(3.2, 0.5, 0.2), 4.0, sigmas=2.0) is not None


def test_an_unknown_sideways_velocity_counts_the_more_the_later() -> None:
    path = Path(CONFIG, Motion(2.0, 0.0, 0.0, 0.0))
    unknown = np.diag([0.0, 0.0, 0.0, 0.25])
    for x_m, hit in ((1.2, False), (4.2, True)):
        point = MovingPoint(np.array([x_m, 0.7]), np.zeros(2), unknown)
        assert (path.time_to_contact_s(point, 4.0) is not None) is hit


def test_an_uncertain_yaw_rate_widens_the_far_end() -> None:
    sure, unsure = Motion(2.0, 0.0, 0.0, 0.0), Motion(2.0, 0.0, 0.0, 0.2)
    assert Path(CONFIG, sure).time_to_contact_s(standing(4.2, 0.5), 4.0) is None
    assert Path(CONFIG, unsure).time_to_contact_s(standing(4.2, 0.5), 4.0) is not None
    assert Path(CONFIG, unsure).time_to_contact_s(standing(1.2, 0.5), 4.0) is None


@given(speeds, yaw_rates, st.floats(0.0, 1.0))
def test_carried_points_stand_still_over_ground(speed_mps: float, yaw_radps: float, t_s: float) -> None:
    motion, point = Motion(speed_mps, yaw_radps), np.array([2.0, 0.7])
    (seen,) = carried(point[None], motion, np.array([t_s]))
    (turned,), place = pose_after(motion, np.array([t_s]))
    back = place[:, 0] + np.array(
        [
            math.cos(turned) * seen[0] - math.sin(turned) * seen[1],
            math.sin(turned) * seen[0] + math.cos(turned) * seen[1],
        ]
    )
    assert back == pytest.approx(point)


def test_what_is_hardly_known_is_not_everywhere() -> None:
    """A body 1.5 m beside whose speed across the way is unknown: in it by its uncertainty, unless that is bounded."""
    covariance = np.diag([0.01, 0.01, 0.01, 1.0])
    beside = MovingPoint(np.array([4.0, 1.5]), np.zeros(2), covariance)
    ahead = MovingPoint(np.array([4.0, 0.3]), np.zeros(2), covariance)
    path = Path(CONFIG, Motion(2.0))
    assert path.time_to_contact_s(beside, 4.0) is not None
    assert path.time_to_contact_s(beside, 4.0, widest_m=0.5) is None
    assert path.time_to_contact_s(ahead, 4.0, widest_m=0.5) is not None


@given(speeds, yaw_rates, st.floats(-3.0, 6.0), st.floats(-3.0, 3.0))
def test_a_step_towards_the_way_is_a_step_nearer_to_it(speed: float, yaw_rate: float, x_m: float, y_m: float) -> None:
    path = Path(CONFIG, Motion(speed, yaw_rate))
    place, step_m = np.array([x_m, y_m]), 1e-4
    _, (beside_m, then_m) = path.locate(np.array([place, place + step_m * path.towards(place)]))
    assume(abs(beside_m) > 2 * step_m)
    assume(abs(path.curvature_per_m * beside_m) < 0.99)  # the middle of the circle is as far from all of it
    assert abs(beside_m) - abs(then_m) == pytest.approx(step_m, rel=1e-3)
