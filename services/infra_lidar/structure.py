"""Where fixed things stand, seen from above: a further cue for what is left when the known returns are gone.

Hedges and trees never return quite the same ranges, so a few of their returns are always fresh and form clusters that
come and go. A cluster that lies within fixed structure is called background: it founds no track, but it keeps alive
the track of something that came there from outside and stopped.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.cells import CellGrid
from services.infra_lidar.clustering import ClusterPoints
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.ground import Obstacles
from services.infra_lidar.kernels_cells import mark_within

MIN_SHARE, ENOUGH = 0.6, 256


class StructureMap:
    """Two bird's-eye maps, (2, side, words) int32, on the grid of the clusters: below and above a body's height. A bit
    is a cell, the lowest one the first of 32."""

    def __init__(self, config: ClusteringConfig, range_max_m: float) -> None:
        self._grid = CellGrid(config, range_max_m)
        self._body_m = np.float32(config.body_height_m or np.inf)

    def drawn_by_this(self, drawn: np.ndarray) -> bool:
        """Whether a map is on this grid; an empty one is on any."""
        side = self._grid.side
        return not drawn.size or (drawn.shape == (2, side, -(-side // 32)) and drawn.dtype == np.int32)

    def draw(self, frame: Obstacles, road_user: np.ndarray) -> np.ndarray:
        """The map of what stands in a whole frame, road_user (N,) bool left out, widened by a cell."""
        fixed, grid = ~road_user[frame.rest], self._grid
        x, y = frame.points[:2, : len(fixed)][:, fixed]
        row, column = grid.cells(x, y)
        layer = (frame.above_m[fixed] >= self._body_m).astype(np.int64)
        drawn = np.zeros((2, grid.side, grid.side + -grid.side % 32), bool)
        drawn[layer, row, column] = True
        wide = drawn.copy()
        for axis in (1, 2):
            for step in (-1, 1):
                wide |= np.roll(drawn, step, axis)
        return np.packbits(wide, axis=2, bitorder="little").view("<i4").astype(np.int32)

    def mark(
        self, drawn: np.ndarray, found: ClusterPoints, ground_z_m: np.ndarray, as_: int, classes: np.ndarray
    ) -> None:
        """Write ``as_`` into classes (K,) int64 for clusters that lie within the structure."""
        mark_within(
            drawn, found.planar, found.offsets, ground_z_m, self._body_m, self._grid.per_m, self._grid.growth_per_m,
            ENOUGH, MIN_SHARE, as_, classes,
        )  # fmt: skip
