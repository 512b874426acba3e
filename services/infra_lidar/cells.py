"""Bird's-eye cells that grow with range: how large they are, and where."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.config import ClusteringConfig

STEPS = 1024  # of the table of scales


class CellGrid:
    """side x side cells, centred on the origin.

    Radii are compressed by f(r) = g / c * ln(1 + r / g), so that a cell measures c near the sensor and c (1 + r / g)
    along the ray at range r; g = 0: plain squares of c.

    scales: (STEPS + 1,) float32, f(r) / r at steps of range, ``per_m`` of them a metre, to be interpolated: a logarithm
    per point takes longer than all the rest. What comes out is a little other than f says (a hundredth of a cell).
    """

    def __init__(self, config: ClusteringConfig, range_max_m: float) -> None:
        c, g = config.cell_m, config.cell_growth_m
        reach = range_max_m / c if g == 0 else g / c * np.log1p(range_max_m / g)
        self.side = 2 * int(np.ceil(reach)) + 2
        self.scales, self.per_m = np.full(STEPS + 1, 1.0 / c, np.float32), np.float32(0.0)
        if g > 0:
            step_m = g * np.expm1(self.side // 2 * c / g) / (STEPS - 1)
            r = step_m * np.arange(1, STEPS + 1)
            self.scales[1:] = g / c * np.log1p(r / g) / r
            self.per_m = np.float32(1.0 / step_m)

    def cells(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row and column (N,) of places (N,), those outside in the outermost cells; plainly, for few calls."""
        at = np.minimum(np.hypot(x_m, y_m) * self.per_m, STEPS - 1)
        scale = np.interp(at, np.arange(STEPS + 1), self.scales)
        row, column = (np.floor(v * scale).astype(np.int64) + self.side // 2 for v in (y_m, x_m))
        return np.clip(row, 0, self.side - 1), np.clip(column, 0, self.side - 1)
