"""Ground: a polar grid of low-percentile heights, checked against its surroundings, as a surface that may slope.

The article's grid gives one height per 5 m x 5 degree cell and believes it if it lies within min(0.5 + 0.08 r, 2) m of
the calibration plane (``method = "flat"``). ``"surface"`` walks outward from the pole instead: a cell is road if its
height continues that of its inner neighbours with at most ``max_step`` slope, and every cell gets a tangent plane from
its accepted neighbours, so that a slope inside a cell, a car park above the road or a bus roof do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.infra_lidar import kernels_ground as kernels
from services.infra_lidar import kernels_surface as surfaces
from services.infra_lidar.buffers import LINE_FLOATS, Buffers
from services.infra_lidar.config import GroundConfig
from services.infra_lidar.kernels_heights import CHUNK, bin_place

END_BIN_M = 0.1


@dataclass(slots=True)
class Obstacles:
    """What of a frame is no ground: ``rest`` and ``points`` are views into buffers, valid until the next frame.

    ground: (N,) bool, which of the points that were looked at are ground. rest: (M,) int32 indices, in the whole frame,
    of the points that are inside the limits and not ground. points: (4, M or more) float32, their x, y, z (m, level
    frame) and height above the local road.
    """

    ground: np.ndarray
    rest: np.ndarray
    points: np.ndarray

    @property
    def above_m(self) -> np.ndarray:
        """(M,) float32 height above the local road."""
        return self.points[3, : len(self.rest)]


@dataclass(slots=True)
class Levelled(Obstacles):
    """The same of a whole frame, and all its points in the level frame.

    x, y, z: (N,) float32. cell: (N,) int16 polar cell, -1 = clipped. returns: how many there are, near: those of them
    closer than ``near_m``.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    cell: np.ndarray
    returns: int = 0
    near: int = 0


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
        self._settings = _settings(config, self.sectors, bin_place(lowest))
        bins = int(np.ceil(bin_place(highest) - bin_place(lowest))) + 1
        bins += -bins % CHUNK
        self._histogram = np.zeros((cells, bins), np.uint16)
        self._fours = self._histogram.view(np.uint64)  # four bins at a time
        self._count = np.zeros(cells, np.int32)
        self.height_m = np.full(cells, np.nan, np.float32)
        self.surface = np.zeros((cells, 3), np.float32)
        self.accepted = np.zeros((self.rings, self.sectors), bool)
        self._known: np.ndarray | None = None  # the surface that the map of the road was made of
        self._road = np.empty((0, 0), np.float32)

    def remove(self, points: np.ndarray, T_level_sensor: np.ndarray) -> Levelled:
        """Level (N, 3+) float32 sensor-frame points, find the road in them, and label it."""
        points, frame, self._known = np.ascontiguousarray(points, np.float32), self._room(len(points)), None
        m, frame.returns, frame.near = kernels.find_ground(
            points, T_level_sensor, self._settings, self._near_m, self._histogram, self._fours,
            self._count, self.height_m, self.surface.reshape(self.rings, self.sectors, 3), self.accepted, frame.x,
            frame.y, frame.z, frame.cell, frame.ground, frame.points, frame.rest,
        )  # fmt: skip
        frame.rest = frame.rest[:m]
        return frame

    def remove_known(
        self, sensor: np.ndarray, source: np.ndarray, T_level_sensor: np.ndarray, surface: np.ndarray
    ) -> Obstacles:
        """The same with a road that is known already, a ``surface`` as ``remove`` leaves it, which is not changed any
        more: for the few points that are left of a frame, planar (3, n or more) float32, with their index ``source``
        (n,) in it."""
        if self._known is not surface:
            self._known, self.surface[:] = surface, surface
            self._road = self._road_map()
        found = Obstacles(*self._room_for_rest(len(source)))
        m = kernels.find_known(
            sensor, source, T_level_sensor, self._settings, self._road, found.ground, found.points,
            found.rest,
        )  # fmt: skip
        found.rest = found.rest[:m]
        return found

    def _road_map(self) -> np.ndarray:
        """(side, side) float32: heights of the surface as ``find_known`` takes them; that in the middle of a square
        stands for all of it."""
        reach_m, cell_m = self._config.range_max_m, float(kernels.ROAD_CELL_M)
        half = int(np.ceil(reach_m / cell_m)) + 1
        middle = ((np.arange(-half, half) + 0.5) * cell_m).astype(np.float32)
        x, y = (axis.ravel() for axis in np.meshgrid(middle, middle))
        height = np.where(np.hypot(x, y) <= reach_m, self.road_height(x, y), np.float32(np.nan))
        return height.reshape(2 * half, 2 * half)

    def look(self, points: np.ndarray, T_level_sensor: np.ndarray) -> Levelled:
        """Level a sample of a frame, and note in which directions there is something; what is road is not asked."""
        points, frame = np.ascontiguousarray(points, np.float32), self._room(len(points))
        kernels.look(
            points, T_level_sensor, self._settings, frame.x, frame.y, frame.z, frame.cell,
            self._count,
        )  # fmt: skip
        return frame

    @property
    def nbytes(self) -> int:
        """Bytes of the polar grid, and of the map of a road that is known."""
        arrays = self._histogram, self._count, self.height_m, self.surface, self.accepted, self._road
        return sum(array.nbytes for array in arrays)

    @property
    def sectors_seen(self) -> int:
        """Number of sectors with a return in the last frame."""
        return int(self._count.reshape(self.rings, self.sectors).any(axis=0).sum())

    def road_height(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """(K,) float32 height of the road below positions in the level frame, from the last frame's surface."""
        return self.road_below(np.column_stack((x_m, y_m)).astype(np.float32))

    def road_below(self, places: np.ndarray) -> np.ndarray:
        """The same of places (K, 2 or more) float32: x, y, and anything."""
        height = np.empty(len(places), np.float32)
        surfaces.road_below(places, self.surface, self._config.ring_m, self.rings, self.sectors, height)
        return height

    def _room(self, n: int) -> Levelled:
        """Buffers for n points."""
        take = self.buffers.take
        x, y, z = (take(name, n, np.float32) for name in "xyz")
        return Levelled(*self._room_for_rest(n), x=x, y=y, z=z, cell=take("cell", n, np.int16))

    def _room_for_rest(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Room for what of n points is no ground: ground, which is kept, rest and points of ``Obstacles``."""
        take, ground = self.buffers.take, np.empty(n + LINE_FLOATS, np.bool_)[:n]
        room = n + -n % LINE_FLOATS + LINE_FLOATS  # every row begins at a cache line, and has room for a vector more
        points = take("rest_points", 4 * room, np.float32).reshape(4, room)
        return ground, take("rest", n, np.int32), points


def _settings(config: GroundConfig, sectors: int, first_place: float) -> np.ndarray:
    """(1,) ``SETTINGS``: the settings as kernels take them."""
    made = np.zeros(1, kernels.SETTINGS)
    for name in kernels.SETTINGS.names or ():
        if hasattr(config, name):
            made[name] = getattr(config, name)
    made["sectors"], made["first_place"], made["flat"] = sectors, first_place, config.method == "flat"
    return made
