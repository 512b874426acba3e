"""A rod, a chair's leg, a tripod: few returns in each turn, the same place in every turn. And parts of the vehicle."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from common.config import ConfigError, load
from common.messages import LaserScan
from services.jetson.lidar.config import FilterSection, IgnoredSector, LidarConfig, ZonesSection
from services.jetson.lidar.filters import RejectReason
from services.jetson.lidar.pipeline import LidarPipeline

START_NS = 1_800_000_000_000_000_000
BEAMS = 450
Scan = Callable[..., LaserScan]


def rod_scans(width_m: float, distance_m: float, scans: int = 100) -> Iterator[LaserScan]:
    """A round rod before a wall at 3 m: every turn begins at another angle, 6 mm of noise, 2 % of the beams lost."""
    rng = np.random.default_rng(3)
    for number in range(scans):
        angle = -np.pi + (np.arange(BEAMS) + rng.random()) * 2 * np.pi / BEAMS
        range_m = 3.0 + rng.normal(0.0, 0.012, BEAMS)
        hit = np.abs(distance_m * np.tan(np.clip(angle, -1.5, 1.5))) < width_m / 2
        hit &= np.abs(angle) < 1.0
        range_m[hit] = distance_m + rng.normal(0.0, 0.006, np.count_nonzero(hit))
        range_m[rng.random(BEAMS) < 0.02] = 0.0
        yield scan_at(number, angle, range_m)


def scan_at(number: int, angle_rad: np.ndarray, range_m: np.ndarray, confidence: int = 200) -> LaserScan:
    return LaserScan(
        stamp_ns=START_NS + number * 100_000_000,
        angles_rad=angle_rad.astype(np.float32),
        ranges_m=range_m.astype(np.float32),
        confidence=np.where(range_m > 0.0, confidence, 0).astype(np.uint8),
    )


def alarm_share(scans: Iterator[LaserScan], config: LidarConfig | None = None) -> float:
    pipeline = LidarPipeline(config or LidarConfig())
    alarms = [pipeline.process(scan.stamp_ns, scan).level != "SAFE" for scan in scans]
    return float(np.mean(alarms[10:]))


@pytest.mark.parametrize(
    ("width_m", "distance_m"), [(0.010, 0.3), (0.015, 0.5), (0.020, 0.3), (0.020, 0.5), (0.020, 0.8), (0.030, 1.2)]
)
def test_a_rod_alarms(width_m: float, distance_m: float) -> None:
    assert alarm_share(rod_scans(width_m, distance_m)) > 0.9


def test_without_the_earlier_turns_the_rod_is_missed() -> None:
    alone = LidarConfig(zones=ZonesSection(thin_scans=1))
    assert alarm_share(rod_scans(0.02, 0.3), alone) < 0.5


def test_one_bad_turn_does_not_vouch_for_three(scan_of: Scan) -> None:
    """Three agreeing ghosts in every second turn: enough over three turns, but one of those has none."""
    pipeline = LidarPipeline(LidarConfig())
    for number in range(40):
        scan = scan_of([(1.6, -0.12, 0.12)], number=number)
        if number % 2:
            scan.ranges_m[[224, 225, 226]] = 0.4
        assert pipeline.process(scan.stamp_ns, scan).level != "IMMINENT"


@pytest.mark.parametrize(("share", "confidence"), [(0.02, 60), (0.05, 230), (0.10, 60), (0.10, 230)])
def test_scattered_returns_do_not_add_up(share: float, confidence: int) -> None:
    """Drops between the sensor and a wall beyond the look-ahead, other beams in every turn."""
    rng = np.random.default_rng(5)
    pipeline = LidarPipeline(LidarConfig())
    for number in range(300):
        angle = -np.pi + (np.arange(BEAMS) + rng.random()) * 2 * np.pi / BEAMS
        range_m = 3.5 + rng.normal(0.0, 0.012, BEAMS)
        drops = rng.random(BEAMS) < share
        range_m[drops] = rng.uniform(0.2, 3.0, np.count_nonzero(drops))
        scan = scan_at(number, angle, range_m, confidence)
        assert pipeline.process(scan.stamp_ns, scan).level == "SAFE"


def bracket(number: int, scan_of: Scan) -> LaserScan:
    """A wall at 3 m and the vehicle's own bracket of 3 cm, 0.25 m ahead and a little left."""
    return scan_of([(0.25, 0.02, 0.05)], 3.0, number=number)


def test_an_ignored_part_of_the_vehicle_is_no_obstacle(scan_of: Scan) -> None:
    ignored = LidarConfig(filter=FilterSection(ignore=(IgnoredSector(from_deg=3.0, to_deg=13.0, within_m=0.30),)))
    for config, level in ((LidarConfig(), "IMMINENT"), (ignored, "SAFE")):
        pipeline = LidarPipeline(config)
        for number in range(20):
            scan = bracket(number, scan_of)
            zones = pipeline.process(scan.stamp_ns, scan)
        assert (zones.level, zones.state) == (level, "online")
    assert np.count_nonzero(pipeline.reject_reason == RejectReason.IGNORED) >= 6


def test_something_else_at_the_ignored_angle_still_counts(scan_of: Scan) -> None:
    config = LidarConfig(filter=FilterSection(ignore=(IgnoredSector(from_deg=-20.0, to_deg=20.0, within_m=0.30),)))
    pipeline = LidarPipeline(config)
    for number in range(5):
        scan = scan_of([(0.5, -0.1, 0.1)], 3.0, number=number)
        zones = pipeline.process(scan.stamp_ns, scan)
    assert zones.level == "IMMINENT"


@pytest.mark.parametrize(
    "sector", ["{from_deg=10.0,to_deg=5.0,within_m=0.3}", "{from_deg=0.0,to_deg=190.0,within_m=1.0}"]
)
def test_an_impossible_sector_is_refused(sector: str) -> None:
    with pytest.raises(ConfigError, match="from_deg < to_deg"):
        load(LidarConfig, None, [f"filter.ignore=[{sector}]"])
