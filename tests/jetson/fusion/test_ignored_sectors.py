"""A part of the vehicle in the lidar's view: its alarm is ignored, and what is behind it counts as not seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from common.codec import decode, encode
from common.messages import LaserScan, LidarZones
from services.jetson.fusion.config import FusionConfig
from services.jetson.lidar.config import FilterSection, IgnoredSector, LidarConfig
from services.jetson.lidar.pipeline import LidarPipeline
from tests.jetson.fusion.conftest import Bench

BRACKET = IgnoredSector(from_deg=3.0, to_deg=13.0, within_m=0.30)
BEAMS, SCAN_NS = 450, 100_000_000


def zones_behind_a_bracket(ignore: tuple[IgnoredSector, ...]) -> LidarZones:
    """What the lidar publishes, through the wire format: a yard 6 m deep, own bracket at 0.25 m and 4 to 12 degrees."""
    pipeline = LidarPipeline(LidarConfig(filter=FilterSection(ignore=ignore)))
    angle_rad = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    range_m = np.where((angle_rad > np.radians(4.0)) & (angle_rad < np.radians(12.0)), 0.25, 6.0)
    for number in range(20):
        scan = LaserScan(
            stamp_ns=number * SCAN_NS,
            angles_rad=angle_rad.astype(np.float32),
            ranges_m=range_m.astype(np.float32),
            confidence=np.full(BEAMS, 200, np.uint8),
        )
        zones = pipeline.process(scan.stamp_ns, scan)
    return decode(encode(zones), LidarZones)


def test_what_an_ignored_sector_hides_is_uncovered_with_its_reason(new_bench: Callable[..., Bench]) -> None:
    zones = zones_behind_a_bracket((BRACKET,))
    assert (zones.level, zones.state) == ("SAFE", "online")
    bench = new_bench(FusionConfig())
    bench.extra["lidar"] = {"cover": zones.cover}
    bench.run(1.0)
    bench.drive(1.0, 0.0, seconds=2.0)
    verdict = bench.verdict
    assert verdict is not None
    assert (verdict.level, verdict.rule) == ("CAUTION", "V1-uncovered")  # no other sensor covers it
    assert verdict.covered_m == pytest.approx(0.6, abs=0.11)  # the bracket's shadow lies on the way from there
    assert "LiDAR: 20 % of the view is behind own parts (filter.ignore)" in verdict.uncovered[0].why


def test_without_the_sector_the_bracket_is_an_obstacle() -> None:
    assert zones_behind_a_bracket(()).level == "IMMINENT"
