"""The fixed scene of a fixed sensor: which range each beam returns in each direction when nobody is there.

Learned once over ``learn_s`` from whole frames, then frozen: nothing that arrives later ever becomes background, so an
obstacle that stops is never hidden. What the classifier took for a road user now and then (a parked car) is left out,
also when a bus stands before it as learning ends, and so is every direction that was seen through for a while (a queue
at a red light). The model only saves work: returns of the background need no ground, no cluster and no class.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from services.infra_lidar.config import BackgroundConfig
from services.infra_lidar.input.range_image import RangeImage, Returns
from services.infra_lidar.segmentation import background_kernels as kernels
from services.infra_lidar.segmentation.azimuth import azimuth_of
from services.infra_lidar.segmentation.background_kernels import MODES, NO_RETURN, Grid, RangeModes, Tolerance
from services.infra_lidar.segmentation.ground_kernels import MAX_RANGE_M, MIN_RANGE_M

RINGS = kernels.BLOCK  # rows of the grid where beams are known
ELEVATIONS = 2 * kernels.BLOCK  # and where they are not
MISFIT, MATCH = 0.6, 0.8  # of the usual share of background: less is another scene; as much is the same one
LOST_FRAMES = 20


@dataclass(frozen=True)
class BackgroundModel:
    """What is kept on disk.

    intervals: (columns * rows / BLOCK, 4, BLOCK) uint16, near and far end of two intervals of range in each cell of
    azimuth x ring, in steps of STEP_M; those of BLOCK cells lie together.
    is_road: (columns * rows,) bool, the background there is road. background_ratio: share of the returns that were
    background in the last frame of the learning. surface: (rings, sectors, 3) float32, the road at the time, as in
    ``ground.py``. static_map: (2, side, side) bool as in ``static_map.MapCells``. drops: (rings, sectors) bool as in
    ``drops.py``. Both are empty until they are drawn.
    """

    intervals: np.ndarray
    is_road: np.ndarray
    columns: int
    rows: int
    background_ratio: float
    surface: np.ndarray
    static_map: np.ndarray = field(default_factory=lambda: np.zeros((2, 0, 0), bool))
    drops: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))

    @property
    def grid(self) -> Grid:
        """Columns and rows."""
        return Grid(self.columns, self.rows)


@dataclass(frozen=True)
class Foreground:
    """The M returns of a frame that are not background.

    points: (M, 3) float32 m, sensor frame. index: (M,) int32, their index in the frame. returns, near: number of all
    returns of the frame, and of those closer than ``near_m``.
    """

    points: np.ndarray
    index: np.ndarray
    returns: int
    near: int

    @property
    def background_ratio(self) -> float:
        """Share of the returns that are background."""
        return 1.0 - len(self.index) / max(self.returns, 1)


@dataclass(frozen=True, eq=False)
class BackgroundMask:
    """Which of N returns are background: all but the foreground, index (M,). Computed on the first access."""

    returns: Returns
    model: BackgroundModel
    foreground: np.ndarray

    @cached_property
    def mask(self) -> np.ndarray:
        """(N,) bool; False where there is no return."""
        mask = self._cells != NO_RETURN
        mask[self.foreground] = False
        return mask

    @cached_property
    def road(self) -> np.ndarray:
        """(N,) bool: background that is road."""
        return np.asarray(self.mask & self.model.is_road[self._cells])

    @cached_property
    def _cells(self) -> np.ndarray:
        return locate(self.returns, self.model.grid)[0]


class Background:
    """Learns, stores and applies the model of one sensor. One thread at a time.

    stored: a model of an earlier run, used if ``match_stored_model`` finds that it fits.
    """

    def __init__(self, config: BackgroundConfig, stored: BackgroundModel | None = None) -> None:
        self._config = config
        self._tolerance = Tolerance(config.tolerance_m, config.tolerance_slope)
        self.model: BackgroundModel | None = None
        self._stored = stored
        self._modes: RangeModes | None = None
        self._frames, self._first_ns, self._misfits = 0, 0, 0

    def restart(self) -> None:
        """Forget what was learned, and the stored model, and begin again."""
        self.model, self._stored, self._modes = None, None, None
        self._frames, self._first_ns, self._misfits = 0, 0, 0

    def subtract_background(self, returns: Returns, near_m: float) -> Foreground | None:
        """The foreground of a frame; None while there is no model or it does not fit this frame."""
        if self.model is None:
            return None
        foreground = foreground_of(returns, self.model, near_m)
        misfit = foreground.background_ratio < MISFIT * self.model.background_ratio
        self._misfits = self._misfits + 1 if misfit else 0
        return None if misfit else foreground

    @property
    def lost(self) -> bool:
        """True when the scene has not looked as learned for a while: the sensor was moved, or the scene rebuilt."""
        return self._misfits >= LOST_FRAMES

    def match_stored_model(self, returns: Returns) -> None:
        """Use the stored model if it explains this frame nearly as well as those it was learned from; else drop it."""
        stored, self._stored = self._stored, None
        if stored is not None:
            ratio = foreground_of(returns, stored, 0.0).background_ratio
            self.model = stored if ratio >= MATCH * stored.background_ratio else self.model

    def learn(
        self, stamp_ns: int, returns: Returns, ground: np.ndarray, road_user: np.ndarray, surface: np.ndarray
    ) -> None:
        """Add a whole frame of N returns; ground, road_user: (N,) bool. surface: the road, see ``ground.py``.

        Builds the model when it has seen enough.
        """
        config = self._config
        if self._modes is None:
            has_rings = isinstance(returns, RangeImage) or returns.shape[1] > 4
            self._grid = Grid(config.azimuth_cells, RINGS if has_rings else ELEVATIONS)
            self._modes, self._first_ns = _no_modes(self._grid), stamp_ns
        cell, range_m = locate(returns, self._grid)
        kernels.learn(cell, range_m, road_user, self._tolerance, self._modes)
        self._frames += 1
        if self._frames >= config.min_frames and stamp_ns - self._first_ns >= config.learn_s * 1e9:
            self._build_model(returns, np.unique(cell[ground & (cell != NO_RETURN)]), surface)

    def _build_model(self, returns: Returns, road_cells: np.ndarray, surface: np.ndarray) -> None:
        assert self._modes is not None
        intervals_m, users = kernels.build_model(
            self._modes, self._grid, self._frames, self._config.min_share, self._tolerance
        )
        users = _with_neighbours(users, self._grid)
        intervals_m[users] = kernels.EMPTY * 2
        is_road = np.zeros(len(users), bool)
        is_road[road_cells] = True
        model = BackgroundModel(_in_blocks(intervals_m), is_road, *self._grid, 1.0, surface)
        ratio = foreground_of(returns, model, 0.0).background_ratio
        self.model, self._modes = replace(model, background_ratio=ratio), None


def foreground_of(returns: Returns, model: BackgroundModel, near_m: float) -> Foreground:
    """Returns that do not lie within the ranges of a model; ``near_m``: distance below which returns count as near."""
    if isinstance(returns, RangeImage):
        first = _first_cells(returns, model.columns)
        return Foreground(*kernels.foreground_of_image(returns.arrays, first, model.intervals, near_m))
    points = np.ascontiguousarray(returns, np.float32)
    return Foreground(*kernels.foreground_of_points(points, _azimuth(points), model.grid, model.intervals, near_m))


def locate(returns: Returns, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """(N,) int32 cell of each return, ``NO_RETURN`` where there is none, and (N,) float32 range (m)."""
    if not isinstance(returns, RangeImage):
        points = np.ascontiguousarray(returns, np.float32)
        return kernels.locate(points, _azimuth(points), grid)
    range_m = returns.range_m
    cell = _first_cells(returns, grid.columns)[:, None] + np.arange(range_m.shape[1], dtype=np.int32)
    cell[~((range_m > MIN_RANGE_M) & (range_m < MAX_RANGE_M))] = NO_RETURN
    return cell.ravel(), range_m.ravel()


def _azimuth(points: np.ndarray) -> np.ndarray:
    """(N,) float32 rad, of points (N, 3+) float32."""
    x, y = (np.ascontiguousarray(points[:, axis]) for axis in (0, 1))
    return azimuth_of(x, y)


def _first_cells(image: RangeImage, columns: int) -> np.ndarray:
    """(R,) int32 cell of the first range of each row; those of the other beams of its bank follow.

    Banks beyond the grid's rows are the same beams in another firing order (Hesai): they share their cells.
    """
    turn = (azimuth_of(image.cos, image.sin) + np.pi) / (2.0 * np.pi)
    column = np.minimum((turn * columns).astype(np.int32), columns - 1)
    return column * RINGS + image.bank * np.int32(image.range_m.shape[1]) % RINGS


def _no_modes(grid: Grid) -> RangeModes:
    cells = grid.columns * grid.rows
    size = cells, MODES
    return RangeModes(
        near_m=np.zeros(size, np.float32), far_m=np.zeros(size, np.float32), frames=np.zeros(size, np.uint16),
        road_user_frames=np.zeros(size, np.uint16), latest=np.zeros(cells, np.uint8),
        switches=np.zeros(cells, np.uint16),
    )  # fmt: skip


def _in_blocks(intervals_m: np.ndarray) -> np.ndarray:
    """Intervals (cells, 4) float32 m as ``BackgroundModel`` keeps them, rounded so that none becomes narrower."""
    steps = np.empty(intervals_m.shape, np.uint16)
    steps[:, ::2] = np.floor(intervals_m[:, ::2] / kernels.STEP_M).clip(0, 65535)
    steps[:, 1::2] = np.ceil(intervals_m[:, 1::2] / kernels.STEP_M).clip(0, 65535)
    return np.ascontiguousarray(steps.reshape(-1, kernels.BLOCK, 4).transpose(0, 2, 1))


def _with_neighbours(users: np.ndarray, grid: Grid) -> np.ndarray:
    """Cells of road users and their neighbours in azimuth: the edge of a parked car must not become background."""
    wide = users.reshape(grid)
    return np.asarray(wide | np.roll(wide, 1, axis=0) | np.roll(wide, -1, axis=0)).ravel()
