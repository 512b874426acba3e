"""The truth against independent brute force: point clouds of the bodies, finite differences, plain tables."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from common.geometry import invert, transform_points
from spotter_sim.truth import band, decide, expect, lidar_zones
from spotter_sim.world import T_vehicle_ld06, T_vehicle_radar, world_at

ON, DEG, OFF = "online", "degraded", "disconnected"


def surface_cloud(solids, per_solid=3000):
    """Points on the surfaces of solids (map frame), by pushing random points of the unit shapes outwards."""
    rng = np.random.default_rng(4)
    clouds = []
    for i, shape in enumerate(solids.shape):
        u = rng.normal(size=(per_solid, 3))
        if shape == 2:
            u /= np.abs(u).max(axis=1, keepdims=True)
        elif shape == 1:
            side = u / np.hypot(u[:, 0], u[:, 1])[:, None]
            side[:, 2] = rng.uniform(-1, 1, per_solid)
            u = side
        else:
            u /= np.linalg.norm(u, axis=1, keepdims=True)
        clouds.append(solids.centre_m[i] + u @ solids.from_unit[i].T)
    return np.vstack(clouds)


@pytest.mark.parametrize("t_s", [3.2, 3.8, 4.3, 4.7, 5.3, 6.2, 6.7, 10.5, 11.2, 12.5, 13.9])
def test_nearest_in_the_corridor_against_a_cloud(t_s):
    world = world_at("crossing", t_s)
    T_lidar_map = invert(world.T_map_vehicle @ T_vehicle_ld06)
    points = transform_points(T_lidar_map, np.vstack([surface_cloud(a.solids, 40_000) for a in world.actors[:2]]))
    ahead = points[(np.abs(points[:, 2]) < 0.012) & (points[:, 0] > 0.0) & (points[:, 0] <= 3.0)]
    inside = ahead[np.abs(np.arctan2(ahead[:, 1], ahead[:, 0])) <= np.radians(20)]
    inside = inside[np.hypot(inside[:, 0], inside[:, 1]) >= 0.2]
    zones = lidar_zones(world)
    strips = {
        "centre_m": np.abs(inside[:, 1]) <= 0.0955,
        "left_m": (inside[:, 1] > 0.0955) & (inside[:, 1] <= 0.1205),
        "right_m": (inside[:, 1] < -0.0955) & (inside[:, 1] >= -0.1205),
    }
    for name, mask in strips.items():
        got = getattr(zones, name)
        if got is None:
            assert not mask.any()
        elif mask.any():
            assert got == pytest.approx(inside[mask, 0].min(), abs=0.03), name


@pytest.mark.parametrize("t_s", [1.0, 2.0, 3.0, 3.7, 4.4, 9.5, 10.4, 11.4, 13.6, 14.4])
def test_radar_targets_against_finite_differences(t_s):
    origin = T_vehicle_radar[:3, 3]
    truth = {target.actor_id: target for target in expect("crossing", t_s).radar_targets}
    for actor in world_at("crossing", t_s).actors[:2]:
        ranges = []
        for t in (t_s - 0.02, t_s, t_s + 0.02):
            later = next(a for a in world_at("crossing", t).actors if a.actor_id == actor.actor_id)
            ranges.append(np.linalg.norm(surface_cloud(later.solids) - origin, axis=1).min())
        if actor.actor_id in truth:
            target = truth[actor.actor_id]
            assert target.range_m == pytest.approx(ranges[1], abs=0.12)
            if actor.kind == "car":  # a rigid body; a walker's nearest point is a swinging leg
                assert target.velocity_mps == pytest.approx((ranges[2] - ranges[0]) / 0.04, abs=0.15)
            assert (target.azimuth_rad > 0) == (actor.position_m[1] > 0) or abs(target.azimuth_rad) < 0.05
        else:
            speed = np.linalg.norm(actor.velocity_mps)
            assert speed < 0.2 or ranges[1] > 5.8 or abs(np.arctan2(*actor.position_m[1::-1])) > np.radians(44)


@pytest.mark.parametrize(
    ("distance_m", "level"),
    [(None, "SAFE"), (0.3, "IMMINENT"), (0.8, "IMMINENT"), (0.81, "CAUTION"), (1.8, "CAUTION"), (1.81, "SAFE")],
)
def test_bands_include_their_limits(distance_m, level):
    assert band(distance_m, (0.8, 1.8)) == level


@pytest.mark.parametrize(
    ("lidar", "radar", "camera", "state", "verdict"),
    [
        ("SAFE", "SAFE", None, (ON, ON, ON), "SAFE"),
        ("SAFE", "SAFE", "IMMINENT", (ON, ON, ON), "SAFE"),  # the camera alone is an advisory
        ("CAUTION", "SAFE", "IMMINENT", (ON, ON, ON), "IMMINENT"),  # confirmed: the worst counts
        ("SAFE", "CAUTION", None, (ON, ON, ON), "CAUTION"),
        ("SAFE", "IMMINENT", "SAFE", (ON, ON, ON), "IMMINENT"),
        (None, "SAFE", "SAFE", (DEG, ON, ON), "CAUTION"),  # the camera stands in for the lidar
        (None, "SAFE", None, (OFF, ON, ON), "SAFE"),
        (None, "SAFE", None, (DEG, ON, DEG), "CAUTION"),  # two of three are out
        ("SAFE", None, None, (ON, OFF, ON), "SAFE"),
        (None, None, None, (OFF, OFF, OFF), "CAUTION"),
    ],
)
def test_decision(lidar, radar, camera, state, verdict):
    assert decide(lidar, radar, camera, state) == verdict


@pytest.fixture(scope="module")
def turn():
    """The truth of one whole crossing, every 0.1 s."""
    return [expect("crossing", t) for t in np.arange(0.0, 15.0, 0.1)]


def test_crossing_goes_up_and_down_twice(turn):
    """SAFE, CAUTION, IMMINENT and back, for the person and for the car, with SAFE phases of two seconds between."""
    before = turn[-1:] + turn[:-1]
    changes = [(a.t_s, a.verdict) for a, b in zip(turn, before, strict=True) if a.verdict != b.verdict]
    approach = ["CAUTION", "IMMINENT", "CAUTION", "SAFE"]
    assert [level for _, level in changes] == approach * 2
    for (since, level), (until, _) in pairwise([*changes, (changes[0][0] + 15.0, "")]):
        assert until - since > 2.0 or level != "SAFE"


@pytest.mark.parametrize("sensor", ["lidar_level", "radar_level", "camera_level"])
def test_every_sensor_sees_both_approaches(turn, sensor):
    expected = {"SAFE", "CAUTION"} if sensor == "camera_level" else {"SAFE", "CAUTION", "IMMINENT"}
    for half in (turn[:75], turn[75:]):
        assert expected <= {getattr(truth, sensor) for truth in half}


def test_empty_is_safe():
    truth = expect("empty", 3.0)
    assert (truth.verdict, truth.lidar_level, truth.radar_level, truth.camera_level) == ("SAFE", "SAFE", "SAFE", None)


@pytest.mark.parametrize(
    ("t_s", "states"),
    [
        (2.0, (ON, ON, ON)),
        (6.0, (DEG, ON, ON)),
        (15.0, (OFF, ON, ON)),
        (24.0, (ON, ON, DEG)),
        (33.0, (ON, ON, OFF)),
        (42.0, (ON, OFF, ON)),
        (51.0, (ON, OFF, ON)),
        (60.0, (DEG, ON, DEG)),
        (70.0, (DEG, OFF, DEG)),
    ],
)
def test_states_in_faults(t_s, states):
    truth = expect("faults", t_s)
    assert (truth.lidar_state, truth.radar_state, truth.camera_state) == states
    if sum(s != ON for s in states) >= 2:
        assert truth.verdict != "SAFE"
