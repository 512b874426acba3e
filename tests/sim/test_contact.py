"""Gaps and contacts against plain geometry."""

from __future__ import annotations

import numpy as np
import pytest

from common.geometry import invert, transform_points
from spotter_sim.contact import contact_s, gap_m
from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Circuit, Standing, Straight, ellipse
from spotter_sim.scene import Ground, Mount, Scene, post
from spotter_sim.solids import box, join
from spotter_sim.truth import expect
from spotter_sim.vehicle import CART, MODEL_CAR
from spotter_sim.world import world_at


def place(vehicle, *fixtures, cast=(), chassis=MODEL_CAR):
    scene = Scene(Ground(), join([post(-50.0, 0.0, 0.0, 1.0), *fixtures]), Mount(0.0, -9.0))
    return Scenario("place", 60.0, scene, tuple(cast), vehicle=vehicle, chassis=chassis)


BOX = box((2.0, 2.4), (-0.3, 0.3), (0.0, 0.4), "wall", "wood")
HIGH = box((0.5, 0.9), (-0.3, 0.3), (0.3, 0.9), "wall", "wood")
FLAT = box((0.0, 0.4), (-0.3, 0.3), (0.0, 0.01), "wall", "wood")


@pytest.mark.parametrize(
    ("pose", "fixture", "chassis", "expected"),
    [
        (Standing(0.0, 0.0), BOX, MODEL_CAR, 1.8),
        (Standing(0.0, 0.0), BOX, CART, 1.2),
        (Standing(1.85, 0.0), BOX, MODEL_CAR, -0.05),
        (Standing(2.2, 1.0), BOX, MODEL_CAR, 0.7 - 0.0955),
        (Standing(1.0, 1.0, np.pi / 2), BOX, MODEL_CAR, np.hypot(1.0 - 0.0955, 0.5)),
        (Standing(0.0, 0.0), HIGH, MODEL_CAR, 3.0),  # passes below it
        (Standing(0.0, 0.0), HIGH, CART, -0.3),
        (Standing(0.0, 0.0), FLAT, MODEL_CAR, 3.0),  # drives over it
        (Standing(0.0, 0.0), post(0.0, 1.0, 0.0, 1.0, 0.1), MODEL_CAR, 0.9 - 0.0955),
    ],
)
def test_gap(pose, fixture, chassis, expected):
    assert gap_m(world_at(place(pose, fixture, chassis=chassis), 0.0)) == pytest.approx(expected, abs=0.003)


@pytest.mark.parametrize("t_s", [0.5, 3.0, 6.1, 9.0])
def test_gap_to_a_walker_against_a_cloud(t_s):
    """The nearest of many points on the body within the height of the vehicle."""
    cast = [Player(1, "pedestrian", Straight((3.0, 0.5), np.pi + 0.2, 0.3, 60.0))]
    world = world_at(place(Standing(0.1, 0.0, 0.3), cast=cast), t_s)
    rng, solids, cloud = np.random.default_rng(3), world.actors[0].solids, []
    for i in range(len(solids)):
        unit = rng.normal(size=(20_000, 3))
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        if solids.shape[i] == 1:  # a drum
            unit = np.column_stack(
                [unit[:, :2] / np.hypot(unit[:, 0], unit[:, 1])[:, None], rng.uniform(-1, 1, 20_000)]
            )
        cloud.append(solids.centre_m[i] + unit @ solids.from_unit[i].T)
    points = transform_points(invert(world.T_map_vehicle), np.vstack(cloud))
    points = points[points[:, 2] < 0.25]
    beyond = np.maximum(np.abs(points[:, :2]) - [0.2, 0.0955], 0.0)
    # a leg counts as a whole, as it is seen from above: its upper end may be nearer than what is below the roof
    assert gap_m(world) <= np.linalg.norm(beyond, axis=1).min() + 0.01
    assert gap_m(world) >= np.linalg.norm(beyond, axis=1).min() - 0.30


@pytest.mark.parametrize(
    ("vehicle", "cast", "expected"),
    [
        (Straight((0.0, 0.0), 0.0, 1.0, 60.0), [], 1.8),
        (Straight((0.0, 0.0), 0.0, 0.1, 60.0), [], None),
        (Straight((0.0, 0.7), 0.0, 1.0, 60.0), [], None),
        (Standing(0.0, 0.7), [Player(1, "car", Straight((8.0, 0.7), np.pi, 1.5, 60.0))], (8.0 - 2.15 - 0.2) / 1.5),
        (Straight((0.0, 3.0), 0.0, 2.0, 60.0), [Player(1, "car", Straight((4.0, 7.0), -np.pi / 2, 1.5, 60.0))], 1.45),
        (Circuit(ellipse((0.0, -1.0), (1.0, 1.0), -1.0), 6.0), [], None),  # turns off before it comes to the box
    ],
)
def test_contact_if_all_go_on(vehicle, cast, expected):
    found = contact_s(world_at(place(vehicle, BOX, cast=cast), 0.0), 6.0)
    if expected is None:
        assert found is None
    else:
        assert found == pytest.approx(expected, abs=0.11)


def test_a_kerb_below_every_sensor_is_in_the_truth_all_the_same():
    """15 cm high and 0.3 m ahead: below the LD06's plane, no band says a word, and the outline will hit it."""
    kerb = box((0.5, 0.7), (-2.0, 2.0), (0.0, 0.15), "wall", "concrete")
    truth = expect(place(Straight((0.0, 0.0), 0.0, 0.5, 60.0), kerb), 0.0)
    assert (truth.lidar_level, truth.verdict) == ("SAFE", "SAFE"), "what the article's rules say"
    assert truth.contact_s == pytest.approx(0.3 / 0.5, abs=0.11)
    assert gap_m(world_at(place(Standing(0.0, 0.0), kerb), 0.0)) == pytest.approx(0.3, abs=0.003)
