"""Which plane is roughly the road: hypotheses through three points each (RANSAC, Fischler and Bolles 1981).

They are drawn with a fixed seed. A hypothesis needs a normal within the mounting cone; it is scored by the points near
it minus those below it, because nothing lies under a road. A plane outside the cone that explains twice as much refuses
the prior. So does one that explains more and is near to the best plane within: the cone cuts its road off.
"""

from __future__ import annotations

import numpy as np

from common.geometry import rotation_rpy
from services.infra_lidar.config import CalibrationConfig
from services.infra_lidar.jit import kernel

SCORED_POINTS = 2000  # enough to choose a hypothesis; the refit takes all
BELOW_COST = 3.0  # how much a point under the plane counts against one on it
CONTRADICTION, MIN_CONTRADICTION_M = 2.0, 1.0  # a plane outside the cone refuses the prior: score ratio, distance
ROAD_LIKE_DEG = 20.0  # so near to the best plane within it is no wall: there explaining more is enough


def best_hypothesis(
    near: np.ndarray, config: CalibrationConfig, generator: np.random.Generator
) -> tuple[np.ndarray, float] | str:
    """(normal, offset) with normal . p + offset = 0 on the road, or why there is none.

    near: (N, 3) float64 m, sensor frame, the points near the pole. normal: (3,) unit vector, up. offset: height of the
    sensor above the plane, m.

    Planes outside the mounting cone are scored as well: where one of them explains far more than all planes within,
    the prior is wrong, and a wall in the cone is not taken for the road.
    """
    prior = rotation_rpy(np.radians(config.prior_roll_deg), np.radians(config.prior_pitch_deg), 0.0).T[:, 2]
    a, b, c = near[generator.integers(0, len(near), (3, config.hypotheses))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 0.5  # the normal of a sliver of a triangle is noise
    normals, a = normals[usable] / lengths[usable, None], a[usable]
    offsets = -np.einsum("ij,ij->i", normals, a)
    aside = np.abs(normals @ prior) < np.cos(np.radians(config.max_tilt_deg))
    side = np.where(aside, offsets, normals @ prior)  # outside the cone, up is where the sensor is
    normals, offsets = normals * np.sign(side)[:, None], offsets * np.sign(side)
    fits = (
        (offsets >= config.height_min_m) & (offsets <= config.height_max_m) & (~aside | (offsets > MIN_CONTRADICTION_M))
    )
    normals, offsets, aside = normals[fits], offsets[fits], aside[fits]
    scores = _scores(near, normals, offsets, config.inlier_m)
    if not len(scores):
        return "no plane within the mounting cone"
    within = np.where(aside, -np.inf, scores)
    best = int(np.argmax(within))
    road_like = normals @ normals[best] > np.cos(np.radians(ROAD_LIKE_DEG))
    outside = np.where(aside, scores / np.where(road_like, 1.0, CONTRADICTION), -np.inf)
    if outside.max() > max(0.0, within[best]):
        found = _mounting_text(normals[int(outside.argmax())])
        return f"the road was expected {_prior_text(config)}; found at {found}"
    if not np.isfinite(within[best]):
        return "no plane within the mounting cone"
    return normals[best], float(offsets[best])


def _scores(near: np.ndarray, normals: np.ndarray, offsets: np.ndarray, inlier_m: float) -> np.ndarray:
    """Weight of the points on each plane, less those under it."""
    sample = np.ascontiguousarray(near[:: max(1, len(near) // SCORED_POINTS)])
    weight = 1.0 / (1.0 + np.einsum("ij,ij->i", sample, sample) / 10.0**2)
    return _weight_on_planes(sample, weight, np.ascontiguousarray(normals.T), offsets, inlier_m)


@kernel
def _weight_on_planes(
    points: np.ndarray, weight: np.ndarray, normals: np.ndarray, offsets: np.ndarray, inlier_m: float
) -> np.ndarray:
    """(H,) score of each plane: the weight of the points near it, less that of those under it.

    points (M, 3) float64 m, weight (M,); the planes have normals (3, H) and offsets (H,) in metres.
    """
    (nx, ny, nz), scores = normals, np.zeros(len(offsets))
    for i in range(len(points)):
        x, y, z, w = points[i, 0], points[i, 1], points[i, 2], weight[i]
        for h in range(len(offsets)):  # the planes are the inner loop, without branches: the compiler vectorises it
            height = nx[h] * x + ny[h] * y + nz[h] * z + offsets[h]
            on, under = abs(height) < inlier_m, height < -3.0 * inlier_m
            scores[h] += w * (on - BELOW_COST * under)
    return scores


def _prior_text(config: CalibrationConfig) -> str:
    return (
        f"within {config.max_tilt_deg:g} deg of prior_pitch_deg = {config.prior_pitch_deg:g}, "
        f"prior_roll_deg = {config.prior_roll_deg:g}"
    )


def _mounting_text(normal: np.ndarray) -> str:
    """Pitch and roll of a sensor whose level normal is ``normal``."""
    pitch, roll = -np.arcsin(np.clip(normal[0], -1.0, 1.0)), np.arctan2(normal[1], normal[2])
    return f"pitch {np.degrees(pitch):.0f}, roll {np.degrees(roll):.0f}: check their signs, or max_tilt_deg"
