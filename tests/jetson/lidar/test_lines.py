"""Ground before a nose that dips, and a wall that leads off: their CAUTION waits, nobody else's does, no IMMINENT."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from common.messages import LaserScan, LidarZones, Motion
from common.path import stopping_m
from services.jetson.lidar.config import LidarConfig, ZonesSection
from services.jetson.lidar.pipeline import LidarPipeline

CONFIG = LidarConfig()
SPEED_MPS, SCAN_S = 2.0, 0.1
STOP_M = stopping_m(SPEED_MPS, CONFIG.path)  # 1.77 m; CAUTION begins at 5.57 m, and where it waits at 2.37 m
ScanOf = Callable[..., LaserScan]
Seen = tuple[float, float, float, float] | None  # at_m, lean, from y, to y


def with_line(scan: LaserScan, seen: Seen, confidence: int = 200) -> LaserScan:
    """The beams that meet the line x = at + lean y between two y, before what they meet otherwise."""
    if seen is None:
        return scan
    at_m, lean, low_m, high_m = seen
    cos, sin = np.cos(scan.angles_rad), np.sin(scan.angles_rad)
    toward = cos - lean * sin
    reach = np.where(toward > 0.05, at_m / np.maximum(toward, 0.05), np.inf)
    hit = (reach * sin >= low_m) & (reach * sin <= high_m) & (reach < 11.9) & (at_m > 0.0)
    hit &= (scan.ranges_m == 0.0) | (reach < scan.ranges_m)
    scan.ranges_m[hit], scan.confidence[hit] = reach[hit], confidence
    return scan


def driven(scan_of: ScanOf, seen: Sequence[Seen], confidence: int = 200, waits: bool = True) -> list[LidarZones]:
    """One scan after the other at ``SPEED_MPS``; something beside the way is always there."""
    pipeline = LidarPipeline(replace_zones(lines_wait=waits))
    messages = []
    for number, one in enumerate(seen):
        scan = with_line(scan_of([(3.0, 2.0, 2.6)], number=number), one, confidence)
        messages.append(pipeline.process(scan.stamp_ns, scan, Motion(SPEED_MPS)))
    return messages


def replace_zones(**keys: bool) -> LidarConfig:
    return LidarConfig(zones=ZonesSection(**keys))  # type: ignore[arg-type]


def coming(
    begin_m: float, lean: float = 0.0, half_m: float = 5.0, extra_mps: float = 0.0, count: int = 60
) -> list[Seen]:
    """It comes nearer by what the vehicle drives, and ``extra_mps``."""
    step_m = (SPEED_MPS + extra_mps) * SCAN_S
    return [(begin_m - step_m * k, lean, -half_m, half_m) for k in range(count) if begin_m - step_m * k > 0.3]


def first_m(messages: list[LidarZones], seen: Sequence[Seen], level: str) -> float:
    """Where the line was when the level was first said; 0 = never."""
    for message, one in zip(messages, seen, strict=True):
        if message.level == level or (level == "CAUTION" and message.level != "SAFE"):
            assert one is not None
            return one[0]
    return 0.0


NOTHING: list[Seen] = [None] * 6


@pytest.mark.parametrize(
    ("name", "seen", "confidence", "waits"),
    [
        ("ground, at once over everything", NOTHING + coming(5.2), 190, True),
        ("one scan fell into the dip", [*NOTHING, (6.2, 0.3, -5.0, 5.0), *coming(5.2)], 190, True),
        ("a dip of the nose and a roll", NOTHING + coming(5.2, lean=0.3), 190, True),
        ("a wall that came from afar", coming(9.0), 190, False),
        ("it came at once, but is no wider than a lorry", NOTHING + coming(5.2, half_m=1.25), 190, False),
        ("at the limit of what the sensor sees", NOTHING + coming(5.2), 40, False),
        ("a wall that leads off", coming(9.0, lean=1.2), 190, True),
        ("to the other side", coming(9.0, lean=-1.2), 190, True),
        ("aslant, but it comes towards us", coming(9.0, lean=1.2, extra_mps=1.0), 190, False),
        ("aslant, but it ends in the way", [(m, 1.2, -0.2, 5.0) for m in np.arange(9.0, 0.3, -0.2)], 190, False),
        ("nearly across", coming(9.0, lean=0.45), 190, False),
    ],
)
def test_whose_caution_waits(scan_of: ScanOf, name: str, seen: list[Seen], confidence: int, waits: bool) -> None:
    messages = driven(scan_of, seen, confidence)
    caution_m, imminent_m = first_m(messages, seen, "CAUTION"), first_m(messages, seen, "IMMINENT")
    assert (caution_m < STOP_M + 0.3 * SPEED_MPS + 0.3) == waits, f"{name}: {caution_m}"
    assert STOP_M - 0.65 <= imminent_m <= STOP_M + 0.4, name
    assert first_m(driven(scan_of, seen, confidence, waits=False), seen, "CAUTION") >= 4.4, name


def test_ground_that_goes_again_is_no_alarm_at_all(scan_of: ScanOf) -> None:
    seen = NOTHING + coming(6.4)[:16] + NOTHING
    assert {message.level for message in driven(scan_of, seen)} == {"SAFE"}
    assert "CAUTION" in {message.level for message in driven(scan_of, seen, waits=False)}


def test_somebody_who_stands_before_the_ground_alarms(scan_of: ScanOf) -> None:
    pipeline, levels = LidarPipeline(CONFIG), []
    for number, one in enumerate(NOTHING + coming(5.2)[:8]):
        things = [(3.0, 2.0, 2.6)] + ([(one[0] - 0.8, -0.2, 0.2)] if one else [])
        scan = with_line(scan_of(things, number=number), one, 190)
        levels.append(pipeline.process(scan.stamp_ns, scan, Motion(SPEED_MPS)).level)
    assert levels[-1] == "CAUTION"


def test_an_alarm_is_not_taken_back_after_scans_without_it(scan_of: ScanOf) -> None:
    """A wall that was seen before the nose rose for three scans."""
    wall = coming(7.0, count=24)
    seen: list[Seen] = [None if 11 <= k < 14 else one for k, one in enumerate(wall)]
    levels = [message.level for message in driven(scan_of, seen)]
    assert set(levels[11:]) <= {"CAUTION", "IMMINENT"}


def test_an_alarm_does_not_grow_once_the_way_has_swung_away_from_it(scan_of: ScanOf) -> None:
    """Straight at a wall, then round the bend before it: what was agreed on is not in the new way."""
    pipeline, levels = LidarPipeline(CONFIG), []
    for k in range(14):
        motion = Motion(SPEED_MPS, 0.0 if k < 10 else 2.0)
        scan = with_line(scan_of([(3.0, 2.0, 2.6)], number=k), (4.0 - 0.2 * k, 0.0, -5.0, 0.5 if k < 10 else -0.6))
        levels.append(pipeline.process(scan.stamp_ns, scan, motion).level)
    assert levels[9] == "CAUTION"
    assert "IMMINENT" not in levels
