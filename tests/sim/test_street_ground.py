"""Streets with kerbs: the ground that rays hit is the ground's height; its sizes are those that were asked for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.geometry import transform_points
from spotter_sim.lidar128 import scan
from spotter_sim.solids import GROUND_ID
from spotter_sim.street import street
from spotter_sim.street_ground import CrossSection, Ramp, StreetGround

SECTION = CrossSection((2.0, 9.0), 5.5, kerb_m=0.12, gutter_m=0.4, ramps=(Ramp(10.0),), island=(5.0, 6.0, -8.0, -4.0))
GROUND = StreetGround(section=SECTION)
GUTTER_M = -0.025 * 3.1 - 0.06 * 0.4  # at the kerb, below the crown line


@pytest.mark.parametrize(
    ("x", "y", "z"),
    [
        (5.5, 0.0, 0.0),
        (4.5, 0.0, -0.025),
        (2.4, 0.0, -0.025 * 3.1),
        (2.015, 0.0, GUTTER_M),
        (1.98, 0.0, GUTTER_M + 0.12),
        (9.02, 0.0, GUTTER_M + 0.12),
        (1.0, 0.0, GUTTER_M + 0.12 + 0.02),
        (1.999, 10.0, GUTTER_M),
        (1.0, 10.0, GUTTER_M + 1 / 12 + 0.02),
        (5.5, -6.0, 0.12),
    ],
    ids=["crown", "camber", "gutter's edge", "gutter", "kerb", "far kerb", "footway", "ramp's foot", "ramp", "island"],
)  # fmt: skip
def test_heights(x, y, z):
    assert float(GROUND.height(x, y)) == pytest.approx(z, abs=0.003)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_returns_of_the_ground_lie_on_it(seed):
    scenario = street(seed)
    seen = scan(scenario, 5.0, 120)
    points = transform_points(scenario.scene.T_map_pole, seen.xyz[seen.actor_id == GROUND_ID].astype(float))
    off = points[:, 2] - scenario.scene.ground.height(points[:, 0], points[:, 1])
    assert len(points) > 1000
    assert np.percentile(np.abs(off), 97) < 0.06  # two centimetres of noise in range; the rest grazes a kerb's face
    assert np.abs(off).max() < 0.4


def test_the_road_plane_is_that_of_the_near_half():
    point, normal = GROUND.road_plane(0.0, 3.0)
    assert point == pytest.approx([2.4, 3.0, -0.025 * 3.1])
    assert normal[:2] / normal[2] == pytest.approx([-0.025, 0.0])
    _, beyond = GROUND.road_plane(11.0, 3.0)
    assert beyond[0] / beyond[2] == pytest.approx(0.025)


def test_one_crossfall_has_one_plane_from_both_sides():
    ground = StreetGround(section=CrossSection((2.0, 9.0), 2.0))
    assert ground.road_plane(0.0, 0.0)[1] == pytest.approx(ground.road_plane(11.0, 0.0)[1])
    assert float(ground.height(8.99, 0.0)) == pytest.approx(-0.025 * 6.99)
