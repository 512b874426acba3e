"""SAFE says only what was seen: covers over the way, the rule V1, and the speed at which it would be SAFE again."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from common.messages import Cover, Motion
from common.path import Path, PathConfig, stopping_m
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.coverage import Coverage, cover_way, runs, sees, strip, way_ahead
from services.jetson.fusion.evidence import FusionInputs, FusionMemory, SensorInput
from services.jetson.fusion.verdict import fuse

PATH = PathConfig()
ONLINE = SensorInput(state="online", level="SAFE", age_s=0.05)
EMPTY_PICTURE = SensorInput(state="online", level=None, age_s=0.05)


def cone(half_deg: float, far_m: float, **fields: Any) -> Cover:
    """From the bumper, one sector."""
    half = math.radians(half_deg)
    return Cover(x_m=0.2, y_m=0.0, first_rad=-half, step_rad=2 * half, far_m=[far_m], **fields)


def fan(far_m: list[float], half_deg: float = 90.0, **fields: Any) -> Cover:
    """From the bumper, many sectors from right to left."""
    half = math.radians(half_deg)
    return Cover(x_m=0.2, y_m=0.0, first_rad=-half, step_rad=2 * half / len(far_m), far_m=far_m, **fields)


def covered(motion: Motion | None, *covers: Cover, out: dict[str, str] | None = None) -> Coverage:
    return cover_way(motion, PATH, {f"sensor{i}": cover for i, cover in enumerate(covers)}, out or {}, RulesConfig())


def decided(coverage: Coverage | None, rules: RulesConfig | None = None, **fields: Any) -> Any:
    moving = coverage is not None and coverage.way.motion == "driving"
    inputs = FusionInputs(now_s=10.0, moving=moving, lidar=ONLINE, radar=ONLINE, camera=EMPTY_PICTURE)
    verdict, _ = fuse(replace(inputs, coverage=coverage, **fields), FusionMemory(), rules or RulesConfig())
    return verdict


@pytest.mark.parametrize(("far_m", "expected_m"), [(0.0, 0.0), (2.05, 2.0), (5.05, 5.0), (50.0, 12.0)])
def test_a_cone_covers_as_far_as_it_reaches(far_m: float, expected_m: float) -> None:
    assert covered(Motion(1.0), cone(20.0, far_m)).covered_m == pytest.approx(expected_m, abs=0.11)


def test_two_sensors_cover_what_either_sees() -> None:
    left, right = fan([0.0, 6.0]), fan([6.0, 0.0])
    assert covered(Motion(1.0), left).covered_m == pytest.approx(0.6)  # nearer it is not asked
    assert covered(Motion(1.0), left, right).covered_m == pytest.approx(6.0, abs=0.11)


def test_a_blocked_sector_on_the_way_ends_it_and_beside_the_way_does_not() -> None:
    clear, blocked_ahead, blocked_aside = [8.0] * 90, [8.0] * 90, [8.0] * 90
    blocked_ahead[45:48] = [0.0] * 3  # from 0 to 6 degrees to the left: on the way beyond a metre or so
    blocked_aside[65:70] = [0.0] * 5  # 40 degrees to the left
    whole = covered(Motion(1.0), fan(clear)).covered_m
    assert covered(Motion(1.0), fan(blocked_aside)).covered_m == whole
    short = covered(Motion(1.0), fan(blocked_ahead))
    assert short.covered_m is not None
    assert short.covered_m < 1.0


def test_in_a_curve_the_cone_loses_the_way() -> None:
    straight, curve = covered(Motion(1.0), cone(20.0, 6.0)), covered(Motion(1.0, 0.8), cone(20.0, 6.0))
    assert straight.covered_m == pytest.approx(6.0, abs=0.11)
    assert curve.covered_m is not None
    assert 0.5 < curve.covered_m < 2.0
    wide = covered(Motion(1.0, 0.8), fan([6.0] * 90))
    assert wide.covered_m is not None
    assert wide.covered_m > curve.covered_m


def test_what_sees_only_movers_covers_nothing() -> None:
    only = covered(Motion(1.0), cone(45.0, 6.0, standing=False))
    assert only.covered_m == 0.0
    assert only.uncovered[0].why == "sensor0 sees only what moves"


def test_the_speed_at_which_it_would_be_safe_again() -> None:
    found = covered(Motion(3.0), cone(20.0, 2.05))
    assert found.max_safe_speed_mps is not None
    assert found.covered_m is not None
    assert stopping_m(found.max_safe_speed_mps, PATH) == pytest.approx(found.covered_m, abs=0.02)
    assert found.falls_short
    slower = covered(Motion(found.max_safe_speed_mps - 0.05), cone(20.0, 2.05))
    assert not slower.falls_short


def test_gaps_are_named_with_their_reason() -> None:
    found = covered(Motion(2.0), cone(20.0, 1.05, why="dirt"), out={"camera": "degraded"})
    (gap,) = found.uncovered
    assert gap.from_m == pytest.approx(1.0, abs=0.11)
    assert gap.to_m == 3.0
    assert gap.why == "camera degraded; sensor0: dirt"
    assert covered(Motion(2.0), cone(20.0, 1.05)).uncovered[0].why == "beyond what the sensors cover"
    assert (
        cover_way(Motion(2.0), PATH, {"a": None, "b": cone(20.0, 1.0)}, {}, RulesConfig())
        .uncovered[0]
        .why.startswith("a does not")
    )


@pytest.mark.parametrize(
    ("motion", "kind"),
    [(None, "unknown"), (Motion(0.0), "standing"), (Motion(0.1), "driving"), (Motion(-0.1), "reversing"),
     (Motion(-0.09), "standing")],
)  # fmt: skip
def test_the_way_says_how_the_vehicle_moves(motion: Motion | None, kind: str) -> None:
    path, way = way_ahead(motion, PATH)
    assert way.motion == kind
    assert way.stopping_m == pytest.approx(path.stopping_m, abs=0.01)
    assert (way.left_m, way.right_m) == pytest.approx((path.left_m, path.right_m), abs=0.001)


@pytest.mark.parametrize(
    ("motion", "mode", "rule"),
    [
        (Motion(2.0), "floor", "V1-uncovered"),
        (Motion(2.0), "report", "R0-clear"),
        (Motion(2.0), "off", "R0-clear"),
        (Motion(0.5), "floor", "R0-clear"),  # stops in time
        (Motion(0.0), "floor", "R0-clear"),  # standing: the article's rules as they are
        (None, "floor", "R0-clear"),  # unknown motion: the same
    ],
)
def test_the_floor_is_for_a_vehicle_known_to_drive(motion: Motion | None, mode: Any, rule: str) -> None:
    coverage = covered(motion, cone(20.0, 1.05))
    verdict = decided(coverage, RulesConfig(coverage=mode))
    assert verdict.rule == rule
    assert verdict.level == ("CAUTION" if rule == "V1-uncovered" else "SAFE")
    assert verdict.permission == ("SLOW" if rule == "V1-uncovered" else "GO")
    assert verdict.covered_m == coverage.covered_m
    assert verdict.max_safe_speed_mps == coverage.max_safe_speed_mps
    assert verdict.uncovered == list(coverage.uncovered)


def test_the_words_name_place_reason_and_speed() -> None:
    verdict = decided(covered(Motion(2.0), cone(20.0, 1.05, why="dirt")))
    assert "nobody sees the way beyond 1.0 m (sensor0: dirt)" in verdict.because
    assert "stopping takes 1.8 m; safe up to 1.3 m/s" in verdict.because
    assert "slower driving" in verdict.to_lower


def test_a_fully_seen_way_changes_nothing() -> None:
    assert decided(covered(Motion(2.0), cone(20.0, 6.0))).rule == "R0-clear"


def test_what_a_sensor_sees_comes_first() -> None:
    verdict = decided(covered(Motion(2.0), cone(20.0, 1.0)), lidar=replace(ONLINE, level="IMMINENT"))
    assert verdict.level == "IMMINENT"


def test_without_any_word_on_covers_nothing_is_said() -> None:
    silent = cover_way(Motion(2.0), PATH, {"lidar": None}, {"radar": "disconnected"}, RulesConfig())
    assert silent.covered_m is None
    assert not silent.falls_short
    assert decided(silent).covered_m is None
    assert decided(None).way is None


PLANE, KNOWN = cone(20.0, 6.0, only="what crosses its plane"), cone(20.0, 6.0, only="what its network knows")


@pytest.mark.parametrize(
    ("speed_mps", "covers", "fast", "safe_mps"),
    [
        (2.0, (PLANE, KNOWN), True, 1.0),
        (1.1, (PLANE, KNOWN), False, 1.0),  # as a vehicle that keeps to 1 m/s is measured
        (1.11, (PLANE, KNOWN), True, 1.0),
        (2.0, (PLANE, cone(20.0, 6.0)), False, None),  # the radar sees obstacles of every kind
        (2.0, (PLANE, cone(20.0, 6.0, standing=False)), True, 1.0),  # but not one that sees only what moves
    ],
)
def test_while_some_obstacles_go_unseen_only_slow_driving_is_safe(
    speed_mps: float, covers: tuple[Cover, ...], fast: bool, safe_mps: float | None
) -> None:
    named = dict(zip(("lidar", "camera"), covers, strict=True))
    found = cover_way(Motion(speed_mps), PATH, named, {"radar": "disconnected"}, RulesConfig())
    assert (found.too_fast, found.falls_short) == (fast, fast)
    if safe_mps is not None:
        assert found.max_safe_speed_mps == safe_mps
    verdict = decided(found)
    assert verdict.rule == ("V1-uncovered" if fast else "R0-clear")
    if fast:
        assert verdict.because.startswith("low boxes and panes go unseen (LiDAR sees what crosses its plane")
        assert verdict.because.endswith("safe up to 1.0 m/s")


def test_a_way_that_is_too_short_comes_before_what_goes_unseen() -> None:
    short = cone(20.0, 1.05, only="what crosses its plane")
    found = cover_way(Motion(2.0), PATH, {"lidar": short}, {}, RulesConfig())
    assert decided(found).because.startswith("nobody sees the way beyond 1.0 m")


@pytest.mark.parametrize(
    ("x_m", "y_m", "seen"),
    [
        (1.0, -1.5, False), (1.5, -1.0, True), (1.5, 1.0, True), (1.0, 1.5, True),
        (1.5, 3.2, True), (2.0, 3.5, False),  # the last sector: 3.5 m, 4.03 m
        (0.6, -0.8, True),  # as far as it reaches, to the millimetre
        (0.36, -0.48, True),
        (-1.0, 0.0, False), (-0.05, 0.0, False),  # behind it
        (0.0, -0.3, True),
    ],
)  # fmt: skip
def test_sectors_are_looked_up_by_bearing(x_m: float, y_m: float, seen: bool) -> None:
    """From the right: -90 to -45, to 0, to 45, to 90 degrees."""
    cover = from_origin(fan([1.0, 2.0, 3.0, 4.0]))
    assert sees(cover, np.array([[x_m, y_m]])).tolist() == [seen]


def from_origin(cover: Cover) -> Cover:
    """The same from the origin, where ranges are round numbers."""
    return msgspec.structs.replace(cover, x_m=0.0)


NARROW = from_origin(cone(20.0, 6.0))


@pytest.mark.parametrize(
    ("cover", "x_m", "y_m", "seen"),
    [
        (NARROW, 0.36, 0.48, True),  # 0.6 m away, beside the cone
        (NARROW, 0.37, 0.48, False),
        (NARROW, 0.0, 0.3, False),  # abreast of it, not ahead
        (msgspec.structs.replace(NARROW, near_m=1.0), 0.6, 0.8, True),
        (from_origin(fan([6.0, 0.0, 6.0])), 0.3, 0.0, False),  # it does not see straight ahead
        (from_origin(fan([0.0, 0.05, 0.0])), 0.3, 0.2, True),  # blocked at 5 cm is not blind
        (Cover(x_m=0.0, y_m=0.0, first_rad=0.5, step_rad=0.5, far_m=[6.0, 6.0]), 0.3, 0.0, False),  # looks aside
        (Cover(x_m=0.0, y_m=0.0, first_rad=-1.0, step_rad=0.5, far_m=[6.0]), 0.3, 0.0, False),
        (Cover(x_m=0.0, y_m=0.0, first_rad=0.0, step_rad=0.0, far_m=[6.0]), 0.3, 0.0, False),  # says nothing
        (Cover(x_m=0.0, y_m=0.0, first_rad=0.0, step_rad=0.5, far_m=[]), 0.3, 0.0, False),
    ],
)
def test_near_it_what_it_sees_ahead_counts(cover: Cover, x_m: float, y_m: float, seen: bool) -> None:
    assert sees(cover, np.array([[x_m, y_m]])).tolist() == [seen]


def test_the_middle_of_the_way_and_both_edges_are_looked_at() -> None:
    cells = strip(Path(PATH))
    half_m = PATH.width_m / 2
    first = cells[cells[:, 0] == cells[0, 0]]
    assert first[:, 1] == pytest.approx([-half_m, -half_m / 2, 0.0, half_m / 2, half_m])
    assert first[0, 0] == pytest.approx(PATH.front_m + 0.05)
    assert cells[-1, 0] == pytest.approx(PATH.front_m + 11.95)


def test_figures_are_told_in_millimetres_or_coarser() -> None:
    _, way = way_ahead(Motion(1.37, 0.4327), PATH)
    assert way.curvature_per_m == round(0.4327 / 1.37, 4)
    assert (way.left_m, way.right_m, way.stopping_m) == (0.096, round(way.right_m, 3), round(way.stopping_m, 2))
    speed = covered(Motion(1.0), cone(20.0, 2.05)).max_safe_speed_mps
    assert speed is not None
    assert speed == round(speed, 2)


@pytest.mark.parametrize(("covered_m", "short"), [(1.99, True), (2.0, False)])
def test_covered_to_the_very_end_is_enough(covered_m: float, short: bool) -> None:
    _, way = way_ahead(Motion(2.0), PATH)
    coverage = Coverage(msgspec.structs.replace(way, stopping_m=2.0), covered_m, (), None)
    assert coverage.falls_short == short


def test_runs_of_flags() -> None:
    assert runs(np.array([True, True, False, True])) == [(0, 2), (3, 4)]
    assert runs(np.zeros(3, bool)) == []


def test_covered_to_the_very_end_and_too_fast_tells_the_limit() -> None:
    _, way = way_ahead(Motion(2.0), PATH)
    way = msgspec.structs.replace(way, stopping_m=2.0)
    assert decided(Coverage(way, 2.0, (), 1.0, "low boxes go unseen", too_fast=True)).because == (
        "low boxes go unseen; safe up to 1.0 m/s"
    )
