"""Clusters: connected components of occupied bird's-eye-view cells, sized by range, then split and merged.

Cells grow with range because the spacing of returns does: near the sensor 15 cm keep two pedestrians apart, far away
the same cell would break a car. Cells are filled by points up to the height of a body; what is above joins tall things
(buses) only, so that a tree's canopy does not tie the cars below it together. Groups of people are split by their heads
and pieces of vehicles merged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.infra_lidar import kernels_clusters as clusters
from services.infra_lidar import kernels_steps as kernels
from services.infra_lidar.buffers import LINE_FLOATS, Buffers
from services.infra_lidar.cells import CellGrid
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.ground import Obstacles
from services.infra_lidar.kernels_people import WIDEST_M


@dataclass(frozen=True)
class ClusterPoints:
    """Clusters of one frame in the level frame.

    planar: (3, S) float32 x, y, z, grouped; cluster k has planar[:, offsets[k]:offsets[k + 1]], and behind the last row
    there is room for a vector. Of a large cluster these are so many of its points as tell its shape, evenly drawn; all
    of them, by their index in the frame, are members[member_offsets[k]:member_offsets[k + 1]], (M,) int32, and counts
    (K,) says how many. box: (K, 8) float32: centre x, y, z, length, width, height, yaw, gap to the road.
    """

    planar: np.ndarray
    offsets: np.ndarray
    members: np.ndarray
    member_offsets: np.ndarray
    counts: np.ndarray
    box: np.ndarray

    def __len__(self) -> int:
        return len(self.box)

    @property
    def points(self) -> np.ndarray:
        """(S, 3) float32, the points that tell the shapes, row by row."""
        return self.planar.T

    def cluster_id(self, n: int) -> np.ndarray:
        """(N,) int32: the cluster of each point of a frame of n, -1 = none."""
        return of_points(self.members, self.member_offsets, n)

    @property
    def means(self) -> np.ndarray:
        """(K, 3) float64, the mean of those of each cluster."""
        means = np.empty((len(self), 3))
        clusters.means(self.planar, self.offsets, means)
        return means


def of_points(members: np.ndarray, offsets: np.ndarray, n: int) -> np.ndarray:
    """(N,) int32: the cluster of each point of a frame of n, -1 = none; members and offsets of ``ClusterPoints``."""
    of_point = np.full(n, -1, np.int32)
    of_point[members] = np.repeat(np.arange(len(offsets) - 1, dtype=np.int32), np.diff(offsets))
    return of_point


class Clustering:
    """Clusters one sensor's frames. Holds buffers: one instance per sensor, one thread at a time."""

    def __init__(self, config: ClusteringConfig, range_max_m: float, buffers: Buffers | None = None) -> None:
        self._config = config
        self._buffers = buffers or Buffers()
        cells = CellGrid(config, range_max_m)
        side, words = cells.side, (cells.side + 63) // 64
        self._grid = np.zeros((side, words, 4), np.uint64)
        self._touched = np.zeros((side, (words + 63) // 64), np.uint64)
        self._row_start = np.zeros(side + 1, np.int32)
        self._look = _second_look(config)
        self._settings = _settings(config, cells, all_points=self._look is not None)

    @property
    def nbytes(self) -> int:
        """Bytes of the cell grids."""
        return self._grid.nbytes + self._touched.nbytes + self._row_start.nbytes

    def cluster(self, frame: Obstacles) -> ClusterPoints:
        """Group the points of a frame that are not ground."""
        m, take = len(frame.rest), self._buffers.take
        room = m + -m % LINE_FLOATS + LINE_FLOATS
        found = kernels.find_clusters(
            np.ascontiguousarray(frame.points), m, frame.rest, self._settings, self._look,
            take("cluster_ints", kernels.INTS * room, np.int32).reshape(kernels.INTS, room),
            take("cluster_floats", kernels.FLOATS * room, np.float32).reshape(kernels.FLOATS, room),
            self._grid, self._touched, self._row_start,
        )  # fmt: skip
        return ClusterPoints(*found)


def _settings(config: ClusteringConfig, cells: CellGrid, all_points: bool) -> np.ndarray:
    """(1,) ``SETTINGS``: the settings as kernels take them."""
    made = np.zeros(1, kernels.SETTINGS)
    for name in kernels.SETTINGS.names or ():
        if hasattr(config, name):
            made[name] = getattr(config, name)
    made["per_m"], made["growth_per_m"] = cells.per_m, cells.growth_per_m
    made["body_m"] = config.body_height_m or np.inf
    made["fewest"] = 1 if config.merge == "fragments" else config.min_points  # smaller components are not looked at
    made["enough"] = np.iinfo(np.int64).max if all_points else config.shape_points or np.iinfo(np.int64).max
    made["widest"] = config.max_diagonal_m / config.cell_m  # cells only grow with range
    made["heads"] = config.split == "heads"
    made["narrow"] = WIDEST_M / config.cell_m if config.split == "heads" else 0  # groups of people are looked at whole
    made["two_points"], made["fragments"] = config.min_cell_points > 1, config.merge == "fragments"
    return made


def _second_look(config: ClusteringConfig) -> np.record | None:
    """What the article does to clusters that it has found; None, and not compiled, where nothing of it is wanted."""
    made = np.zeros(1, kernels.LOOK)
    made[0] = config.trim_ground, config.split == "gap", config.merge == "engulfed"
    return made[0] if any(made[0]) else None
