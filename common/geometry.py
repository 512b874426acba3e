"""Frames and transforms. x forward, y left, z up; radians, counter-clockwise positive (REP-103).

``T_target_source`` is a (4, 4) float64 matrix: multiply it with points in *source* and they are in *target*;
subscripts cancel when transforms are chained: ``T_map_sensor = T_map_vehicle @ T_vehicle_sensor``.
"""

from __future__ import annotations

import numpy as np


def wrap_angle(angle_rad: np.ndarray | float) -> np.ndarray:
    """Angle(s) to [-pi, pi)."""
    return np.asarray((np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi)


def rotation_z(yaw_rad: float) -> np.ndarray:
    """(3, 3) rotation about z, counter-clockwise positive."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> np.ndarray:
    """(3, 3) rotation Rz(yaw) @ Ry(pitch) @ Rx(roll): roll first, in fixed axes."""
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    return rotation_z(yaw_rad) @ about_y @ about_x


def rotation_between(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(3, 3) shortest rotation that takes the direction ``source`` to ``target`` (Rodrigues 1840).

    R = I + [v]x + [v]x^2 / (1 + c), v = source x target, c = source . target; 1 + c is half the square of their sum,
    which nothing cancels out of where they are nearly opposite.
    """
    a = np.asarray(source, float) / np.linalg.norm(source)
    b = np.asarray(target, float) / np.linalg.norm(target)
    one_more = 0.5 * float((a + b) @ (a + b))
    if one_more < 1e-12:  # opposite: half a turn about any perpendicular axis
        axis = np.cross(a, [1.0, 0.0, 0.0] if abs(a[0]) < 0.9 else [0.0, 1.0, 0.0])
        axis /= np.linalg.norm(axis)
        return 2.0 * np.outer(axis, axis) - np.eye(3)
    x, y, z = np.cross(a, b)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + skew + skew @ skew / one_more


def transform(rotation: np.ndarray | None = None, translation: np.ndarray | None = None) -> np.ndarray:
    """(4, 4) homogeneous transform from a (3, 3) rotation and a (3,) translation in metres."""
    T = np.eye(4)
    if rotation is not None:
        T[:3, :3] = rotation
    if translation is not None:
        T[:3, 3] = translation
    return T


def pose_2d(x_m: float, y_m: float, yaw_rad: float, z_m: float = 0.0) -> np.ndarray:
    """(4, 4) T_parent_child of something standing at (x, y, z) and heading ``yaw_rad``."""
    return transform(rotation_z(yaw_rad), np.array([x_m, y_m, z_m]))


def invert(T_target_source: np.ndarray) -> np.ndarray:
    """The transform the other way round, T_source_target; exact for rigid transforms."""
    rotation = T_target_source[:3, :3].T
    return transform(rotation, -rotation @ T_target_source[:3, 3])


def is_rigid(T: np.ndarray, tolerance: float) -> bool:
    """Whether a matrix is a (4, 4) rotation and translation: finite, no scale, no mirror, last row 0 0 0 1.

    tolerance: that rows and their products may be off; 0.002 lets a matrix pass that was written with three decimals.
    """
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    rotation = T[:3, :3]
    orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=tolerance)
    last_row = np.allclose(T[3], [0.0, 0.0, 0.0, 1.0], rtol=0.0, atol=tolerance)
    return bool(orthonormal and last_row and np.linalg.det(rotation) > 0.0)


def transform_points(T_target_source: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """(..., 3) points in *source* to the same in *target*."""
    return np.asarray(points_m) @ T_target_source[:3, :3].T + T_target_source[:3, 3]
