"""Who drives ahead in the lane: his speed from the lane's distances, and the room that he needs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from common.messages import LaserScan, Motion
from common.path import stopping_m
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.lead import Lead
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.way import zones_for

CONFIG = LidarConfig()
OWN_MPS, BEGIN_M, SCAN_S = 3.0, 8.0, 0.1
DRIVES = Motion(OWN_MPS)


def told_mps(distances_m: list[float | None], motion: Motion | None = DRIVES) -> list[float]:
    """What is said after each scan."""
    lead = Lead(CONFIG)
    return [lead.update(round(k * SCAN_S * 1e9), one, motion) for k, one in enumerate(distances_m)]


def line(lead_mps: float, count: int = 20, sigma_m: float = 0.0) -> list[float | None]:
    """Distances to somebody who drives at that speed."""
    t = SCAN_S * np.arange(count)
    noise = sigma_m * np.random.default_rng(27).standard_normal(count)
    return list(BEGIN_M + (lead_mps - OWN_MPS) * t + noise)


@pytest.mark.parametrize("lead_mps", [0.0, 1.0, 2.0, 3.0, 4.0])
@pytest.mark.parametrize("sigma_m", [0.0, 0.02])
def test_the_speed_is_never_more_than_it_is(lead_mps: float, sigma_m: float) -> None:
    speeds_mps = told_mps(line(lead_mps, sigma_m=sigma_m))
    assert speeds_mps[:4] == [0.0] * 4
    for one in speeds_mps[6:]:
        assert max(0.0, lead_mps - 0.35) <= one <= lead_mps + 1e-9


def test_one_scan_may_miss_or_be_off_and_two_may_not() -> None:
    for wrong in (None, 2.0):
        distances = line(3.0)
        distances[10] = wrong
        assert min(told_mps(distances)[6:]) > 2.5
    steps_in = line(3.0)
    steps_in[10:12] = [4.0, 3.7]
    speeds_mps = told_mps(steps_in)
    assert speeds_mps[10] > 2.5
    assert speeds_mps[11] == 0.0


def test_nothing_is_known_in_a_curve_without_motion_or_after_a_gap() -> None:
    for motion in (None, Motion(0.0), Motion(-1.0), Motion(OWN_MPS, 0.2), Motion(OWN_MPS, -0.2)):
        assert set(told_mps(line(3.0), motion)) == {0.0}
    gap = line(3.0)
    gap[8:15] = [None] * 7
    assert set(told_mps(gap)[12:18]) == {0.0}


def test_the_bands_leave_out_what_a_lead_needs_to_stop() -> None:
    stop_m, hard = stopping_m(OWN_MPS, CONFIG.path), 2.0 * CONFIG.lead.brake_mps2
    for lead_mps in (0.0, 1.0, 2.0, 3.0, 4.0):
        zones = zones_for(CONFIG, Motion(OWN_MPS), lead_mps)
        assert zones.imminent_m == pytest.approx(stop_m - lead_mps**2 / hard)
        closing_mps = max(0.0, OWN_MPS - lead_mps)
        caution_m = zones.imminent_m + CONFIG.zones.caution_lead_s * closing_mps
        assert zones.caution_m == pytest.approx(max(CONFIG.zones.caution_m, caution_m))
    assert zones_for(CONFIG, Motion(1.0), 3.0).imminent_m == CONFIG.zones.imminent_m


def levels(scan_of: Callable[..., LaserScan], distances_m: list[float]) -> list[str]:
    """Of a board of a car's width at these distances, at ``OWN_MPS``."""
    pipeline = LidarPipeline(CONFIG)
    scans = [scan_of([(d, -0.9, 0.9)], background_m=11.5, number=k) for k, d in enumerate(distances_m)]
    return [pipeline.process(scan.stamp_ns, scan, Motion(OWN_MPS)).level for scan in scans]


def test_a_car_that_is_followed_is_no_wall_until_it_brakes(scan_of: Callable[..., LaserScan]) -> None:
    """At 1.5 s of headway; at 4 m/s^2 it stops after 1.1 m, and 3.1 m are needed."""
    t = SCAN_S * np.arange(12)
    follows, brakes = np.full(15, 4.5), np.maximum(4.5 - 2.0 * t**2, 4.5 + 1.125 - OWN_MPS * t)
    reported = levels(scan_of, [*follows, *brakes])
    assert set(reported[6:15]) == {"SAFE"}
    first = {level: reported.index(level, 7) - 15 for level in ("CAUTION", "IMMINENT")}
    assert first["CAUTION"] <= 6  # 3.9 m left
    assert first["IMMINENT"] <= 10  # 2.6 m left, and the car has moved on by 1.1 m


def test_a_wall_is_a_wall(scan_of: Callable[..., LaserScan]) -> None:
    """The bands for what stands hold for what stands, to the centimetre."""
    distances = list(np.arange(10.5, 2.0, -OWN_MPS * SCAN_S))
    reported = levels(scan_of, distances)
    zones = zones_for(CONFIG, Motion(OWN_MPS))
    for level, band_m in (("CAUTION", zones.caution_m), ("IMMINENT", zones.imminent_m)):
        assert distances[reported.index(level)] >= band_m - OWN_MPS * SCAN_S * 2.5
