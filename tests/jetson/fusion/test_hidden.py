"""Places beside the way that could hide somebody, and how fast they may be passed."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.messages import Cover, Motion
from common.path import Path, PathConfig
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.coverage import cover_way
from services.jetson.fusion.hidden import beside, cover_far_m, hides, nearest_hidden_m, pass_speed_mps

PATH = PathConfig()  # 0.191 m wide, 3 m/s^2
FAR_M = 8.0
HALF_M = PATH.width_m / 2
Box = tuple[float, float, float, float]  # x from, to, y from, to; metres from the bumper and the middle


def lidar(*boxes: Box, yaw_rad: float = 0.0, **fields: Any) -> Cover:
    """What a lidar at the bumper says: for each sector of 2 degrees the nearest of five rays into the boxes."""
    far_m = []
    for sector in range(90):
        bearings = np.radians(-90.0 + 2.0 * sector + np.array([0.2, 0.6, 1.0, 1.4, 1.8]))
        far_m.append(min(_ray_m(float(bearing), box) for bearing in bearings for box in (*boxes, None)))
    fields = {"first_rad": -math.pi / 2 + yaw_rad, **fields}
    return Cover(x_m=PATH.front_m, y_m=0.0, step_rad=math.radians(2.0), far_m=far_m, **fields)


def _ray_m(bearing_rad: float, box: Box | None) -> float:
    """Where a ray from the origin enters an axis-parallel box (slab method)."""
    if box is None:
        return FAR_M
    enters, leaves = 0.0, math.inf
    for step, low, high in ((math.cos(bearing_rad), box[0], box[1]), (math.sin(bearing_rad), box[2], box[3])):
        a, b = sorted((low / step, high / step))
        enters, leaves = max(enters, a), min(leaves, b)
    return min(enters, FAR_M) if enters <= leaves and leaves > 0.0 else FAR_M


def thing(room_m: float, x_m: float, long_m: float, wide_m: float, side: float = 1.0) -> Box:
    """A box with that much room between it and the vehicle's outline."""
    near, far = side * (HALF_M + room_m), side * (HALF_M + room_m + wide_m)
    return x_m, x_m + long_m, min(near, far), max(near, far)


CAR = (4.3, 1.8)  # long, wide


@pytest.mark.parametrize(
    ("boxes", "expected_m"),
    [
        ([], None),
        ([thing(0.7, 4.0, *CAR)], 4.1),
        ([thing(0.7, 4.0, *CAR, side=-1.0)], 4.1),
        ([thing(0.7, 6.0, *CAR), thing(0.5, 3.0, *CAR, side=-1.0)], 3.1),
        ([thing(0.7, 3.0, 0.1, 2.5)], 3.2),  # a gate: behind its wall
        ([thing(0.5, 3.0, 0.3, 0.3)], None),  # a pillar
        ([thing(0.5, 3.0, 0.1, 0.1)], None),  # a post
        ([thing(1.3, 3.0, *CAR)], None),  # far enough beside
    ],
)
def test_what_hides_a_person(boxes: list[Box], expected_m: float | None) -> None:
    found = nearest_hidden_m(Path(PATH), [lidar(*boxes)], FAR_M)
    assert found == (None if expected_m is None else pytest.approx(expected_m, abs=0.15))


@pytest.mark.parametrize(("room_m", "found"), [(0.8, True), (0.9, False), (1.1, False)])
def test_it_has_to_begin_within_the_room(room_m: float, found: bool) -> None:
    assert (nearest_hidden_m(Path(PATH), [lidar(thing(room_m, 2.0, 3.0, 1.0))], FAR_M) is not None) == found


def test_only_as_far_as_the_way_is_seen() -> None:
    car = lidar(thing(0.7, 4.0, *CAR))
    assert nearest_hidden_m(Path(PATH), [car], 4.6) == pytest.approx(4.1, abs=0.15)
    assert nearest_hidden_m(Path(PATH), [car], 4.3) is None
    assert nearest_hidden_m(Path(PATH), [car], 0.35) is None
    abreast = lidar(thing(0.5, -1.0, *CAR))
    assert nearest_hidden_m(Path(PATH), [abreast], 0.5) == 0.0
    assert nearest_hidden_m(Path(PATH), [abreast], 0.4) is None
    assert nearest_hidden_m(Path(PATH), [car], 0.0) is None


def test_beside_the_arc_not_beside_the_nose() -> None:
    """In a left turn of 4 m radius a car to the left of the nose stands in the way, and one on the right is left."""
    arc = Path(PATH, Motion(2.0, 0.5))
    x, y = arc.place(np.array([2.5]), np.array([HALF_M + 0.6]))[0]
    inside = (x - PATH.front_m, x - PATH.front_m + 1.5, y, y + 1.5)
    assert nearest_hidden_m(arc, [lidar(inside)], FAR_M) == pytest.approx(2.6, abs=0.4)
    right = lidar(thing(0.7, 4.0, *CAR, side=-1.0))
    assert nearest_hidden_m(arc, [right], FAR_M) is None
    assert nearest_hidden_m(Path(PATH), [right], FAR_M) is not None


def test_what_says_nothing_hides_nothing() -> None:
    hiding = thing(0.7, 2.0, *CAR)
    assert nearest_hidden_m(Path(PATH), [None], FAR_M) is None
    assert nearest_hidden_m(Path(PATH), [lidar(hiding, standing=False)], FAR_M) is None
    assert nearest_hidden_m(Path(PATH), [None, lidar(), lidar(hiding)], FAR_M) is not None


SECTORS = Cover(x_m=0.0, y_m=0.0, first_rad=-0.3, step_rad=0.1, far_m=[2.0, 2.0, 2.0, 0.0, 5.0, 5.0])


@pytest.mark.parametrize(
    ("range_m", "bearing_rad", "hidden"),
    [
        (2.09, -0.15, False),  # the surface itself
        (2.11, -0.15, True),
        (2.99, -0.15, True),
        (3.01, -0.15, False),  # so far behind it the shadow is wide however narrow the thing is
        (2.5, -0.052, True),
        (2.5, -0.04, False),  # half a sector beside it the view does not end
        (2.5, -0.248, True),
        (2.5, -0.26, False),  # there it does not look
        (5.5, 0.2, False),  # the sensor's reach, nothing in between
        (0.5, 0.05, False),  # not measured
    ],
)
def test_hidden_is_close_behind_what_ends_the_view(range_m: float, bearing_rad: float, hidden: bool) -> None:
    place = np.array([[range_m * math.cos(bearing_rad), range_m * math.sin(bearing_rad)]])
    assert hides(SECTORS, place).tolist() == [hidden]
    moved = msgspec.structs.replace(SECTORS, x_m=1.0, y_m=-2.0)
    assert hides(moved, place + np.array([1.0, -2.0])).tolist() == [hidden]
    assert hides(SECTORS, -place).tolist() == [False]


def test_a_cover_without_sectors_hides_nothing() -> None:
    place = np.array([[2.5, -0.4]])
    assert hides(SECTORS, place).any()
    assert not hides(msgspec.structs.replace(SECTORS, step_rad=0.0), place).any()
    assert not hides(msgspec.structs.replace(SECTORS, far_m=[]), place).any()


@pytest.mark.parametrize(
    ("hidden_m", "limit_mps"),
    [(0.0, 3.0), (1.0, 3.0), (1.5, 3.0), (3.0, 3.9), (8.0, 6.2)],  # 1.5 m go by while the brakes begin to bite
)
def test_the_limit_falls_on_the_way_there(hidden_m: float, limit_mps: float) -> None:
    assert pass_speed_mps(hidden_m, PATH, 1.0) == pytest.approx(limit_mps, abs=0.05)


@given(st.floats(0.0, 12.0), st.floats(0.1, 3.0), st.floats(0.5, 8.0))
def test_braking_from_the_limit_passes_at_the_passing_speed(hidden_m: float, stop_s: float, brake_mps2: float) -> None:
    config = PathConfig(brake_mps2=brake_mps2)
    limit_mps, passing_mps = pass_speed_mps(hidden_m, config, stop_s), brake_mps2 * stop_s
    assert limit_mps >= passing_mps
    if limit_mps > passing_mps:
        takes_m = limit_mps * config.reaction_s + (limit_mps**2 - passing_mps**2) / (2 * brake_mps2)
        assert takes_m == pytest.approx(hidden_m, abs=1e-6)


@pytest.mark.parametrize(
    ("speed_mps", "too_fast"), [(3.0, False), (3.3, False), (3.4, True), (5.0, True)]
)  # 10 % for the measurement
def test_a_row_of_parked_cars_is_passed_slowly(speed_mps: float, too_fast: bool) -> None:
    row = {"lidar": lidar(thing(0.7, 1.0, *CAR), thing(0.7, 5.9, *CAR))}
    found = cover_way(Motion(speed_mps), PATH, row, {}, RulesConfig())
    assert (found.max_safe_speed_mps, found.too_fast, found.falls_short) == (3.0, too_fast, too_fast)
    assert found.limited_by == "somebody may stand unseen beside the way 1.1 m ahead"
    assert not cover_way(Motion(speed_mps), PATH, row, {}, RulesConfig(hidden_stop_s=2.0)).too_fast


def test_the_lowest_limit_is_told() -> None:
    plane = {"lidar": lidar(thing(0.7, 1.0, *CAR), only="what crosses its plane")}
    assert cover_way(Motion(2.0), PATH, plane, {}, RulesConfig()).limited_by.startswith("low boxes and panes")
    fast = cover_way(Motion(2.0), PATH, plane, {}, RulesConfig(partial_mps=3.5))
    assert (fast.max_safe_speed_mps, fast.limited_by[:8]) == (3.0, "somebody")


def test_far_looks_up_by_bearing() -> None:
    cover = msgspec.structs.replace(SECTORS, far_m=[1.0, 2.0, 3.0])
    bearings = np.array([-0.31, -0.29, -0.21, -0.19, -0.01, 0.01])
    assert cover_far_m(cover, bearings).tolist() == [0.0, 1.0, 1.0, 2.0, 3.0, 0.0]


def test_something_right_at_the_sensor_hides_too() -> None:
    cover = msgspec.structs.replace(SECTORS, far_m=[0.05, 0.05, 0.05, 5.0])
    assert hides(cover, np.array([[0.3, -0.05]])).tolist() == [True]
    straight = Cover(x_m=0.0, y_m=0.0, first_rad=-0.2, step_rad=0.1, far_m=[2.0, 2.0, 2.0, 2.0, 5.0])
    assert hides(straight, np.array([[3.0, 0.0]])).tolist() == [True]  # a metre behind it, to the millimetre


def test_the_places_begin_at_the_outline_and_at_the_bumper() -> None:
    left, right = beside(Path(PATH), 2)
    assert left[0] == pytest.approx([PATH.front_m + 0.05, HALF_M + 0.05])
    assert left[-1] == pytest.approx([PATH.front_m + 0.15, HALF_M + 1.35])
    assert right[-1] == pytest.approx([PATH.front_m + 0.15, -HALF_M - 1.35])
    turning = Path(PATH, Motion(2.0, 0.8))
    (left, right), first = beside(turning, 1), np.array([0.05])
    assert left[0] == pytest.approx(turning.place(first, np.array([turning.left_m + 0.05]))[0])
    assert right[0] == pytest.approx(turning.place(first, np.array([-turning.right_m - 0.05]))[0])


CONE = Cover(x_m=0.2, y_m=0.0, first_rad=-0.5, step_rad=1.0, far_m=[12.0])


@pytest.mark.parametrize(
    ("covers", "limit_mps"),
    [
        ({"lidar": lidar(), "camera": CONE}, None),
        ({"halves": msgspec.structs.replace(CONE, step_rad=0.5, far_m=[12.0, 12.0])}, None),
        ({"lidar": None, "camera": CONE}, 3.0),
        ({"camera": CONE}, 3.0),
        ({"lidar": lidar(standing=False), "camera": CONE}, 3.0),
        ({"lidar": msgspec.structs.replace(lidar(), far_m=[0.0] * 90), "camera": CONE}, 3.0),  # covered
    ],
)
def test_losing_the_sensor_that_shows_what_hides_lifts_no_limit(
    covers: dict[str, Cover | None], limit_mps: float | None
) -> None:
    found = cover_way(Motion(3.4), PATH, covers, {"lidar": "disconnected"}, RulesConfig())
    assert found.too_fast == (limit_mps is not None)
    if limit_mps is not None:
        assert found.max_safe_speed_mps == limit_mps
        assert found.limited_by == "no sensor shows what may hide somebody beside the way"
