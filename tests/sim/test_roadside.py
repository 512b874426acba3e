"""Random roadside scenes: seeded, varied, and with the statistics they are asked for."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from common.geometry import transform_points
from spotter_sim.lidar128 import scan
from spotter_sim.roadside import LENGTH_S, roadside

KINDS = ("open", "level", "facade", "trees", "slope", "bus", "crowd")
SLOPES = {"level": (0.0, 0.0), "slope": (0.05, 0.09)}


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_scene(kind):
    a, b, c = roadside(5, 40, kind), roadside(5, 40, kind), roadside(6, 40, kind)
    assert [p.size_m for p in a.cast] == [p.size_m for p in b.cast]
    np.testing.assert_array_equal(a.scene.T_map_pole, b.scene.T_map_pole)
    assert np.any(a.scene.T_map_pole != c.scene.T_map_pole)
    first, second = scan(a, 2.0, 300), scan(b, 2.0, 300)
    np.testing.assert_array_equal(first.xyz, second.xyz)


@pytest.mark.parametrize("kind", KINDS)
def test_mount_and_ground(kind):
    for seed in range(8):
        scene = roadside(seed, 0, kind).scene
        assert 5.2 <= scene.mount.height_m <= 5.8
        tilt = np.degrees(np.arccos(scene.T_map_pole[2, 2]))
        assert 11.5 <= tilt <= 15.5
        slope = np.hypot(scene.ground.x_slope, scene.ground.y_slope)
        least, most = SLOPES.get(kind, (0.01, 0.03))
        assert least <= slope <= most


def test_about_as_many_objects_as_asked_of_every_kind():
    scenario = roadside(2, 150)
    kinds = [p.kind for p in scenario.cast]
    assert len(kinds) == pytest.approx(150, abs=12)
    assert set(kinds) == {"pedestrian", "cyclist", "car", "bus", "truck"}
    assert kinds.count("pedestrian") > 50
    speeds = [np.linalg.norm(a.velocity_mps) for a in scenario.at(5.0).actors if a.kind == "car"]
    assert min(speeds) == 0.0
    assert max(speeds) > 5.0


def test_a_bus_and_a_crowd_stand_beside_the_pole():
    (bus,) = roadside(3, 0, "bus").at(0.0).actors
    assert bus.kind == "bus"
    assert np.hypot(*bus.position_m[:2]) < 6.0
    people = roadside(3, 0, "crowd").at(0.0).actors
    assert len(people) > 30
    assert all(0.8 < np.hypot(*p.position_m[:2]) < 8.0 for p in people)


def test_vehicles_do_not_stand_in_each_other():
    for seed in range(4):
        cast = [a for a in roadside(seed, 120).at(LENGTH_S / 2).actors if a.kind != "pedestrian"]
        for a, b in combinations(cast, 2):
            gap = np.abs(a.position_m - b.position_m)
            apart = gap[0] > (a.size_m[1] + b.size_m[1]) / 2 or gap[1] > (a.size_m[0] + b.size_m[0]) / 2
            assert apart, (seed, a.kind, b.kind, gap)


@pytest.mark.parametrize("kind", KINDS)
def test_feet_and_ground_points_lie_on_the_ground(kind):
    scenario = roadside(3, 60, kind)
    world = scenario.at(5.0)
    ground = world.scene.ground
    for actor in world.actors:
        assert actor.position_m[2] == pytest.approx(ground.height(actor.position_m[0], actor.position_m[1]))
    s = scan(scenario, 5.0, 600)
    points = transform_points(world.scene.T_map_pole, s.xyz.astype(float))
    below = s.kinds == "ground"
    assert np.abs(points[below, 2] - ground.height(points[below, 0], points[below, 1])).max() < 0.1
    levelled = transform_points(world.scene.T_level_sensor, s.xyz[below].astype(float))
    near = np.hypot(levelled[:, 0], levelled[:, 1]) < 12
    assert np.abs(levelled[near, 2]).mean() < 0.05  # flat near the pole, bent far away


def test_many_objects_are_seen_with_enough_points():
    seen = scan(roadside(4, 150), 5.0)
    ids, counts = np.unique(seen.actor_id[seen.actor_id > 0], return_counts=True)
    assert len(ids) > 90
    assert np.count_nonzero(counts >= 20) > 45
    assert {"wall", "tree", "pole", "bush", "pedestrian", "cyclist", "car"} <= set(seen.kinds.tolist())


def test_facade_and_trees_stand_where_they_disturb():
    facade, trees = scan(roadside(1, 0, "facade"), 0.0, 900), scan(roadside(1, 0, "trees"), 0.0, 900)
    assert (facade.kinds == "wall").sum() > 3 * (trees.kinds == "wall").sum()
    near = np.linalg.norm(trees.xyz, axis=1) < 8
    assert (trees.kinds[near] == "tree").sum() > 500


def test_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="open, level, facade, trees"):
        roadside(1, 10, "moon")
