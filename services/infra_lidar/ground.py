"""Ground: a polar grid of low-percentile heights, checked against its surroundings, as a surface that may slope.

The article's grid gives one height per 5 m x 5 degree cell and believes it if it lies within min(0.5 + 0.08 r, 2) m of
the calibration plane (``method = "flat"``). ``"surface"`` walks outward from the pole instead: a cell is road if its
height continues that of its inner neighbours with at most ``max_step`` slope, and every cell gets a tangent plane from
its accepted neighbours, so that a slope inside a cell, a car park above the road or a bus roof do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from services.infra_lidar import kernels_ground as kernels
from services.infra_lidar import kernels_surface as surfaces
from services.infra_lidar.buffers import LINE_FLOATS, Buffers
from services.infra_lidar.config import GroundConfig

END_BIN_M = 0.1


@dataclass(frozen=True)
class Levelled:
    """One frame in the level frame: planar float32 views into buffers, valid until the next frame.

    ground: (N,) bool. cell: (N,) int16 polar cell, -1 = clipped. rest: (M,) int32 indices of the points that are inside
    the limits and not ground. points: (4, M or more) float32, their x, y, z and height above the local road.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    cell: np.ndarray
    ground: np.ndarray
    rest: np.ndarray
    points: np.ndarray
    returns: int = 0
    near: int = 0  # returns closer than ``near_m``

    @property
    def above_m(self) -> np.ndarray:
        """(M,) float32 height above the local road."""
        return self.points[3, : len(self.rest)]


class Ground:
    """Labels the ground of one sensor's frames. Holds buffers: one instance per sensor, one thread at a time."""

    def __init__(self, config: GroundConfig, buffers: Buffers | None = None, near_m: float = 2.5) -> None:
        self._config = config
        self._near_m = np.float32(near_m)
        self.buffers = buffers or Buffers()
        self.rings = int(np.ceil(config.range_max_m / config.ring_m)) + 1
        self.sectors = round(360.0 / config.sector_deg)
        cells = self.rings * self.sectors
        lowest = max(config.height_min_m, -config.limit_max_m - END_BIN_M)  # farther off nothing passes for road
        highest = min(config.height_max_m, config.limit_max_m + END_BIN_M)
        self._first_place = np.float32(kernels.bin_place(lowest))
        bins = int(np.ceil(kernels.bin_place(highest) - self._first_place)) + 1
        bins += -bins % kernels.CHUNK
        self._histogram = np.zeros((cells + 1, bins), np.uint16)
        self._count = np.zeros(cells, np.int32)
        self.height_m = np.full(cells, np.nan, np.float32)
        self.surface = np.zeros((cells, 3), np.float32)
        self.accepted = np.zeros(cells, bool)

    def remove(self, points: np.ndarray, T_level_sensor: np.ndarray) -> Levelled:
        """Level (N, 3+) float32 sensor-frame points, find the road in them, and label it."""
        config, frame = self._config, self._level(points, T_level_sensor)
        kernels.cell_heights(
            self._histogram[:-1], self._first_place, config.percentile, config.min_points, self._count, self.height_m
        )
        self._fit_surface()
        return self._label(frame)

    def remove_known(self, sensor: np.ndarray, n: int, T_level_sensor: np.ndarray, surface: np.ndarray) -> Levelled:
        """The same with a road that is known already: for the few points that are left of a frame, n of them, planar
        (3, n or more) float32."""
        self.surface[:] = surface
        frame = self._room(n)
        kernels.level_planar(sensor, n, *self._leveller(T_level_sensor), frame.x, frame.y, frame.z, frame.cell)
        return self._label(frame)

    def look(self, points: np.ndarray, T_level_sensor: np.ndarray) -> Levelled:
        """Level a sample of a frame, and note in which directions there is something; what is road is not asked."""
        frame = self._level(points, T_level_sensor)
        self._count[:] = self._histogram[:-1].sum(axis=1)
        return frame

    @property
    def nbytes(self) -> int:
        """Bytes of the polar grid."""
        return sum(a.nbytes for a in (self._histogram, self._count, self.height_m, self.surface, self.accepted))

    @property
    def sectors_seen(self) -> int:
        """Number of sectors with a return in the last frame."""
        return int(self._count.reshape(self.rings, self.sectors).any(axis=0).sum())

    def road_height(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """(K,) float32 height of the road below positions in the level frame, from the last frame's surface."""
        height = np.empty(len(x_m), np.float32)
        surfaces.road_height(x_m, y_m, self.surface, self._config.ring_m, self.rings, self.sectors, height)
        return height

    def _level(self, points: np.ndarray, T_level_sensor: np.ndarray) -> Levelled:
        frame, points = self._room(len(points)), np.ascontiguousarray(points, np.float32)
        T, limits, ring_m, sectors = self._leveller(T_level_sensor)
        returns, near = kernels.level(
            points, T, self._near_m, limits, ring_m, sectors, self._first_place, self._histogram, frame.x, frame.y,
            frame.z, frame.cell,
        )  # fmt: skip
        return replace(frame, returns=returns, near=near)

    def _room(self, n: int) -> Levelled:
        """Buffers for n points."""
        take = self.buffers.take
        room = n + -n % LINE_FLOATS  # so that every row begins at a cache line
        return Levelled(
            x=take("x", n, np.float32), y=take("y", n, np.float32), z=take("z", n, np.float32),
            cell=take("cell", n, np.int16), ground=take("ground", n, np.bool_),
            rest=take("rest", n, np.int32), points=take("rest_points", 4 * room, np.float32).reshape(4, room),
        )  # fmt: skip

    def _leveller(self, T_level_sensor: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.float32, int]:
        """Transform, limits and cells of the levelling kernels."""
        config = self._config
        limits = np.array([config.range_max_m, config.height_min_m, config.height_max_m], np.float32)
        return T_level_sensor.astype(np.float32), limits, np.float32(config.ring_m), self.sectors

    def _label(self, frame: Levelled) -> Levelled:
        config = self._config
        m = kernels.label_ground(
            frame.x, frame.y, frame.z, frame.cell, self.surface, np.float32(config.below_m),
            np.float32(config.above_m), config.keep_below, frame.ground, frame.points, frame.rest,
        )  # fmt: skip
        return replace(frame, rest=frame.rest[:m])

    def _fit_surface(self) -> None:
        config = self._config
        grid = (self.rings, self.sectors)
        fit = surfaces.flat_surface if config.method == "flat" else surfaces.sloped_surface
        fit(
            self.height_m.reshape(grid), np.float32(config.ring_m), np.float32(config.limit_base_m),
            np.float32(config.limit_slope), np.float32(config.limit_max_m), np.float32(config.max_step),
            np.float32(config.step_up_m), np.float32(config.step_down_m),
            self.surface.reshape(*grid, 3), self.accepted.reshape(grid),
        )  # fmt: skip
