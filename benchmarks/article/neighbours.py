"""The article's spacing feature by plain loops: exact neighbours in a grid of cells, for the speed comparison.

A deviation over many points hardly changes when it is taken over some of them. As for our other features, of large
clusters up to ``MOST_POINTS`` points are asked for their neighbours, which are searched among all. Over the clusters of
the benchmark the feature differs by 0.3 % on average with 40 objects and by 0.5 % with 160, by up to 3 % in 95 of 100.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from benchmarks.article.costly_features import NEIGHBOURS
from services.infra_lidar.classification.feature_kernels import MOST_POINTS
from services.infra_lidar.jit import kernel

POINTS_A_CELL = 3.0
LANES = 8  # points that search side by side
KEPT = NEIGHBOURS + 1  # of the nearest: the point itself is among them


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
    """(q,) float32: mean distance of points (n, 3) float32 to their five nearest others, in some order; n > 5. Exact.

    Up to ``MOST_POINTS`` points are all asked, of more every second, third ... block of ``LANES``. Points are sorted
    into cells, and those of a block, which follow each other, search together. The box of cells around them grows until
    nothing outside can be nearer than the fifth that each has found.
    """
    grid, every, asked = sorted_into_cells(points), (len(points) - 1) // MOST_POINTS + 1, 0
    mean_m, block = np.empty(len(points), np.float32), np.empty((KEPT + 3) * LANES, np.float32)
    for first in range(0, len(points), LANES * every):
        number, reach = min(LANES, len(points) - first), 1
        _search(grid, first, reach, block)
        while block[(KEPT - 1) * LANES :][:LANES].max() > (reach * grid.size_m) ** 2 and reach < grid.shape.max():
            reach += 1
            _search(grid, first, reach, block)
        for i in range(number):
            total_m = np.float32(0.0)
            for k in range(1, KEPT):  # the nearest is the point itself
                total_m += np.sqrt(block[k * LANES + i])
            mean_m[asked + i] = total_m / np.float32(NEIGHBOURS)
        asked += number
    return mean_m[:asked]


@kernel
def sorted_into_cells(points: np.ndarray) -> CellGrid:
    """Cells of about POINTS_A_CELL points, where a cluster covers the faces of its box; at most 8 cells a point."""
    n, low, extent = len(points), np.empty(3, np.float32), np.empty(3, np.float32)
    for axis in range(3):
        low[axis] = points[:, axis].min()
        extent[axis] = points[:, axis].max() - low[axis]
    faces_m2 = extent[0] * extent[1] + extent[1] * extent[2] + extent[2] * extent[0]
    size_m = max(math.sqrt(POINTS_A_CELL * faces_m2 / n), 1e-3, extent.max() / 1000.0)
    per_m = np.float32(1.0 / size_m)
    shape = (extent * per_m).astype(np.int64) + 1  # as the points below, to the last digit
    while shape.prod() > 8 * n + 64:
        size_m *= 1.5
        per_m = np.float32(1.0 / size_m)
        shape = (extent * per_m).astype(np.int64) + 1
    x0, y0, z0 = low[0], low[1], low[2]
    columns, rows = np.int32(shape[0]), np.int32(shape[1])
    cell, start = np.empty(n, np.int32), np.zeros(shape.prod() + 1, np.int32)
    for i in range(n):
        x, y = np.int32((points[i, 0] - x0) * per_m), np.int32((points[i, 1] - y0) * per_m)
        cell[i] = (np.int32((points[i, 2] - z0) * per_m) * rows + y) * columns + x
    for c in cell:
        start[c + 1] += 1
    for c in range(1, len(start)):
        start[c] += start[c - 1]
    to, placed = start.copy(), np.empty((n, 3), np.float32)
    for i in range(n):
        place = to[cell[i]]
        to[cell[i]] = place + 1
        placed[place, 0], placed[place, 1], placed[place, 2] = points[i, 0], points[i, 1], points[i, 2]
    return CellGrid(placed, start, low, shape, size_m)


@kernel
def _search(grid: CellGrid, first: int, reach: int, block: np.ndarray) -> None:
    """Fill ``block`` for the points from ``first`` on, from all points within ``reach`` cells of any of them.

    block ((KEPT + 3) LANES,) float32: the smallest squared distance of each point, the second smallest and so on, then
    x of each, y and z. In one array, at constant places, so that the compiler can vectorise the loop over the points.
    """
    points, start, (columns, rows, _) = grid.points, grid.start, grid.shape
    block[: KEPT * LANES] = np.inf
    for i in range(LANES):  # the last point stands in for those that are missing
        at = min(first + i, len(points) - 1)
        for axis in range(3):
            block[(KEPT + axis) * LANES + i] = points[at, axis]
    x_low, x_high = _cells_within(grid, 0, block, reach)
    y_low, y_high = _cells_within(grid, 1, block, reach)
    z_low, z_high = _cells_within(grid, 2, block, reach)
    for kz in range(z_low, z_high + 1):
        for ky in range(y_low, y_high + 1):
            row = (kz * rows + ky) * columns
            for j in range(start[row + x_low], start[row + x_high + 1]):  # cells along x lie together
                _compare(points[j, 0], points[j, 1], points[j, 2], block)


@kernel
def _cells_within(grid: CellGrid, axis: int, block: np.ndarray, reach: int) -> tuple[int, int]:
    """First and last cell along an axis within ``reach`` cells of the points of the block."""
    low = high = block[(KEPT + axis) * LANES]
    for i in range(1, LANES):
        along = block[(KEPT + axis) * LANES + i]
        low, high = min(low, along), max(high, along)
    first, last = int((low - grid.low[axis]) / grid.size_m), int((high - grid.low[axis]) / grid.size_m)
    return max(first - reach, 0), min(last + reach, grid.shape[axis] - 1)


@kernel
def _compare(x: np.float32, y: np.float32, z: np.float32, block: np.ndarray) -> None:
    """Carry a point down the nearest of each point of the block; without branches."""
    for i in range(LANES):
        dx, dy, dz = block[KEPT * LANES + i] - x, block[(KEPT + 1) * LANES + i] - y, block[(KEPT + 2) * LANES + i] - z
        rest = dx * dx + dy * dy + dz * dz
        for k in range(KEPT):
            kept = block[k * LANES + i]
            block[k * LANES + i], rest = min(kept, rest), max(kept, rest)
