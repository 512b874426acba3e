"""Where fixed things stand, seen from above: a further cue for what is left when the known returns are gone.

Hedges and trees never return quite the same ranges, so a few of their returns are always fresh and form clusters that
come and go. A cluster that lies within fixed structure is called background: it founds no track, but it keeps alive
the track of something that came there from outside and stopped.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.clustering import Clustering, ClusterPoints
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.ground import Levelled
from services.infra_lidar.kernels_cells import grid_cells, lie_within

MIN_SHARE = 0.6


class StructureMap:
    """Two bird's-eye maps, (2, side, side) bool, on the grid of the clusters: below and above a body's height."""

    def __init__(self, config: ClusteringConfig, range_max_m: float) -> None:
        self._config = config
        self._side = Clustering(config, range_max_m).side
        self._body_m = np.float32(config.body_height_m or np.inf)

    def drawn_by_this(self, drawn: np.ndarray) -> bool:
        """Whether a map is on this grid; an empty one is on any."""
        return not drawn.size or drawn.shape == (2, self._side, self._side)

    def draw(self, frame: Levelled, road_user: np.ndarray) -> np.ndarray:
        """The map of what stands in a whole frame, road_user (N,) bool left out, widened by a cell."""
        fixed = ~road_user[frame.rest]
        at = frame.rest[fixed]
        row, column = self._cells(frame.x[at], frame.y[at])
        layer = (frame.above_m[fixed] >= self._body_m).astype(np.int64)
        drawn = np.zeros((2, self._side, self._side), bool)
        drawn[layer, row, column] = True
        wide = drawn.copy()
        for axis in (1, 2):
            for step in (-1, 1):
                wide |= np.roll(drawn, step, axis)
        return wide

    def inside(self, drawn: np.ndarray, found: ClusterPoints, ground_z_m: np.ndarray) -> np.ndarray:
        """(K,) bool: clusters that lie within the structure."""
        x, y, z = found.planar
        row, column = self._cells(x, y)
        within = np.empty(len(found), bool)
        lie_within(drawn, row, column, z, found.offsets, ground_z_m, self._body_m, MIN_SHARE, within)
        return within

    def _cells(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        row, column = np.empty(len(x), np.int32), np.empty(len(x), np.int32)
        cell, growth = np.float32(self._config.cell_m), np.float32(self._config.cell_growth_m)
        grid_cells(x, y, cell, growth, self._side, row, column)
        return row, column
