"""Rays against solids: known answers, and every hit lies on a surface."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.geometry import rotation_rpy
from spotter_sim.raycast import cast
from spotter_sim.solids import BOX, CYLINDER, SPHERE, join, limbs, solid

AHEAD = np.array([[1.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("shape", "half", "expected"),
    [
        (SPHERE, (1.0, 1.0, 1.0), 4.0),
        (SPHERE, (0.5, 2.0, 2.0), 4.5),
        (CYLINDER, (1.0, 1.0, 0.2), 4.0),
        (BOX, (0.25, 1.0, 1.0), 4.75),
    ],
)
def test_first_surface_straight_ahead(shape, half, expected):
    range_m, index = cast(np.zeros(3), AHEAD, solid(shape, (5.0, 0.0, 0.0), half, "wall", "concrete"))
    assert range_m[0] == pytest.approx(expected)
    assert index[0] == 0


def test_nothing_behind_beside_or_beyond():
    ball = solid(SPHERE, (5.0, 0.0, 0.0), (1.0, 1.0, 1.0), "wall", "concrete")
    rays = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.9, np.sqrt(1 - 0.81), 0.0]])
    assert not np.isfinite(cast(np.zeros(3), rays, ball)[0]).any()
    assert not np.isfinite(cast(np.zeros(3), AHEAD, ball, max_range_m=3.9)[0]).any()


def test_the_nearest_of_several_wins():
    two = join([solid(BOX, (x, 0.0, 0.0), (0.5, 0.5, 0.5), "wall", "concrete") for x in (8.0, 5.0)])
    range_m, index = cast(np.zeros(3), AHEAD, two)
    assert (range_m[0], index[0]) == (pytest.approx(4.5), 1)


def test_ray_inside_a_hollow_cylinder_misses_its_caps_only_sideways():
    tube = solid(CYLINDER, (0.0, 0.0, 5.0), (1.0, 1.0, 1.0), "pole", "metal")
    range_m, _ = cast(np.zeros(3), np.array([[0.0, 0.0, 1.0]]), tube)  # along its axis: the cap
    assert range_m[0] == pytest.approx(4.0)


angles = st.floats(-3.0, 3.0)
sizes = st.floats(0.1, 2.0)


@given(
    st.sampled_from([SPHERE, CYLINDER, BOX]), st.tuples(angles, angles, angles), st.tuples(sizes, sizes, sizes), angles
)
def test_every_hit_lies_on_the_surface(shape, rpy, half, aim):
    body = solid(shape, (4.0, 1.0, -0.5), half, "wall", "concrete", rotation_rpy(*rpy))
    direction = np.array([[4.0, 1.0 + 0.5 * aim, -0.5 + 0.3 * aim]])
    direction /= np.linalg.norm(direction)
    range_m, _ = cast(np.zeros(3), direction, body)
    if np.isfinite(range_m[0]):
        u = body.to_unit[0] @ (range_m[0] * direction[0] - body.centre_m[0])
        level = {SPHERE: u @ u, BOX: np.abs(u).max(), CYLINDER: max(np.hypot(u[0], u[1]), abs(u[2]))}[shape]
        assert level == pytest.approx(1.0, abs=1e-6)


@given(st.tuples(angles, angles, angles), st.tuples(angles, angles, angles))
def test_limbs_reach_from_start_to_end(start, end):
    if np.linalg.norm(np.subtract(start, end)) < 0.05:
        return
    limb = limbs([start], [end], [0.1], "pedestrian", ["cloth"])
    tip = limb.centre_m[0] + limb.from_unit[0] @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(tip, end, atol=1e-9)
    columns = limb.from_unit[0]
    np.testing.assert_allclose(np.linalg.norm(columns[:, :2], axis=0), 0.1, atol=1e-9)
    np.testing.assert_allclose(columns.T @ columns, np.diag(np.diag(columns.T @ columns)), atol=1e-9)
    assert np.linalg.det(columns) > 0


def test_radius_holds_the_solid():
    rng = np.random.default_rng(1)
    for shape in (SPHERE, CYLINDER, BOX):
        body = solid(shape, (0.0, 0.0, 0.0), (0.4, 1.0, 0.7), "wall", "concrete", rotation_rpy(0.3, 0.4, 0.5))
        u = rng.uniform(-1, 1, (2000, 3))
        inside = {SPHERE: (u**2).sum(1) <= 1, CYLINDER: (u[:, :2] ** 2).sum(1) <= 1, BOX: np.ones(2000, bool)}[shape]
        reach = np.linalg.norm(u[inside] @ body.from_unit[0].T, axis=1).max()
        assert reach <= body.radius_m[0] + 1e-9
