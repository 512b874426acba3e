"""Ground: a polar grid of low-percentile heights, checked against its surroundings, as a surface that may slope.

Walk outward from the pole: a cell is road if its height is at most ``step_up_m`` above or ``step_down_m`` below what
its inner neighbours let expect, or more (``max_step``) behind cells whose road was not seen. Every cell gets a tangent
plane from its accepted neighbours, so that slopes inside a cell, car parks above the road and bus roofs do not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from services.infra_lidar.config import GroundConfig
from services.infra_lidar.segmentation import ground_kernels as kernels
from services.infra_lidar.segmentation.drops import find_drops
from services.infra_lidar.segmentation.ground_kernels import GroundSettings, Levelled, RoadMap
from services.infra_lidar.segmentation.ground_surface import sloped_surface

__all__ = ["FitSurface", "Ground", "Levelled", "Obstacles"]

END_BIN_M = 0.1  # heights this far beyond ``limit_max_m`` are counted apart from those beyond
ROAD_CELL_M = 0.5

FitSurface = Callable[[np.ndarray, GroundSettings], np.ndarray]


@dataclass(frozen=True)
class Obstacles:
    """The M points of a frame of N that are inside the limits and not ground.

    points: (M, 4) float32, C-contiguous, x, y, z (m, level frame) and height above the local road (m). index: (M,)
    int32, their index in the frame. is_ground: (N,) bool, or one value for each of the points that were looked at.
    """

    points: np.ndarray
    index: np.ndarray
    is_ground: np.ndarray

    def __len__(self) -> int:
        return len(self.index)


class Ground:
    """Labels the ground of one sensor's frames. One instance per sensor, one thread at a time.

    surface: (rings, sectors, 3) float32, the road of the last frame: z = s0 + s1 x + s2 y in a cell, level frame.
    fit_surface: makes it from the heights of the cells, as ``sloped_surface`` does.
    """

    def __init__(self, config: GroundConfig, near_m: float = 2.5, fit_surface: FitSurface = sloped_surface) -> None:
        self._settings = _settings(config, near_m)
        self._fit_surface = fit_surface
        s = self._settings
        self._histogram = np.zeros((s.rings * s.sectors, s.bins), np.int32)
        self.surface = np.zeros((s.rings, s.sectors, 3), np.float32)
        self._map_of: np.ndarray | None = None  # the surface that ``_map`` was made from
        self._map = RoadMap(np.empty((0, 0), np.float32), ROAD_CELL_M)

    def level_only(self, points: np.ndarray, T_level_sensor: np.ndarray) -> Levelled:
        """(N, 3+) sensor-frame points in the level frame, with their polar cells."""
        points = np.ascontiguousarray(points, np.float32)
        T = np.ascontiguousarray(T_level_sensor, np.float32)
        x, y, z, returns, near = kernels.level(points, T, self._settings.near_m)
        return Levelled(x, y, z, kernels.polar_cells(x, y, z, self._settings), returns, near)

    def remove_levelled(self, levelled: Levelled) -> Obstacles:
        """Fit the road to the points of a frame and take it away."""
        heights = kernels.cell_heights(levelled, self._settings, self._histogram)
        self.surface = self._fit_surface(heights, self._settings)
        return Obstacles(*kernels.label_ground(levelled, self.surface, self._settings))

    def remove(self, points: np.ndarray, T_level_sensor: np.ndarray) -> Obstacles:
        """Level (N, 3+) sensor-frame points (m), fit the road to them and take it away."""
        return self.remove_levelled(self.level_only(points, T_level_sensor))

    def remove_ground_with_map(
        self, points: np.ndarray, index: np.ndarray, T_level_sensor: np.ndarray, surface: np.ndarray
    ) -> Obstacles:
        """Take away a road that is known, for the few points that are left of a frame.

        points: (n, 3) float32 m, sensor frame. index: (n,) int32 index in the frame. surface: one that was ``surface``
        of a ``Ground`` with these settings. ``is_ground`` of the result is (n,).
        """
        self.surface = surface
        if self._map_of is not surface:
            self._map_of, self._map = surface, self._road_map()
        T = np.ascontiguousarray(T_level_sensor, np.float32)
        return Obstacles(*kernels.label_with_map(points, index, T, self._map, self._settings))

    def road_height(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """(K,) float32 height of the road (m) below positions in the level frame, from ``surface``."""
        plane = self.surface[self.cells_at(x_m, y_m)]
        return np.asarray(plane[:, 0] + plane[:, 1] * x_m + plane[:, 2] * y_m, np.float32)

    def cells_at(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ring and sector (K,) of positions in the level frame; what is beyond the range is in the last ring."""
        s = self._settings
        ring = np.minimum((np.hypot(x_m, y_m) / s.ring_m).astype(int), s.rings - 1)
        turn = (np.arctan2(y_m, x_m) + np.pi) / (2.0 * np.pi)
        return ring, np.minimum((turn * s.sectors).astype(int), s.sectors - 1)

    def find_drops(self, levelled: Levelled) -> np.ndarray:
        """(rings, sectors) bool: cells where the ground lies well below ``surface``, see ``drops.py``."""
        return find_drops(levelled, self.surface, self._settings)

    def sectors_seen(self, cell: np.ndarray) -> int:
        """Number of sectors with a point inside the limits; cell: (N,) int32 as in ``Levelled``."""
        occupied = np.zeros(self._settings.sectors, bool)
        occupied[cell[cell != kernels.CLIPPED] % self._settings.sectors] = True
        return int(occupied.sum())

    @property
    def nbytes(self) -> int:
        """Bytes of the polar grid and of the road map."""
        return self._histogram.nbytes + self.surface.nbytes + self._map.height_m.nbytes

    def _road_map(self) -> RoadMap:
        """Heights of ``surface`` at the middle of squares."""
        reach_m = self._settings.range_max_m
        half = int(np.ceil(reach_m / ROAD_CELL_M)) + 1
        middle = ((np.arange(-half, half) + 0.5) * ROAD_CELL_M).astype(np.float32)
        x, y = (axis.ravel() for axis in np.meshgrid(middle, middle))
        height = np.where(np.hypot(x, y) <= reach_m, self.road_height(x, y), np.float32(np.nan))
        return RoadMap(height.reshape(2 * half, 2 * half), ROAD_CELL_M)


def _settings(config: GroundConfig, near_m: float) -> GroundSettings:
    # Heights farther from the plane than this are never road: one bin at each end takes them all.
    lowest = max(config.height_min_m, -config.limit_max_m - END_BIN_M)
    highest = min(config.height_max_m, config.limit_max_m + END_BIN_M)
    first_bin = kernels.bin_of(lowest)
    return GroundSettings(
        range_max_m=config.range_max_m, height_min_m=config.height_min_m, height_max_m=config.height_max_m,
        near_m=near_m, ring_m=config.ring_m, rings=int(np.ceil(config.range_max_m / config.ring_m)) + 1,
        sectors=round(360.0 / config.sector_deg), bins=int(np.ceil(kernels.bin_of(highest) - first_bin)) + 1,
        first_bin=first_bin, percentile=config.percentile, min_points=config.min_points,
        limit_base_m=config.limit_base_m, limit_slope=config.limit_slope, limit_max_m=config.limit_max_m,
        max_step=config.max_step, step_up_m=config.step_up_m, step_down_m=config.step_down_m,
        below_m=config.below_m, above_m=config.above_m,
        hole_m=-config.below_m if config.keep_below else -np.inf,
    )  # fmt: skip
