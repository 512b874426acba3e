"""Distances in lanes, and how many returns it takes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.messages import LaserScan
from services.jetson.lidar.config import LidarConfig, MountingSection, ZonesSection
from services.jetson.lidar.filters import RejectReason, judge, returns_of
from services.jetson.lidar.zones import LaneScanner, lane_of, level_of, points_near, points_needed

Scan = Callable[..., LaserScan]


def nearest(scan: LaserScan, config: LidarConfig | None = None) -> list[float | None]:
    config = config or LidarConfig()
    returns = returns_of(scan, config.mounting)
    used = judge(returns, config.filter, config.mounting) == RejectReason.USED
    return [one.nearest_m for one in LaneScanner(config.zones).measure(returns, used)]


@pytest.mark.parametrize(
    ("name", "things", "expected"),
    [
        ("nothing", [], [None, None, None]),
        ("ahead", [(1.0, -0.1, 0.1)], [None, 1.0, None]),
        ("left is positive y", [(1.0, 0.14, 0.30)], [1.0, None, None]),
        ("right", [(1.0, -0.30, -0.14)], [None, None, 1.0]),
        ("a wall across", [(1.5, -3.0, 3.0)], [1.5, 1.5, 1.5]),
        ("beyond the look-ahead", [(3.05, -0.3, 0.3)], [None, None, None]),
        ("at the look-ahead", [(3.0, -0.3, 0.3)], [3.0, 3.0, 3.0]),
        ("beside all lanes", [(1.0, 0.33, 0.6)], [None, None, None]),
        ("outside the cone although in the lane", [(0.3, 0.13, 0.3)], [None, None, None]),
        ("the nearer of two", [(2.0, -0.12, 0.12), (0.9, -0.05, 0.05)], [None, 0.9, None]),
        ("a person's leg", [(2.0, -0.06, 0.06)], [None, 2.0, None]),
    ],
)
def test_known_geometry(scan_of: Scan, name: str, things: list, expected: list) -> None:
    for got, want in zip(nearest(scan_of(things)), expected, strict=True):
        assert got == (None if want is None else pytest.approx(want, abs=0.002)), name


def test_distance_counts_from_the_bumper(scan_of: Scan) -> None:
    set_back = LidarConfig(mounting=MountingSection(front_m=0.1))
    assert nearest(scan_of([(1.0, -0.1, 0.1)]), set_back)[1] == pytest.approx(0.9, abs=0.002)


def test_an_obstacle_on_the_line_between_two_lanes_keeps_its_votes(scan_of: Scan) -> None:
    left, centre, _ = nearest(scan_of([(0.5, 0.10, 0.15)]))  # 3 returns in each lane; 4 are needed at 0.5 m
    assert left == pytest.approx(0.5, abs=0.002)
    assert centre == pytest.approx(0.5, abs=0.002)


def test_far_points_do_not_vouch_for_a_near_ghost(scan_of: Scan) -> None:
    scan = scan_of([(1.6, -0.12, 0.12)])
    ghost = [224, 225, 226]  # three beams agree, so the neighbour filter believes them
    scan.ranges_m[ghost] = 0.4
    assert nearest(scan)[1] == pytest.approx(1.6, abs=0.002)


def test_points_needed_falls_with_distance_and_grows_with_the_density_of_beams() -> None:
    zones = ZonesSection()
    step = np.radians(0.8)
    ranges = np.array([0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 2.0, 3.0])
    assert points_needed(ranges, step, zones).tolist() == [6, 6, 5, 4, 3, 2, 2, 2]
    assert (points_needed(ranges, step / 2, zones) >= points_needed(ranges, step, zones)).all()


@pytest.mark.parametrize("width_m", [0.06, 0.10])
@pytest.mark.parametrize("distance_m", [0.25, 0.5, 1.0, 1.5, 2.0])
def test_the_smallest_object_is_seen(scan_of: Scan, width_m: float, distance_m: float) -> None:
    if width_m / distance_m < 3 * np.radians(0.8):
        pytest.skip("fewer than three beams hit it: only a bright one is believed")
    assert nearest(scan_of([(distance_m, -width_m / 2, width_m / 2)]))[1] == pytest.approx(distance_m, abs=0.002)


@given(st.lists(st.floats(0.0, 3.0), max_size=60), st.floats(0.01, 0.5))
def test_points_near_equals_the_obvious_count(x: list[float], near_m: float) -> None:
    obvious = [sum(a - near_m <= b <= a + near_m for b in x) for a in x]
    assert points_near(np.array(x), np.array(x), near_m).tolist() == obvious


def test_bands_are_inclusive_and_single_precision_does_not_matter(scan_of: Scan) -> None:
    zones = ZonesSection()
    levels = [level_of(d, zones) for d in (0.0, 0.8, 0.801, 1.8, 1.801, float("inf"))]
    assert levels == ["IMMINENT", "IMMINENT", "CAUTION", "CAUTION", "SAFE", "SAFE"]
    straight = np.array([-0.002, -0.001, 0.0, 0.001, 0.002])  # float32(0.8) is more than 0.8
    angles = np.concatenate([straight, np.radians(np.arange(3, 359, 0.8))]).astype(np.float32)
    ranges = np.where(np.arange(len(angles)) < 5, 0.8, 0.0).astype(np.float32)
    scan = LaserScan(stamp_ns=0, angles_rad=angles, ranges_m=ranges, confidence=np.full(len(angles), 200, np.uint8))
    assert nearest(scan)[1] == 0.8


@given(st.floats(-1.0, 1.0))
def test_lanes_are_mirror_images(y_m: float) -> None:
    zones = ZonesSection()
    here, there = lane_of(np.array([y_m]), zones)[0], lane_of(np.array([-y_m]), zones)[0]
    assert there == {0: 2, 1: 1, 2: 0, -1: -1}[int(here)]
