"""Two outlines on their ways: cases worked by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from services.jetson.fusion.outlines import Boxes, Outline, time_to_touch

OWN = Outline(0.5, 0.5, 0.5)
HORIZON_S = 3.0
Box = tuple[float, float, float, float, float, float, float]  # x, y, vx, vy, heading, length, width


def boxes(*rows: Box, covariance: np.ndarray | None = None) -> Boxes:
    table = np.array(rows, float)
    spread = np.zeros((len(rows), 4, 4)) if covariance is None else np.broadcast_to(covariance, (len(rows), 4, 4))
    return Boxes(table[:, :2], table[:, 2:4], table[:, 4], table[:, 5:7] / 2, spread)


@pytest.mark.parametrize(
    ("row", "expected_s"),
    [
        ((5.0, 0.0, -2.0, 0.0, 0.0, 2.0, 1.0), 1.75),  # 3.5 m of air
        ((5.0, 0.0, -2.0, 0.0, math.pi / 2, 2.0, 1.0), 2.0),  # broadside: 4 m
        ((5.0, 1.01, -2.0, 0.0, 0.0, 2.0, 1.0), math.inf),  # a centimetre beside
        ((5.0, 1.0, -2.0, 0.0, 0.0, 2.0, 1.0), 1.75),  # just touches
        ((0.9, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0), 0.0),
        ((0.0, -40.0, 0.0, 39.0, math.pi / 2, 1.0, 0.2), 1.0),  # crosses in a twentieth of a second
        ((6.9, 0.0, -2.0, 0.0, 0.0, 1.0, 1.0), 2.95),  # shortly before the horizon
        ((7.1, 0.0, -2.0, 0.0, 0.0, 1.0, 1.0), math.inf),
        ((-4.0, 0.0, 2.0, 0.0, 0.0, 1.0, 1.0), 1.5),  # from behind
        ((1.25, 0.0, -1.0, 0.0, 0.0, 1.0, 1.0), 0.25),
        ((0.5, 2.54, -1.0, -1.0, 0.0, 1.0, 1.0), math.inf),  # has passed behind us 0.04 s before it is level with us
        ((0.5, 2.46, -1.0, -1.0, 0.0, 1.0, 1.0), 1.46),
        ((1.05, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0), math.inf),  # stands 5 cm away
    ],
)
def test_by_hand(row: Box, expected_s: float) -> None:
    assert time_to_touch(boxes(row), OWN, HORIZON_S, 0.0).tolist() == pytest.approx([expected_s])


@pytest.mark.parametrize(("speed", "yaw_rate"), [(2.0, 0.6), (-1.0, 0.5), (3.0, -0.4), (1.5, 0.0)])
def test_the_vehicle_drives_an_arc(speed: float, yaw_rate: float) -> None:
    """Against many small straight pieces."""
    own, steps = Outline(0.5, 0.5, 0.5, speed, yaw_rate), 30_000
    heading = yaw_rate * np.linspace(0.0, HORIZON_S, steps)
    way = speed * HORIZON_S / steps * np.column_stack([np.cos(heading), np.sin(heading)])
    turned, place = own.pose_after(np.array([HORIZON_S]))
    assert turned[0] == pytest.approx(yaw_rate * HORIZON_S)
    assert place[0] == pytest.approx(way.sum(axis=0), abs=1e-3)


@pytest.mark.parametrize(("speed", "yaw_rate", "at_s"), [(2.0, 0.6, 1.0), (2.0, 0.6, 2.5), (3.0, -0.4, 2.0)])
def test_a_post_on_the_arc_is_hit_when_we_get_there(speed: float, yaw_rate: float, at_s: float) -> None:
    """A post of 2 cm before the middle of the bumper, where that will be."""
    own = Outline(0.5, 0.5, 0.5, speed, yaw_rate)
    turned, place = own.pose_after(np.array([at_s]))
    x, y = place[0] + 0.51 * np.array([math.cos(turned[0]), math.sin(turned[0])])
    post = (float(x), float(y), 0.0, 0.0, float(turned[0]), 0.02, 0.02)
    assert time_to_touch(boxes(post), own, HORIZON_S, 0.0)[0] == pytest.approx(at_s, abs=0.02)


@pytest.mark.parametrize(("outside_m", "touch_s"), [(0.45, 2.5), (0.7, math.inf), (1.0, math.inf)])
@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_a_post_outside_the_bend_is_hit_by_the_corner_or_passed(outside_m: float, touch_s: float, turn: float) -> None:
    """86 degrees round; the outer corner drives 3.86 m round, the posts stand 3.82, 4.07 and 4.36 m from the middle."""
    own = Outline(0.5, 0.5, 0.5, 2.0, 0.6 * turn)
    turned, place = own.pose_after(np.array([2.5]))
    cos, sin = math.cos(turned[0]), math.sin(turned[0])
    x, y = place[0] + [cos * 0.51 + sin * outside_m * turn, sin * 0.51 - cos * outside_m * turn]
    post = (float(x), float(y), 0.0, 0.0, float(turned[0]), 0.02, 0.02)
    assert time_to_touch(boxes(post), own, HORIZON_S, 0.0)[0] == pytest.approx(touch_s, abs=0.02)


def test_a_diagonal_box_is_not_a_circle() -> None:
    """A bus of 12 m under 45 degrees passes a corner that its circle would cover."""
    assert time_to_touch(boxes((4.0, -4.0, 0.0, 0.0, -math.pi / 4, 12.0, 2.5)), OWN, HORIZON_S, 0.0)[0] == 0.0
    assert time_to_touch(boxes((4.0, -4.0, 0.0, 0.0, math.pi / 4, 12.0, 2.5)), OWN, HORIZON_S, 0.0)[0] == math.inf


def test_none_at_all() -> None:
    nobody = Boxes(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 4, 4)))
    assert time_to_touch(nobody, OWN, HORIZON_S, 1.0).shape == (0,)


def test_touching_now() -> None:
    """From the edge on; the last does so after 5 ms."""
    rows = boxes(
        *((x_m, 0.0, vx_mps, 0.0, 0.0, 1.0, 1.0) for x_m, vx_mps in ((1.3, 0), (1.0, 1), (0.9, 0), (1.005, -1)))
    )
    assert time_to_touch(rows, OWN, 0.0, 0.0).tolist() == [math.inf, 0.0, 0.0, math.inf]
    assert time_to_touch(rows, OWN, 1.0, 0.0).tolist() == pytest.approx([math.inf, 0.0, 0.0, 0.005])


@pytest.mark.parametrize(("x_m", "touch_s"), [(2.0, 1.0), (2.01, math.inf)])
def test_the_horizon_s_last_moment_belongs_to_it(x_m: float, touch_s: float) -> None:
    assert time_to_touch(boxes((x_m, 0.0, -1.0, 0.0, 0.0, 1.0, 1.0)), OWN, 1.0, 0.0).tolist() == [touch_s]


@pytest.mark.parametrize(("y_m", "touch_s"), [(1.0625, 0.05), (1.0875, math.inf)])
def test_two_corners_that_meet_for_an_instant_touch(y_m: float, touch_s: float) -> None:
    """One side leaves after 0.05 s; the other comes at that moment, or 0.02 s later."""
    assert time_to_touch(boxes((0.9375, y_m, 1.25, -1.25, 0.0, 1.0, 1.0)), OWN, 1.0, 0.0).tolist() == [touch_s]


@pytest.mark.parametrize(("row", "touch_s"), [((6.0, -2.0), 1.5), ((-4.0, 2.0), 1.5), ((-4.0, 1.0), 3.0)])
def test_the_origin_need_not_be_in_the_middle_of_the_vehicle(row: tuple[float, float], touch_s: float) -> None:
    """2.0 m to the front, 0.0 m to the rear; a box of 2 m before and behind."""
    moving = boxes((row[0], 0.0, row[1], 0.0, 0.0, 2.0, 1.0))
    assert time_to_touch(moving, Outline(2.0, 0.0, 0.5), 4.0, 0.0).tolist() == pytest.approx([touch_s])


@pytest.mark.parametrize(
    ("y_m", "sigmas", "hits"),
    [(1.29, 1.0, True), (1.31, 1.0, False), (1.59, 2.0, True), (1.61, 2.0, False), (1.01, 0.0, False)],
)
def test_uncertainty_of_the_place_counts_across_the_motion_only(y_m: float, sigmas: float, hits: bool) -> None:
    """0.3 m to the side and 5 m along: sideways it widens, along it moves nothing."""
    covariance = np.diag([25.0, 0.09, 0.0, 0.0])
    (touch_s,) = time_to_touch(boxes((5.0, y_m, -2.0, 0.0, 0.0, 2.0, 1.0), covariance=covariance), OWN, 3.0, sigmas)
    assert touch_s == (pytest.approx(1.75) if hits else math.inf)


@pytest.mark.parametrize(("x_m", "hits"), [(1.29, True), (1.31, False)])
def test_what_comes_from_the_side_is_widened_along_our_own_way(x_m: float, hits: bool) -> None:
    covariance = np.diag([0.09, 25.0, 0.0, 4.0])
    (touch_s,) = time_to_touch(boxes((x_m, 5.0, 0.0, -2.0, 0.0, 1.0, 1.0), covariance=covariance), OWN, 3.0, 1.0)
    assert (touch_s < math.inf) == hits


def crosswise(row: Box, covariance: np.ndarray) -> tuple[Box, np.ndarray]:
    """The same from the left instead of from ahead: x and y change places."""
    x, y, vx, vy, heading, length, width = row
    swap = [1, 0, 3, 2]
    return (y, x, vy, vx, heading, width, length), covariance[np.ix_(swap, swap)]


@pytest.mark.parametrize("from_the_left", [False, True])
@pytest.mark.parametrize(("y_m", "hits"), [(1.39, True), (1.51, False)])
def test_uncertainty_of_the_velocity_grows_on_the_way(y_m: float, hits: bool, from_the_left: bool) -> None:
    """0.2 m/s to the side: 0.35 m when it is here after 1.75 s, 0.45 m when it has passed after 2.25 s."""
    row, covariance = (4.0, y_m, -2.0, 0.0, 0.0, 1.0, 1.0), np.diag([0.0, 0.0, 1.0, 0.04])
    if from_the_left:
        row, covariance = crosswise(row, covariance)
    (touch_s,) = time_to_touch(boxes(row, covariance=covariance), OWN, 3.0, 1.0)
    assert (touch_s < math.inf) == hits


@pytest.mark.parametrize("from_the_left", [False, True])
@pytest.mark.parametrize(("both", "touch_s"), [(-0.04, math.inf), (0.04, 1.0)])
def test_place_and_velocity_may_depend_on_each_other(both: float, touch_s: float, from_the_left: bool) -> None:
    """Known exactly for in a second: what is uncertain now is taken back by then; along it moves nothing."""
    covariance = np.array([[1.0, 0.0, 0.5, 0.0], [0.0, 0.04, 0.0, both], [0.5, 0.0, 1.0, 0.0], [0.0, both, 0.0, 0.04]])
    row = (3.0, 1.05, -2.0, 0.0, 0.0, 1.0, 1.0)
    if from_the_left:
        row, covariance = crosswise(row, covariance)
    moving = boxes(row, covariance=covariance)
    assert time_to_touch(moving, OWN, 1.1, 1.0)[0] == pytest.approx(touch_s)


@pytest.mark.parametrize(("one", "other"), [(0.08, 0.0), (0.0, 0.08)])
def test_what_links_place_and_velocity_counts_from_both_sides(one: float, other: float) -> None:
    covariance = np.zeros((4, 4))
    covariance[1, 1] = covariance[3, 3] = 0.04
    covariance[1, 3], covariance[3, 1] = one, other
    moving = boxes((3.0, 1.39, -2.0, 0.0, 0.0, 1.0, 1.0), covariance=covariance)
    assert time_to_touch(moving, OWN, 1.1, 1.0)[0] == pytest.approx(1.0), "0.4 m after a second"
