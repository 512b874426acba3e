"""Bird's-eye cells that grow with range: how large they are, and where."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.config import ClusteringConfig


class CellGrid:
    """side x side cells, centred on the origin.

    Radii are compressed by f(r) = g / c * ln(1 + r / g), so that a cell measures c near the sensor and c (1 + r / g)
    along the ray at range r; g = 0: plain squares of c.

    per_m: float32, 1 / c. growth_per_m: float32, 1 / g, or 0. ``kernels_cells`` takes the logarithm as the first terms
    of a series, so that far off a cell is a little other than f says (two thousandths at r = 20 g).
    """

    def __init__(self, config: ClusteringConfig, range_max_m: float) -> None:
        c, g = config.cell_m, config.cell_growth_m
        reach = range_max_m / c if g == 0 else g / c * np.log1p(range_max_m / g)
        self.side = 2 * int(np.ceil(reach)) + 2
        self.per_m, self.growth_per_m = np.float32(1.0 / c), np.float32(1.0 / g if g > 0 else 0.0)

    def cells(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row and column (N,) of places (N,), those outside in the outermost cells; plainly, for few calls."""
        u = np.hypot(x_m, y_m) * self.growth_per_m
        scale = self.per_m * np.divide(np.log1p(u), u, out=np.ones_like(u), where=u > 0)
        row, column = (np.floor(v * scale).astype(np.int64) + self.side // 2 for v in (y_m, x_m))
        return np.clip(row, 0, self.side - 1), np.clip(column, 0, self.side - 1)
