"""Transforms chain, invert and turn the right way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from common import geometry as g

angles = st.floats(-10, 10)
metres = st.floats(-100, 100)
directions = st.tuples(metres, metres, metres).filter(lambda v: np.linalg.norm(v) > 1e-3)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_are_in_range_and_equivalent(angle_rad: float) -> None:
    wrapped = float(g.wrap_angle(angle_rad))
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle_rad), abs=1e-9)


def test_left_is_left() -> None:
    """A point one metre ahead, seen from a child that heads left (+90 degrees), is to its right (-y)."""
    T_map_child = g.pose_2d(0.0, 0.0, np.pi / 2)
    assert g.transform_points(g.invert(T_map_child), np.array([1.0, 0.0, 0.0])) == pytest.approx([0, -1, 0])


@given(angles, angles, angles, metres, metres, metres)
def test_inverse_undoes(roll: float, pitch: float, yaw: float, x: float, y: float, z: float) -> None:
    T = g.transform(g.rotation_rpy(roll, pitch, yaw), np.array([x, y, z]))
    assert T @ g.invert(T) == pytest.approx(np.eye(4), abs=1e-9)


@example((0.0, 0.0, -1.0), (0.0, 6.103515625e-05, 12.0))  # nearly opposite
@example((0.0, 0.0, -1.0), (0.0, 2e-6, 1.0))
@given(directions, directions)
def test_rotation_between_takes_one_to_the_other(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    rotation = g.rotation_between(np.array(a), np.array(b))
    unit_a, unit_b = np.array(a) / np.linalg.norm(a), np.array(b) / np.linalg.norm(b)
    assert rotation @ unit_a == pytest.approx(unit_b, abs=1e-5)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("axis", np.eye(3))
def test_rotation_between_opposites(axis: np.ndarray) -> None:
    assert g.rotation_between(axis, -axis) @ axis == pytest.approx(-axis)


@pytest.mark.parametrize(
    ("T", "rigid"),
    [
        (np.eye(4), True),
        (g.transform(g.rotation_rpy(0.1, -0.4, 2.0), np.array([8.6, -8.0, 5.5])), True),
        (g.transform(g.rotation_rpy(0.1, -0.4, 2.0).round(3)), True),
        (g.transform(g.rotation_rpy(0.1, -0.4, 2.0).round(2)), False),
        (np.ones((4, 4)), False),
        (np.diag([2.0, 2.0, 2.0, 1.0]), False),
        (np.diag([1.0, 1.0, -1.0, 1.0]), False),  # a mirror
        (g.pose_2d(1.0, 2.0, 0.3).T, False),
        (np.full((4, 4), np.nan), False),
        (np.eye(3), False),
    ],
)
def test_a_rigid_transform_is_a_rotation_and_a_translation(T: np.ndarray, rigid: bool) -> None:
    assert g.is_rigid(T, 0.002) == rigid
