"""The lidar on a vehicle that drives: lanes along the arc, bands for the stopping distance, no skew, honest cover."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from common.messages import LaserScan, LidarZones, Motion
from common.path import Path, pose_after, stopping_m
from services.jetson.lidar.config import LidarConfig, ZonesSection
from services.jetson.lidar.filters import RejectReason, Returns, returns_of
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.way import along_the_way, cover_of, driven_m, layout_of, zones_for

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
    messages, plain = watched(scans, motion), watched(scans, None)
    assert [(m.level, m.centre, m.left, m.right, m.layout) for m in messages] == [
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
    messages = watched(approach(scan_of, speed_mps, begin_m, int(8.5 / speed_mps / SCAN_S)), Motion(speed_mps))
    first = {
        level: begin_m - speed_mps * SCAN_S * next(k for k, m in enumerate(messages) if m.level == level)
        for level in ("CAUTION", "IMMINENT")
    }
    assert first["CAUTION"] >= caution_m
    assert imminent_m <= first["IMMINENT"] < first["CAUTION"]


def test_the_agreed_distance_does_not_lag_behind_the_vehicle(scan_of: ScanOf) -> None:
    messages = watched(approach(scan_of, 2.0, 5.0, 20), Motion(2.0))
    for k in range(4, 20):
        half_turn_m = 2.0 * SCAN_S / 2  # what lies ahead was measured in the middle of this scan
        assert messages[k].centre.nearest_m == pytest.approx(5.0 - 0.2 * k - half_turn_m, abs=0.03)


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
    messages = watched([*coming, *pushed], Motion(1.0))
    assert {message.level for message in messages[12:]} == {"IMMINENT"}


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


NARROW = msgspec.structs.replace(CONFIG, zones=ZonesSection(imminent_m=0.01, caution_m=0.02, look_ahead_m=0.03))


@pytest.mark.parametrize(
    ("speed_mps", "lead_mps", "stop_m", "coming_mps"),
    [(2.0, 1.0, 1.7667 - 1.0 / 12.0, 1.0), (2.0, 2.0, 1.7667 - 4.0 / 12.0, 0.0), (1.0, 3.0, 0.0167, 0.0)],
)
def test_who_drives_ahead_needs_less_room(speed_mps: float, lead_mps: float, stop_m: float, coming_mps: float) -> None:
    """Reaction and braking at 3 m/s^2 and 0.1 m, less what the other's own braking at 6 m/s^2 leaves free."""
    zones = zones_for(NARROW, Motion(speed_mps), lead_mps)
    assert zones.imminent_m == pytest.approx(stop_m, abs=1e-4)
    assert zones.caution_m == pytest.approx(max(0.02, stop_m + 1.9 * coming_mps), abs=1e-4)
    assert zones_for(NARROW, Motion(speed_mps), 9.0).imminent_m == 0.01


@pytest.mark.parametrize(("yaw_rate_radps", "lead_s"), [(0.05, 1.9), (0.0525, 0.3), (-0.0525, 0.3)])
def test_in_a_curve_less_counts(yaw_rate_radps: float, lead_s: float) -> None:
    zones = zones_for(NARROW, Motion(1.0, yaw_rate_radps))
    assert zones.caution_m == pytest.approx(stopping_m(1.0, CONFIG.path) + lead_s)


def test_the_lane_is_as_wide_as_vehicle_and_margins() -> None:
    path = msgspec.structs.replace(CONFIG.path, width_m=0.3, side_margin_m=0.1)
    wide = zones_for(msgspec.structs.replace(CONFIG, path=path), Motion(1.0))
    assert wide.centre_width_m == pytest.approx(0.5)


def test_only_driving_brings_things_nearer() -> None:
    assert driven_m(CONFIG, Motion(2.0), 0.1) == pytest.approx(0.2)
    assert [driven_m(CONFIG, motion, 0.1) for motion in (None, Motion(0.0), Motion(-1.0))] == [0.0, 0.0, 0.0]
    assert layout_of(CONFIG.zones).curvature_per_m == 0.0


def beams(range_m: float = 5.0, per_sector: int = 20) -> Returns:
    """The forward cone of 40 degrees, so many beams in each sector of 2 degrees."""
    count = 20 * per_sector
    angle = np.radians(-20.0 + (np.arange(count) + 0.5) * 2.0 / per_sector)
    reach = np.full(count, range_m)
    x_m, y_m = reach * np.cos(angle), reach * np.sin(angle)
    return Returns(angle, reach, np.full(count, 200.0), x_m, y_m, np.arange(count), float(angle[1] - angle[0]))


def test_the_last_beam_is_of_now_and_an_earlier_one_is_carried_on() -> None:
    motion, returns = Motion(3.0), beams()
    straight = along_the_way(returns, CONFIG, motion)
    late_m = 3.0 / CONFIG.scan.sample_rate_hz
    assert returns.x_m[-3:] - straight.x_m[-3:] == pytest.approx([2 * late_m, late_m, 0.0], abs=1e-9)


@pytest.mark.parametrize(("range_m", "placed"), [(0.05, True), (0.0, False)])
def test_a_beam_without_a_return_has_no_place_on_the_way(range_m: float, placed: bool) -> None:
    straight = along_the_way(beams(range_m), CONFIG, Motion(2.0, 0.5))
    assert np.all((straight.x_m != 0.0) == placed)
    assert placed or np.all(straight.x_m == 0.0)


@pytest.mark.parametrize(
    ("reason", "hidden", "far_m", "why"),
    [
        (RejectReason.NEAR, 10, 5.0, ""),
        (RejectReason.NEAR, 11, 0.0, "5 % of the view ends at the lens or is not measured"),
        (RejectReason.IGNORED, 10, 5.0, ""),
        (RejectReason.IGNORED, 11, 0.0, "5 % of the view is behind own parts (filter.ignore)"),
        (RejectReason.FAR, 20, CONFIG.zones.cover_far_m, ""),
    ],
)
def test_a_sector_is_not_seen_when_most_of_its_beams_are_hidden(
    reason: RejectReason, hidden: int, far_m: float, why: str
) -> None:
    reject = np.zeros(400, np.int64)
    reject[60 : 60 + hidden] = reason
    cover = cover_of(beams(), reject, CONFIG, None)
    assert cover.far_m == [5.0] * 3 + [far_m] + [5.0] * 16
    assert cover.why == why


def test_a_sector_needs_a_beam_and_the_first_counts_too() -> None:
    returns = beams(2.0049, per_sector=1)
    assert cover_of(returns, np.zeros(20, np.int64), CONFIG, None).far_m == [2.0] * 20
    fewer = Returns(*(value[1:] for value in vars(returns).values() if isinstance(value, np.ndarray)), 0.03)
    without = cover_of(fewer, np.zeros(19, np.int64), CONFIG, None)
    assert without.far_m == [0.0] + [2.0] * 19
    assert without.why == "5 % of the view ends at the lens or is not measured"


def test_the_narrowest_view_is_one_sector() -> None:
    narrow = msgspec.structs.replace(CONFIG, zones=ZonesSection(fov_deg=0.9))
    cover = cover_of(beams(), np.zeros(400, np.int64), narrow, None)
    assert (len(cover.far_m), cover.step_rad) == (1, pytest.approx(math.radians(0.9)))
