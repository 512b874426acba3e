"""The article's spacing feature by plain loops: exact neighbours in a grid of cells, for the speed comparison."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from benchmarks.article.costly_features import NEIGHBOURS
from services.infra_lidar.jit import kernel

POINTS_A_CELL = 2.0


def spacing_deviation(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(K,) float32, metres: standard deviation, over the points of a cluster, of the mean distance to the five nearest
    others; 0 for up to six points."""
    return np.asarray(_deviations(np.ascontiguousarray(points, np.float32), np.asarray(offsets, np.int64)))


@kernel
def _deviations(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    out = np.zeros(len(offsets) - 1, np.float32)
    for k in range(len(out)):
        if offsets[k + 1] - offsets[k] > NEIGHBOURS + 1:
            out[k] = neighbour_distances(points[offsets[k] : offsets[k + 1]]).std()
    return out


class CellGrid(NamedTuple):
    """A cluster in cubic cells of ``size_m``: points (n, 3) sorted by cell, cell c has rows start[c]:start[c + 1].

    low: (3,) corner of the grid, m. shape: (3,) number of cells along x, y, z; x runs fastest.
    """

    points: np.ndarray
    start: np.ndarray
    low: np.ndarray
    shape: np.ndarray
    size_m: float


@kernel
def neighbour_distances(points: np.ndarray) -> np.ndarray:
    """(n,) float32: mean distance of points (n, 3) float32 to their five nearest others, in some order; n > 5. Exact.

    Points are sorted into cells. From each point cubes of cells are searched, larger and larger, until none outside can
    hold a nearer point than the fifth found.
    """
    grid = sorted_into_cells(points)
    mean_m = np.empty(len(points), np.float32)
    widest = grid.shape.max()
    for i in range(len(points)):
        reach = 1
        a, b, c, d, e = _five_nearest(grid, i, reach)
        while e > (reach * grid.size_m) ** 2 and reach < widest:
            reach += 1
            a, b, c, d, e = _five_nearest(grid, i, reach)
        total_m = np.sqrt(a) + np.sqrt(b) + np.sqrt(c) + np.sqrt(d) + np.sqrt(e)
        mean_m[i] = total_m / np.float32(NEIGHBOURS)
    return mean_m


@kernel
def sorted_into_cells(points: np.ndarray) -> CellGrid:
    """Cells of about POINTS_A_CELL points, where a cluster covers the faces of its box; at most 8 cells a point."""
    n, low, extent = len(points), np.empty(3, np.float32), np.empty(3, np.float32)
    for axis in range(3):
        low[axis] = points[:, axis].min()
        extent[axis] = points[:, axis].max() - low[axis]
    faces_m2 = extent[0] * extent[1] + extent[1] * extent[2] + extent[2] * extent[0]
    size_m = max(math.sqrt(POINTS_A_CELL * faces_m2 / n), 1e-3, extent.max() / 1000.0)
    shape = (extent / size_m).astype(np.int64) + 1
    while shape.prod() > 8 * n + 64:
        size_m *= 1.5
        shape = (extent / size_m).astype(np.int64) + 1
    cell, start = np.empty(n, np.int64), np.zeros(shape.prod() + 1, np.int64)
    for i in range(n):
        x, y = int((points[i, 0] - low[0]) / size_m), int((points[i, 1] - low[1]) / size_m)
        cell[i] = (int((points[i, 2] - low[2]) / size_m) * shape[1] + y) * shape[0] + x
        start[cell[i] + 1] += 1
    start = start.cumsum()
    to, placed = start.copy(), np.empty((n, 3), np.float32)
    for i in range(n):
        placed[to[cell[i]]] = points[i]
        to[cell[i]] += 1
    return CellGrid(placed, start, low, shape, size_m)


@kernel
def _five_nearest(grid: CellGrid, i: int, reach: int) -> tuple[float, float, float, float, float]:
    """Rising squared distances of the five nearest others of point i within ``reach`` cells; infinity where none is.

    Each candidate is carried down the five by minimum and maximum: without a branch, the processor need not guess.
    """
    x, y, z = grid.points[i, 0], grid.points[i, 1], grid.points[i, 2]
    cx, cy = int((x - grid.low[0]) / grid.size_m), int((y - grid.low[1]) / grid.size_m)
    cz = int((z - grid.low[2]) / grid.size_m)
    first, last = max(cx - reach, 0), min(cx + reach, grid.shape[0] - 1)
    a = b = c = d = e = np.float32(np.inf)
    for kz in range(max(cz - reach, 0), min(cz + reach + 1, grid.shape[2])):
        for ky in range(max(cy - reach, 0), min(cy + reach + 1, grid.shape[1])):
            row = (kz * grid.shape[1] + ky) * grid.shape[0]
            for j in range(grid.start[row + first], grid.start[row + last + 1]):  # neighbours along x lie together
                dx, dy, dz = grid.points[j, 0] - x, grid.points[j, 1] - y, grid.points[j, 2] - z
                rest = dx * dx + dy * dy + dz * dz if j != i else np.float32(np.inf)
                a, rest = min(a, rest), max(a, rest)
                b, rest = min(b, rest), max(b, rest)
                c, rest = min(c, rest), max(c, rest)
                d, rest = min(d, rest), max(d, rest)
                e = min(e, rest)
    return a, b, c, d, e
