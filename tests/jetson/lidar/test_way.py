"""The lidar on a vehicle that drives: lanes along the arc, bands for the stopping distance, no skew, honest cover."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from common.messages import LaserScan, LidarZones, Motion
from common.path import Path, pose_after, stopping_m
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.filters import RejectReason, returns_of
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.way import along_the_way, cover_of, zones_for

CONFIG = LidarConfig()
ScanOf = Callable[..., LaserScan]
SCAN_S = 0.1


def watched(scans: list[LaserScan], motion: Motion | None) -> list[LidarZones]:
    pipeline = LidarPipeline(CONFIG)
    return [pipeline.process(scan.stamp_ns, scan, motion) for scan in scans]


def approach(scan_of: ScanOf, speed_mps: float, begin_m: float, count: int) -> list[LaserScan]:
    """A board of 0.4 m straight ahead that comes nearer, before a wall far behind it."""
    return [scan_of([(begin_m - speed_mps * SCAN_S * k, -0.2, 0.2)], background_m=11.0, number=k) for k in range(count)]


@pytest.mark.parametrize("motion", [None, Motion(0.0), Motion(0.09), Motion(-1.0)])
def test_standing_reversing_or_unknown_is_as_ever(scan_of: ScanOf, motion: Motion | None) -> None:
    scans = approach(scan_of, 1.0, 2.5, 12)
    told, plain = watched(scans, motion), watched(scans, None)
    assert [(m.level, m.centre, m.left, m.right, m.layout) for m in told] == [
        (m.level, m.centre, m.left, m.right, m.layout) for m in plain
    ]


@pytest.mark.parametrize("speed_mps", [0.5, 1.0, 2.0, 3.0, 5.0])
def test_the_bands_reach_as_far_as_the_vehicle_needs_to_stop(speed_mps: float) -> None:
    zones, stop_m = zones_for(CONFIG, Motion(speed_mps)), stopping_m(speed_mps, CONFIG.path)
    assert zones.imminent_m == max(0.8, stop_m)
    assert zones.caution_m == pytest.approx(max(1.8, stop_m + 1.9 * speed_mps))
    assert zones.look_ahead_m == max(3.0, zones.caution_m + speed_mps)  # a second to know who drives ahead


@pytest.mark.parametrize(("speed_mps", "caution_m", "imminent_m"), [(1.0, 2.0, 0.75), (2.0, 4.5, 1.6), (3.0, 7.0, 2.8)])
def test_a_board_ahead_raises_caution_first_and_in_time(
    scan_of: ScanOf, speed_mps: float, caution_m: float, imminent_m: float
) -> None:
    begin_m = 9.0
    told = watched(approach(scan_of, speed_mps, begin_m, int(8.5 / speed_mps / SCAN_S)), Motion(speed_mps))
    first = {
        level: begin_m - speed_mps * SCAN_S * next(k for k, m in enumerate(told) if m.level == level)
        for level in ("CAUTION", "IMMINENT")
    }
    assert first["CAUTION"] >= caution_m
    assert imminent_m <= first["IMMINENT"] < first["CAUTION"]


def test_the_agreed_distance_does_not_lag_behind_the_vehicle(scan_of: ScanOf) -> None:
    told = watched(approach(scan_of, 2.0, 5.0, 20), Motion(2.0))
    for k in range(4, 20):
        half_turn_m = 2.0 * SCAN_S / 2  # what lies ahead was measured in the middle of this scan
        assert told[k].centre.nearest_m == pytest.approx(5.0 - 0.2 * k - half_turn_m, abs=0.03)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_lanes_follow_the_arc(scan_of: ScanOf, side: float) -> None:
    motion = Motion(1.0, 0.5 * side)
    ((x_m, y_m),) = Path(CONFIG.path, motion).place(np.array([1.5]), np.zeros(1))
    x_m -= CONFIG.path.front_m
    on_arc = [scan_of([(x_m, y_m - 0.1, y_m + 0.1)], background_m=11.0, number=k) for k in range(4)]
    ahead = [scan_of([(1.9, -0.1, 0.1)], background_m=11.0, number=k) for k in range(4)]
    assert watched(on_arc, motion)[-1].level == "CAUTION"
    assert watched(on_arc, motion)[-1].centre.nearest_m == pytest.approx(1.5 - 0.05, abs=0.08)
    assert watched(ahead, motion)[-1].centre.nearest_m is None
    assert watched(on_arc, None)[-1].level == "SAFE"


@pytest.mark.parametrize("motion", [Motion(3.0), Motion(2.0, 0.8), Motion(2.0, -0.8)])
def test_a_scan_taken_while_driving_is_put_straight(motion: Motion) -> None:
    """A wall across the way, each beam measured from where the vehicle was by then."""
    beams, wall_m = 450, 4.0  # the wall from the place at the end of the turn
    number = np.arange(beams)
    angle = np.radians(25.0) + 2 * np.pi * number / beams  # counter-clockwise, ends behind the forward cone
    age_s = (beams - 1 - number) / CONFIG.scan.sample_rate_hz
    turned, place = pose_after(motion, -age_s)
    heading = angle + turned
    mount = np.array([CONFIG.path.front_m, 0.0])  # of the sensor in the vehicle
    sensor = place + np.stack([np.cos(turned) * mount[0], np.sin(turned) * mount[0]])
    reach = (wall_m + CONFIG.path.front_m - sensor[0]) / np.cos(heading)
    hit = (np.cos(heading) > 0.3) & (reach > 0.0)
    scan = LaserScan(
        stamp_ns=10**18,
        angles_rad=angle.astype(np.float32),
        ranges_m=np.where(hit, reach, 0.0).astype(np.float32),
        confidence=np.where(hit, 200, 0).astype(np.uint8),
    )
    returns = returns_of(scan, CONFIG.mounting)
    straight = along_the_way(returns, CONFIG, motion)
    on_wall = (returns.range_m > 0.0) & (np.abs(returns.angle_rad) < 0.5)
    points = Path(CONFIG.path, motion).place(straight.x_m[on_wall], straight.y_m[on_wall])
    assert points[:, 0] - CONFIG.path.front_m == pytest.approx(np.full(on_wall.sum(), wall_m), abs=0.01)
    raw = returns.x_m[on_wall]
    assert np.ptp(raw) > 0.05  # as measured it leans or lags


def test_an_obstacle_that_is_pushed_along_stays_imminent(scan_of: ScanOf) -> None:
    """At the bumper it is nearer than the sensor measures: that is no reason to call the way free."""
    coming = approach(scan_of, 1.0, 1.5, 14)
    pushed = [scan_of([(0.1, -0.2, 0.2)], background_m=11.0, number=14 + k) for k in range(60)]
    told = watched([*coming, *pushed], Motion(1.0))
    assert {message.level for message in told[12:]} == {"IMMINENT"}


def test_the_cover_ends_at_what_is_seen_and_where_the_lens_is_covered(scan_of: ScanOf) -> None:
    scan = scan_of([(2.0, -0.3, 0.3)], background_m=11.0)
    returns = returns_of(scan, CONFIG.mounting)
    used = np.zeros(len(returns.range_m), np.int64)
    cover = cover_of(returns, used, CONFIG, Motion(1.0))
    assert len(cover.far_m) == 90
    middle, aside = cover.far_m[44:46], cover.far_m[80]
    assert middle == pytest.approx([2.0, 2.0], abs=0.01)
    assert aside == CONFIG.zones.cover_far_m
    blocked = np.where(np.abs(returns.angle_rad - 0.5) < 0.1, RejectReason.NEAR, used)
    left = cover_of(returns, blocked, CONFIG, Motion(1.0))
    sector = int((0.5 - left.first_rad) / left.step_rad)
    assert left.far_m[sector] == 0.0
    assert "ends at the lens" in left.why
    assert cover_of(returns, used, CONFIG, None).first_rad == pytest.approx(-math.radians(20.0))
