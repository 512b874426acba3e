"""Where fixed things stand, seen from above: two layers of cells, below and above the height of a body.

Leaves and rails return from other places in every frame, so no range of them is always the same. But the cells they
stand in are, and the classifier takes them for background at least now and then, which it does not of a parked car.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.clustering.boxes import ClusterPoints
from services.infra_lidar.clustering.grid import CellGrid, CellScale, cells_of
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.jit import kernel
from services.infra_lidar.segmentation.ground import Obstacles

STANDING_SHARE = 0.5  # of the frames: what stands in a cell less often is not fixed
MAX_ROAD_USER = 0.5  # mean confidence that a cell is a road user's, from which on it is left out


class MapCells:
    """The cells of a static map, (2, side, side) bool, on the grid of the clusters."""

    def __init__(self, config: ClusteringConfig, range_max_m: float) -> None:
        self._grid = CellGrid(config, range_max_m)
        self._body_m = np.float32(config.body_height_m or np.inf)
        self.shape = 2, self._grid.side, self._grid.side

    def fits(self, static_map: np.ndarray) -> bool:
        """Whether a map is on this grid; an empty one is on any."""
        return not static_map.size or (static_map.shape == self.shape and static_map.dtype == bool)

    def cells(self, points: np.ndarray) -> np.ndarray:
        """(M,) int32 index into the flat map, of points (M, 4) float32 x, y, z (m) and height above the road (m)."""
        return cells_in_layers(points, self._grid.scale, self._body_m)

    def share_within(self, static_map: np.ndarray, clusters: ClusterPoints) -> np.ndarray:
        """(K,) share of the points of each cluster within fixed things."""
        return share_set(static_map.ravel(), self.cells(clusters.points), clusters.offsets)


@kernel
def cells_in_layers(points: np.ndarray, grid: CellScale, body_m: np.float32) -> np.ndarray:
    """``MapCells.cells`` where bodies are ``body_m`` high."""
    cell, layer = cells_of(points, grid), np.int32(grid.side * grid.side)
    for i in range(len(cell)):
        cell[i] += layer * np.int32(points[i, 3] >= body_m)
    return cell


@kernel
def share_set(flat_map: np.ndarray, cell: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(K,) share of the cells offsets[k]:offsets[k + 1] in which flat_map (cells,) bool is set."""
    share = np.empty(len(offsets) - 1)
    for k in range(len(share)):
        within = 0
        for i in range(offsets[k], offsets[k + 1]):
            within += flat_map[cell[i]]
        share[k] = within / (offsets[k + 1] - offsets[k])
    return share


class Occupancy:
    """What stood in the cells of a static map while the background was learned."""

    def __init__(self, cells: MapCells) -> None:
        self._cells, self._frames = cells, 0
        size = int(np.prod(cells.shape))
        self._occupied, self._road_user = np.zeros(size, np.uint32), np.zeros(size, np.float32)

    def add(self, obstacles: Obstacles, road_user: np.ndarray) -> None:
        """Count a whole frame of N points; road_user: (N,) float32 confidence that a point is of a road user."""
        cells, cell_of_point = np.unique(self._cells.cells(obstacles.points), return_inverse=True)
        confidence = np.zeros(len(cells), np.float32)
        np.maximum.at(confidence, cell_of_point, road_user[obstacles.index])
        self._occupied[cells] += 1
        self._road_user[cells] += confidence
        self._frames += 1

    def static_map(self) -> np.ndarray:
        """(2, side, side) bool: what was there in most frames and hardly a road user, widened by a cell."""
        stood = self._occupied >= max(STANDING_SHARE * self._frames, 1.0)
        fixed = (stood & (self._road_user < MAX_ROAD_USER * self._occupied)).reshape(self._cells.shape)
        wide = fixed.copy()
        for axis in (1, 2):
            for step in (-1, 1):
                wide |= np.roll(fixed, step, axis)
        return wide
