"""Drops: where the ground is seen to lie well below the road, down a bank or behind a retaining wall.

The surface of the road goes on over such places, and heights above it mean nothing there: a tree down the bank of a
motorway looks like a lorry on the road. No vehicle is believed there.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import kernel
from services.infra_lidar.segmentation import ground_kernels as kernels
from services.infra_lidar.segmentation.ground_kernels import CLIPPED, GroundSettings, Levelled

DEEP_M = 0.5  # a return this far below the road is of lower ground
MIN_POINTS = 3  # reflections are seen below the road, too, but one by one
DEEP_SHARE = 0.25  # of the ground that is seen there


def find_drops(levelled: Levelled, surface: np.ndarray, settings: GroundSettings) -> np.ndarray:
    """(rings, sectors) bool: a good part of the ground seen in this cell and its neighbours lies deep below the road.

    levelled: all returns of a frame. surface: (rings, sectors, 3) float32, the road as in ``ground.Ground``.
    """
    x, y, z = levelled.x, levelled.y, levelled.z
    unclipped = settings._replace(height_min_m=-np.inf)
    cell = kernels.polar_cells(x, y, z, unclipped)
    deep, flat = _count(levelled, cell, surface.reshape(-1, 3), settings.below_m)
    shape = surface.shape[:2]
    deep, flat = _with_neighbours(deep.reshape(shape)), _with_neighbours(flat.reshape(shape))
    return np.asarray((deep >= MIN_POINTS) & (deep > DEEP_SHARE * (deep + flat)))


@kernel
def _count(levelled: Levelled, cell: np.ndarray, planes: np.ndarray, near_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns deep below the road, and those within ``near_m`` of it, (C,) int32 each, of the cells (N,) of points."""
    x, y, z = levelled.x, levelled.y, levelled.z
    deep, flat = np.zeros(len(planes), np.int32), np.zeros(len(planes), np.int32)
    for i in range(len(cell)):
        c = cell[i]
        if c == CLIPPED:
            continue
        above_m = z[i] - (planes[c, 0] + planes[c, 1] * x[i] + planes[c, 2] * y[i])
        deep[c] += above_m < -DEEP_M
        flat[c] += abs(above_m) <= near_m
    return deep, flat


def _with_neighbours(count: np.ndarray) -> np.ndarray:
    """(rings, sectors) sum over each cell and the eight around it."""
    in_ring = count + np.roll(count, 1, axis=1) + np.roll(count, -1, axis=1)
    total = in_ring.copy()
    total[1:] += in_ring[:-1]
    total[:-1] += in_ring[1:]
    return np.asarray(total)
