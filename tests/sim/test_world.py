"""One world, a pure function of (scenario, time)."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest

from common.geometry import invert, transform_points
from spotter_sim.model import FAULTS
from spotter_sim.world import SCENARIOS, T_map_pole, scenario_time, world_at


def test_scenarios_by_name():
    assert set(SCENARIOS) == {"crossing", "empty", "faults", "drive", "emergency"}
    assert SCENARIOS["crossing"].length_s <= 15.0
    with pytest.raises(ValueError, match="known: crossing, empty, faults, drive, emergency"):
        world_at("nowhere", 0.0)


def test_time_repeats_after_the_length():
    a, b = world_at("crossing", 3.25), world_at("crossing", 3.25 + 15.0)
    assert [x.position_m.tolist() for x in a.actors] == [x.position_m.tolist() for x in b.actors]


def test_scenario_time_is_utc_modulo_the_length():
    utc_ns = 1_790_000_000_123_456_789
    assert scenario_time("crossing", utc_ns) == pytest.approx((utc_ns % 15_000_000_000) / 1e9, abs=1e-9)
    started = utc_ns - 2_000_000_000
    assert scenario_time("crossing", utc_ns, t0_s=14.0, started_ns=started) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="started_ns"):
        scenario_time("crossing", utc_ns, t0_s=1.0)


def test_the_world_is_the_same_in_every_order_of_questions():
    forward = [world_at("crossing", t).solids.centre_m for t in (1.0, 2.0, 3.0)]
    backward = [world_at("crossing", t).solids.centre_m for t in (3.0, 2.0, 1.0)][::-1]
    for a, b in zip(forward, backward, strict=True):
        np.testing.assert_array_equal(a, b)


def test_empty_is_empty_and_the_same_place():
    assert world_at("empty", 1.0).actors == ()
    assert len(world_at("empty", 1.0).solids) == len(SCENARIOS["crossing"].scene.fixtures)


def test_faults_last_and_leave_time_to_recover():
    faults = SCENARIOS["faults"]
    assert {f.name for f in faults.faults} <= set(FAULTS)
    for fault in faults.faults:
        assert fault.end_s - fault.start_s >= 4.0
    edges = sorted({(f.start_s, f.end_s) for f in faults.faults})
    gaps = [after[0] - before[1] for before, after in pairwise(edges)]
    assert min(gaps) >= 3.0
    assert world_at("faults", 5.0).faults == {"lidar_blocked"}
    assert world_at("faults", 10.0).faults == frozenset()
    assert world_at("faults", 70.0).faults == {"lidar_blocked", "camera_dark", "radar_silent"}


def test_bodies_fill_their_boxes():
    """Each body stays inside its box (the box of a walker includes the stride) and reaches its height."""
    for actor in world_at("crossing", 3.3).actors:
        local = transform_points(invert(actor.T_map_body), actor.solids.centre_m)
        half = np.sum(np.abs(actor.T_map_body[:3, :3].T @ actor.solids.from_unit), axis=2)
        low, high = (local - half).min(axis=0), (local + half).max(axis=0)
        length, width, height = actor.size_m
        slack = np.array([0.3, 0.1, 0.12]) if actor.kind in ("pedestrian", "cyclist") else np.array([0.05, 0.05, 0.02])
        assert np.all(high - low <= np.array([length, width, height]) + 2 * slack), actor.kind
        assert high[2] == pytest.approx(height, abs=0.12), actor.kind
        assert low[2] > -0.1, actor.kind


def test_nobody_stands_in_anybody_near_the_vehicle():
    for t in np.arange(0, 15, 0.25):
        person, car = world_at("crossing", t).actors[:2]
        corner = np.abs(transform_points(invert(car.T_map_body), person.position_m))
        assert corner[0] > car.size_m[0] / 2 + 0.3 or corner[1] > car.size_m[1] / 2 + 0.3, t


def test_pole_truth():
    scene = SCENARIOS["crossing"].scene
    normal = scene.road_normal_sensor
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert 12.0 <= np.degrees(np.arccos(normal[2])) <= 15.5
    level = scene.T_level_sensor
    np.testing.assert_allclose(level[:3, :3] @ normal, [0, 0, 1], atol=1e-12)
    foot_sensor = transform_points(invert(T_map_pole), np.array([scene.mount.x_m, scene.mount.y_m, 0.0]))
    assert transform_points(level, foot_sensor)[2] == pytest.approx(0.0, abs=1e-12)
    assert scene.sensor_height_m == pytest.approx(5.5)


def test_pole_looks_down_and_keeps_left_at_left():
    forward, left = T_map_pole[:3, 0], T_map_pole[:3, 1]
    assert forward[2] < -0.2
    assert forward[1] > 0.9  # along the street
    assert left[0] < -0.9  # the yard is at its left


@pytest.mark.parametrize("t_s", np.arange(0.0, 15.0, 0.25).tolist())
def test_nobody_drives_through_anybody(t_s):
    """Boxes on the visible part of the street and in the yard stay apart."""
    actors = [actor for actor in world_at("crossing", t_s).actors if abs(actor.position_m[1]) < 95.0]
    for one, other in combinations(actors, 2):
        apart = one.T_map_body[:2, :2].T @ (other.position_m - one.position_m)[:2]
        touching = np.abs(apart) < 0.5 * (np.array(one.size_m[:2]) + np.array(other.size_m[:2]))
        assert not touching.all(), f"{one.kind} {one.actor_id} and {other.kind} {other.actor_id}"
