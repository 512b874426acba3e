"""Places by hand: numbers beside each limit, on both sides of it."""

from __future__ import annotations

import math

import pytest

from services.jetson.fusion.evidence import Place
from services.jetson.fusion.places import FORGET_M, HALF_VIEW_DEG, carried, gap_m, in_view, is_behind, is_beside


def test_the_gap_is_between_the_edges() -> None:
    assert gap_m(Place(0.0, 0.0, 0.1), Place(3.0, 4.0, 0.4)) == pytest.approx(4.5)
    assert gap_m(Place(1.0, 1.0, 0.2), Place(1.0, 1.1, 0.2)) == pytest.approx(-0.3)
    assert FORGET_M == 15.0


@pytest.mark.parametrize(
    ("sensor", "half_deg"), [("lidar", 20.0), ("camera", 18.0), ("radar", 60.0), ("infra_lidar", 60.0), ("sonar", 60.0)]
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_what_each_sensor_looks_at(sensor: str, half_deg: float, side: float) -> None:
    for off_deg, seen in ((-0.1, True), (0.1, False)):
        bearing = math.radians(half_deg + off_deg) * side
        assert in_view(sensor, Place(2.0 * math.cos(bearing), 2.0 * math.sin(bearing), 0.0)) == seen


def test_an_edge_in_view_is_enough_and_the_unknown_is_ahead() -> None:
    """0.2 m round at 1 m covers asin(0.2) = 11.5 degrees: seen from 31.5 degrees inwards."""
    for bearing_deg, seen in ((31.4, True), (31.7, False)):
        bearing = math.radians(bearing_deg)
        assert in_view("lidar", Place(math.cos(bearing), math.sin(bearing), 0.2)) == seen
    assert in_view("camera", None)
    assert not in_view("radar", Place(-1.0, 0.0, 0.1))


@pytest.mark.parametrize(("x_m", "seen"), [(-0.1, True), (-0.125, True), (-0.13, False)])
def test_what_is_around_the_sensor_itself_is_in_view(x_m: float, seen: bool) -> None:
    """On its edge, behind: at a right angle the circle begins, which the lidar does not look at."""
    assert in_view("lidar", Place(x_m, 0.0, 0.125)) == seen


def test_exactly_on_the_limit_of_the_view_is_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(HALF_VIEW_DEG, "a line", 0.0)
    assert in_view("a line", Place(1.0, 0.0, 0.0))
    assert not in_view("a line", Place(1.0, 1e-9, 0.0))


def test_places_move_as_we_move() -> None:
    assert carried(Place(1.0, 0.5, 0.1), 0.4, 0.0, 0.3) == Place(0.6, 0.5, 0.1)
    turned = carried(Place(1.0, 0.5, 0.1), 0.0, math.radians(90.0), 0.3)
    assert turned == pytest.approx((0.5, -1.0, 0.1)), "we turned left: it is on our right"
    both = carried(Place(1.0, 0.5, 0.1), 0.4, math.radians(-30.0), 0.3)
    assert both == pytest.approx((0.6 * math.cos(0.5236) - 0.25, 0.5 * math.cos(0.5236) + 0.3, 0.1), abs=1e-4)


@pytest.mark.parametrize(
    ("place", "x_m"),
    [
        (Place(0.1, 0.2, 0.1), 0.0),  # before our width: it does not pass through us
        (Place(0.1, -0.2, 0.1), 0.0),
        (Place(0.0, 0.2, 0.1), 0.0),  # at the bumper already
        (Place(0.5, 0.2, 0.1), 0.2),  # not there yet
        (Place(0.3, 0.2, 0.1), 0.0),
        (Place(0.1, 0.5, 0.1), -0.2),  # beside us
        (Place(0.1, 0.375, 0.125), 0.0),  # reaches 5 cm into our width
        (Place(0.1, 0.425, 0.125), -0.2),  # touches it and no more
        (Place(-0.1, 0.2, 0.1), -0.4),  # was beside or behind before
    ],
)
def test_nothing_passes_through_us(place: Place, x_m: float) -> None:
    """0.3 m forward; half our width is 0.3 m."""
    assert carried(place, 0.3, 0.0, 0.3).x_m == pytest.approx(x_m)


@pytest.mark.parametrize(
    ("x_m", "travelled_m", "behind"),
    [(-0.71, 0.0, True), (-0.69, 0.0, False), (-1.0, 0.99, True), (-1.0, 1.01, False), (0.7, 0.0, False)],
)
def test_left_behind_is_past_our_rear_whatever_the_motion_s_error(x_m: float, travelled_m: float, behind: bool) -> None:
    """Radius 0.1 m, length 0.6 m, error 0.3 of the way: after 1 m it has to be 1.0 m back."""
    assert is_behind(Place(x_m, 0.5, 0.1), travelled_m, 0.6) == behind


@pytest.mark.parametrize(
    ("y_m", "travelled_m", "beside"),
    [(0.51, 0.0, True), (-0.51, 0.0, True), (0.49, 0.0, False), (0.8, 0.9, True), (-0.8, 1.1, False)],
)
def test_beside_is_off_our_way_whatever_the_motion_s_error(y_m: float, travelled_m: float, beside: bool) -> None:
    assert is_beside(Place(1.0, y_m, 0.1), travelled_m, 0.4) == beside


def test_exactly_on_our_rear_or_on_our_side_is_neither_behind_nor_beside() -> None:
    assert not is_behind(Place(-0.625, 0.5, 0.125), 0.0, 0.5)
    assert not is_beside(Place(1.0, -0.625, 0.125), 0.0, 0.5)
