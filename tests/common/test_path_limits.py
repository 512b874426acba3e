"""The way ahead at its edges: a plain loop beside the fast one, limits to the last digit, exact figures."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.path import STEP_S, Motion, Mount, MovingPoint, Path, PathConfig, pose_after, stopping_m

CONFIG = PathConfig()
HALF_M = CONFIG.width_m / 2 + CONFIG.side_margin_m
STRAIGHT = Motion(2.0, 0.0, 0.0, 0.0)


def plain_contact_s(motion: Motion, point: MovingPoint, horizon_s: float, sigmas: float) -> float | None:
    """Step by step, each with the whole covariance carried on: F P F^T with F = [I, t I]."""
    before_m = 0.0
    for step in range(len(np.arange(0.0, horizon_s + STEP_S, STEP_S))):
        t = step * STEP_S
        turned = motion.yaw_rate_radps * t
        along = motion.speed_mps * t
        if abs(turned) > 1e-9:
            radius = motion.speed_mps / motion.yaw_rate_radps
            place = np.array([radius * math.sin(turned), radius * (1.0 - math.cos(turned))])
        else:
            place = np.array([along, 0.0])
        x, y = point.position_m + point.velocity_mps * t - place
        ahead = math.cos(turned) * x + math.sin(turned) * y - CONFIG.front_m
        left = math.cos(turned) * y - math.sin(turned) * x
        F = np.hstack([np.eye(2), t * np.eye(2)])
        across = np.array([-math.sin(turned), math.cos(turned)])
        variance = across @ (F @ point.covariance @ F.T) @ across
        bend = motion.yaw_rate_sigma_radps / motion.speed_mps
        doubt = sigmas * math.sqrt(max(0.0, variance + (0.5 * bend * along**2) ** 2))
        if -CONFIG.front_m - CONFIG.rear_m <= ahead <= 0.0 and abs(left) <= HALF_M + doubt:
            if step == 0 or before_m <= 0.0:
                return t
            return t - STEP_S * (1.0 - before_m / (before_m - ahead))
        before_m = ahead
    return None


def agrees(motion: Motion, point: MovingPoint) -> bool:
    """Whether both say the same to a microsecond."""
    found = Path(CONFIG, motion).time_to_contact_s(point, 1.5, sigmas=0.7)
    expected = plain_contact_s(motion, point, 1.5, 0.7)
    if found is None or expected is None:
        return found is expected
    return abs(found - expected) < 1e-6


small = st.floats(-1.0, 1.0)


@given(
    st.floats(0.5, 4.0), st.floats(-1.2, 1.2), st.floats(0.0, 0.3), st.floats(-0.5, 4.0), st.floats(-1.5, 1.5),
    st.lists(small, min_size=18, max_size=18),
)  # fmt: skip
def test_contact_is_that_of_the_plain_loop(
    speed_mps: float, yaw_rate: float, yaw_sigma: float, x_m: float, y_m: float, rest: list[float]
) -> None:
    root = 0.4 * np.array(rest[:16]).reshape(4, 4)
    point = MovingPoint(np.array([x_m, y_m]), np.array(rest[16:]), root @ root.T)
    assert agrees(Motion(speed_mps, yaw_rate, 0.0, yaw_sigma), point)


def test_contact_is_that_of_the_plain_loop_in_a_thousand_drawn_cases() -> None:
    rng = np.random.default_rng(1)
    for _ in range(1000):
        motion = Motion(rng.uniform(0.5, 4.0), rng.uniform(-1.2, 1.2), 0.0, rng.uniform(0.0, 0.3))
        root = 0.4 * rng.uniform(-1.0, 1.0, (4, 4))
        place = np.array([rng.uniform(-0.5, 4.0), rng.uniform(-1.5, 1.5)])
        assert agrees(motion, MovingPoint(place, rng.uniform(-1.0, 1.0, 2), root @ root.T))


@pytest.mark.parametrize(
    ("x_m", "y_m", "v_mps", "expected_s"),
    [
        (1.213, 0.0, 0.0, 0.5065),
        (0.23, 0.0, 0.0, 0.015),  # within the first step
        (0.0, 0.3455, -1.0, 0.2),  # abreast, steps into the side
        (0.1, HALF_M, 0.0, 0.0),
        (1.2, HALF_M - 1e-4, 0.0, 0.5),
        (1.2, HALF_M + 1e-4, 0.0, None),
    ],
)
def test_a_straight_drive_to_the_millimetre(x_m: float, y_m: float, v_mps: float, expected_s: float | None) -> None:
    motion = STRAIGHT if v_mps == 0.0 else Motion(0.1, 0.0, 0.0, 0.0)
    point = MovingPoint(np.array([x_m, y_m]), np.array([0.0, v_mps]), np.zeros((4, 4)))
    found = Path(CONFIG, motion).time_to_contact_s(point, 2.0)
    assert found == (None if expected_s is None else pytest.approx(expected_s, abs=1e-6))


@pytest.mark.parametrize(("y_m", "hit"), [(HALF_M + 0.094, True), (HALF_M + 0.1, False)])
def test_an_uncertain_bend_widens_the_way_by_its_sagitta(y_m: float, hit: bool) -> None:
    """0.005 / m times the square of the 4.4 m until the rear is level: 0.097 m."""
    path = Path(CONFIG, Motion(2.0, 0.0, 0.0, 0.02))
    point = MovingPoint(np.array([4.2, y_m]), np.zeros(2), np.zeros((4, 4)))
    assert (path.time_to_contact_s(point, 4.0) is not None) == hit


def test_where_the_vehicle_is_after_a_turn() -> None:
    turned, place = pose_after(Motion(2.0, 0.5), np.array([2.0]))
    assert turned[0] == 1.0
    assert place[:, 0] == pytest.approx([4.0 * math.sin(1.0), 4.0 * (1.0 - math.cos(1.0))])


def test_moving_begins_at_its_limit() -> None:
    at, below = CONFIG.moving_mps, CONFIG.moving_mps - 1e-9
    assert stopping_m(at, CONFIG) > 0.1
    assert stopping_m(below, CONFIG) == 0.0
    assert Path(CONFIG, Motion(at, 0.05)).curvature_per_m == pytest.approx(0.5)
    assert Path(CONFIG, Motion(below, 0.05)).curvature_per_m == 0.0
    assert Path(CONFIG, Motion(0.2, 2.0)).curvature_per_m == 4.0  # on the spot
    assert Mount(0.0, 0.0).yaw_rad == 0.0


def test_the_outer_side_swings_out_by_its_longer_end() -> None:
    config = msgspec.structs.replace(CONFIG, front_m=0.5)
    left_turn = Path(config, Motion(1.0, 0.5))
    half_m = config.width_m / 2
    assert left_turn.left_m == half_m
    assert left_turn.right_m == pytest.approx(math.hypot(2.0 + half_m, 0.5) - 2.0)


def test_the_strip_ends_exactly_at_its_margin() -> None:
    path = Path(CONFIG, STRAIGHT)
    edge_m = path.left_m + CONFIG.side_margin_m
    ahead = np.array([0.0, 0.05, -1e-9, 1.0, 1.0, 1.0, 1.0])
    beside = np.array([0.0, 0.0, 0.0, edge_m, -edge_m, edge_m + 1e-9, -edge_m - 1e-9])
    assert path.contains(ahead, beside).tolist() == [True, True, False, True, True, False, False]


def test_behind_the_origin_nothing_spreads() -> None:
    assert Path(CONFIG, Motion(2.0, 0.0, 0.0, 0.2)).spread_m(np.array([-5.0]))[0] == 0.0


@pytest.mark.parametrize(("y_m", "down"), [(0.05, -1.0), (0.0, 1.0), (-0.05, 1.0)])
def test_towards_a_straight_way(y_m: float, down: float) -> None:
    assert Path(CONFIG, STRAIGHT).towards(np.array([1.0, y_m])).tolist() == [0.0, down]


def test_near_the_centre_of_the_turn_everything_is_a_number() -> None:
    path = Path(CONFIG, Motion(1.0, 2.0))  # radius 0.5 m
    near = np.array([[0.0, 0.5], [0.05, 0.45], [0.0, 0.38]])
    assert np.all(np.isfinite(path.locate(near)))
    assert np.all(np.isfinite(path.place(np.zeros(3), np.array([0.5, 0.45, 0.38]))))


@pytest.mark.parametrize(
    ("field", "value", "allowed"),
    [
        ("width_m", 0.05, True), ("width_m", 0.0, False), ("width_m", 50.0, True), ("width_m", 50.1, False),
        ("front_m", 0.0, True), ("front_m", 50.0, True), ("front_m", 50.1, False), ("front_m", -0.1, False),
    ],
)  # fmt: skip
def test_lengths_have_limits(field: str, value: float, allowed: bool) -> None:
    if allowed:
        assert getattr(msgspec.convert({field: value}, PathConfig), field) == value
    else:
        with pytest.raises(msgspec.ValidationError, match=field):
            msgspec.convert({field: value}, PathConfig)
