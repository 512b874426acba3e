"""Bird's-eye cells that grow with range: how large they are, and which one a point lies in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.jit import kernel

ONE, FOUR = np.float32(1.0), np.float32(4.0)
SERIES = np.array([1.0 / odd for odd in (13, 11, 9, 7, 5, 3, 1)], np.float32)  # of artanh(w) / w in powers of w^2


class CellScale(NamedTuple):
    """What kernels need of a ``CellGrid``: side, per_m = 1 / c in 1/m, growth_per_m = 1 / g in 1/m or 0."""

    side: int
    per_m: np.float32
    growth_per_m: np.float32


class CellGrid:
    """side x side cells, centred on the origin.

    Radii are compressed by f(r) = g / c * ln(1 + r / g), so that a cell measures c near the sensor and c (1 + r / g)
    along the ray at range r. g = 0: plain squares of c.

    side: number of cells. scale: what kernels need.
    """

    def __init__(self, config: ClusteringConfig, range_max_m: float) -> None:
        c, g = config.cell_m, config.cell_growth_m
        reach = range_max_m / c if g == 0 else g / c * np.log1p(range_max_m / g)
        self.side = 2 * int(np.ceil(reach)) + 2
        self.scale = CellScale(self.side, np.float32(1.0 / c), np.float32(1.0 / g if g > 0 else 0.0))


@kernel
def cells_of(points: np.ndarray, grid: CellScale) -> np.ndarray:
    """(M,) int32 index of the cell, row * side + column, of points (M, 2 or more) float32 with x and y first (m).

    Places outside count to the outermost cells. The logarithm is taken as the first terms of its series, ln(1 + u) =
    4 artanh((t - 1) / (t + 1)) with t the root of 1 + u: exact to a millionth up to r = 5 g.
    """
    n, side, half, last = len(points), np.int32(grid.side), np.int32(grid.side // 2), np.int32(grid.side - 1)
    x, y, cell = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.int32)
    for i in range(n):  # columns first: the compiler vectorises the loop below only over arrays in one piece
        x[i], y[i] = points[i, 0], points[i, 1]
    for i in range(n):
        scale = grid.per_m
        if grid.growth_per_m > 0:
            t = np.sqrt(np.sqrt(x[i] * x[i] + y[i] * y[i]) * grid.growth_per_m + ONE)
            inverse = ONE / (t + ONE)
            w = (t - ONE) * inverse
            q = w * w
            series = SERIES[0]
            for term in SERIES[1:]:
                series = series * q + term
            scale = scale * FOUR * inverse * inverse * series
        row, column = np.int32(np.floor(y[i] * scale)) + half, np.int32(np.floor(x[i] * scale)) + half
        cell[i] = min(max(row, np.int32(0)), last) * side + min(max(column, np.int32(0)), last)
    return cell
