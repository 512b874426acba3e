"""Drops: banks beside a road, mirrored returns, and the compiled count against a plain one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.calibration.plane_fit import Calibrator
from services.infra_lidar.config import CalibrationConfig, GroundConfig
from services.infra_lidar.segmentation.drops import DEEP_M, DEEP_SHARE, MIN_POINTS
from services.infra_lidar.segmentation.ground import Ground
from spotter_sim.lidar128 import scan
from spotter_sim.street import street

LEVEL = np.eye(4)
EDGE_M = 12.0  # beside the middle; there the road ends


def _road_with_bank(deep_m, n=60_000, seed=0):
    """A level road with lower ground beyond its edge, (n, 3) in the level frame."""
    xy = np.random.default_rng(seed).uniform(-45.0, 45.0, (n, 2))
    xy = xy[np.hypot(*xy.T) > 3.0]
    return np.column_stack([xy, np.where(xy[:, 1] > EDGE_M, -deep_m, 0.0)]).astype(np.float32)


def _drops(points, config=None):
    """The ground that was fitted to points, and a look-up of its drops at positions (K, 2)."""
    ground = Ground(config or GroundConfig())
    levelled = ground.level_only(points, LEVEL)
    ground.remove_levelled(levelled)
    found = ground.find_drops(levelled)
    return found, lambda *places: found[ground.cells_at(*np.array(places, float).T)]


@pytest.mark.parametrize("deep_m", [1.0, 2.5, 6.0], ids=["shallow", "deep", "below the clip"])
def test_a_bank_is_a_drop_and_the_road_beside_it_is_none(deep_m):
    _, at = _drops(_road_with_bank(deep_m))
    assert at((0.0, 20.0), (25.0, 25.0), (-15.0, 30.0)).all()
    assert not at((0.0, 5.0), (30.0, -5.0), (-20.0, 0.0), (20.0, -30.0)).any()


def test_a_vehicle_in_the_lane_beside_the_bank_stands_on_road():
    _, at = _drops(_road_with_bank(3.0))
    lane_m = EDGE_M - 2.5
    assert not at(*((x, lane_m) for x in np.linspace(-30.0, 30.0, 25))).any()


@pytest.mark.parametrize("deep_m", [0.0, 0.2, -0.15], ids=["level", "gutter", "kerb"])
def test_a_street_has_none(deep_m):
    found, _ = _drops(_road_with_bank(deep_m))
    assert not found.any()


def test_a_slope_is_no_drop():
    points = _road_with_bank(0.0)
    points[:, 2] = -0.04 * points[:, 0]
    found, _ = _drops(points)
    assert not found.any()


@pytest.mark.parametrize("seed", range(2000, 2008))
def test_nobody_in_a_random_street_stands_on_a_drop(seed):
    """Kerbs, ramps and verges; the verges of some rise or fall so far that the road's surface is left."""
    scenario = street(seed)
    turn, pitch_deg = scan(scenario, 0.0, 1200), np.degrees(scenario.scene.mount.pitch_rad)
    calibration = Calibrator(CalibrationConfig(prior_pitch_deg=pitch_deg)).add(turn.xyz)
    assert not calibration.refused
    ground = Ground(GroundConfig())
    levelled = ground.level_only(turn.xyz, calibration.T_level_sensor)
    ground.remove_levelled(levelled)
    somebody = turn.actor_id > 0
    assert somebody.sum() > 200
    drops = ground.find_drops(levelled)
    assert drops[ground.cells_at(levelled.x[somebody], levelled.y[somebody])].mean() < 0.01


def test_mirrored_returns_in_a_puddle_are_no_drop():
    rng = np.random.default_rng(1)
    mirrored = np.column_stack([rng.uniform(14.0, 16.0, (30, 2)), np.full(30, -1.5)])
    found, _ = _drops(np.vstack([_road_with_bank(0.0), mirrored]).astype(np.float32))
    assert not found.any()


def test_no_points_no_drops():
    found, _ = _drops(np.zeros((0, 3), np.float32))
    assert not found.any()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 3000), st.sampled_from([1.0, 2.5, 5.0]))
def test_equals_a_plain_count(seed, n, ring_m):
    config = GroundConfig(ring_m=ring_m, range_max_m=30.0)
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-33.0, 33.0, (n, 2)), rng.uniform(-4.0, 2.0, n)]).astype(np.float32)
    ground = Ground(config)
    levelled = ground.level_only(points, LEVEL)
    ground.remove_levelled(levelled)
    shape = ground.surface.shape[:2]
    deep, flat = np.zeros(shape), np.zeros(shape)
    x, y, z = (axis.astype(np.float64) for axis in levelled[:3])
    ring, sector = ground.cells_at(x, y)
    above_m = z - ground.road_height(x, y)
    used = (np.hypot(x, y) <= config.range_max_m) & (z <= config.height_max_m)
    near_a_limit = np.zeros(shape, bool)
    for i in np.flatnonzero(used):
        for r in range(max(ring[i] - 1, 0), min(ring[i] + 2, shape[0])):
            for s in {(sector[i] + step) % shape[1] for step in (-1, 0, 1)}:
                deep[r, s] += above_m[i] < -DEEP_M
                flat[r, s] += abs(above_m[i]) <= config.below_m
                near_a_limit[r, s] |= min(abs(above_m[i] + DEEP_M), abs(abs(above_m[i]) - config.below_m)) < 1e-4
    expected = (deep >= MIN_POINTS) & (deep > DEEP_SHARE * (deep + flat))
    # at the edge of a cell, where float32 may round to the other one, every cell around it is left out
    turn = (np.arctan2(y, x) + np.pi) / (2 * np.pi) * shape[1]
    edge = np.abs(turn - np.round(turn)) < 1e-4
    edge |= np.abs(np.hypot(x, y) / ring_m - np.round(np.hypot(x, y) / ring_m)) < 1e-4
    for i in np.flatnonzero(edge):
        rows = [r for r in range(ring[i] - 2, ring[i] + 3) if 0 <= r < shape[0]]
        near_a_limit[np.ix_(rows, [(sector[i] + step) % shape[1] for step in range(-2, 3)])] = True
    assert near_a_limit.mean() < 0.5
    found = ground.find_drops(levelled)
    np.testing.assert_array_equal(found[~near_a_limit], expected[~near_a_limit])
