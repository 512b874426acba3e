"""The fixed scene of a fixed sensor: which range each beam returns in each direction when nobody is there.

Learned once over ``learn_s`` from whole frames, then frozen: nothing that arrives later ever becomes background, so an
obstacle that stops is never hidden. What the classifier took for a road user now and then (a parked car) is left out,
also when a bus stands before it as learning ends, and so is every direction that was seen through for a while (a queue
at a red light). The model is only a short cut for returns: those it knows need no ground, no cluster and no class.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from services.infra_lidar import kernels_background as kernels
from services.infra_lidar import kernels_image
from services.infra_lidar.buffers import LINE_FLOATS, Buffers
from services.infra_lidar.config import BackgroundConfig
from services.infra_lidar.range_image import RangeImage, Returns

MAX_RINGS = kernels_image.BEAMS
INTS, FLOATS = "cluster_ints", "cluster_floats"  # scratch of the clusters: not yet needed, or done with


@dataclass(frozen=True)
class BackgroundModel:
    """What is kept on disk: the known ranges (2, cells) int32 as ``kernels_background.pack`` makes them, the grid
    and how much it explains.

    surface: (cells of the polar grid, 3) float32, the road at the time. structure: (2, side, words) int32, see
    ``structure.py``; empty until it is drawn.
    """

    ranges: np.ndarray
    columns: int
    rows: int
    known_share: float
    surface: np.ndarray
    structure: np.ndarray = field(default_factory=lambda: np.zeros((2, 0, 0), np.int32))


@dataclass(frozen=True)
class Sifted:
    """A frame of N returns parted: fresh (3, M or more) x, y, z with index ``source`` (M,), and what was counted.
    ``fresh`` is a view into buffers, valid until the next frame."""

    fresh: np.ndarray
    source: np.ndarray
    returns: int
    near: int

    @property
    def known_share(self) -> float:
        """Of the returns."""
        return 1.0 - len(self.source) / max(self.returns, 1)


@dataclass(frozen=True, eq=False)
class Known:
    """What a model tells of a frame of N returns, all but the ``fresh`` (M,); made when somebody asks. What is no
    return is neither fresh nor known."""

    returns: Returns
    model: BackgroundModel
    fresh: np.ndarray

    @cached_property
    def mask(self) -> np.ndarray:
        """(N,) bool."""
        known = self._cells >= 0
        known[self.fresh] = False
        return known

    @cached_property
    def road(self) -> np.ndarray:
        """(N,) bool: those of them that are road."""
        return np.asarray(self.mask & ((self.model.ranges[0][self._cells] & kernels.ROAD) > 0))

    @cached_property
    def _cells(self) -> np.ndarray:
        cell, squared = np.empty((2, len(self.returns) + LINE_FLOATS), np.int32)
        locate(self.returns, self.model.columns, self.model.rows, cell, squared.view(np.float32))
        return cell[: len(self.returns)]


class Background:
    """Learns, recognises and applies the model of one sensor. Holds buffers: one thread at a time."""

    def __init__(
        self, config: BackgroundConfig, buffers: Buffers | None = None, stored: BackgroundModel | None = None
    ) -> None:
        self._config = config
        self._buffers = buffers or Buffers()
        self._trial: BackgroundModel | None = stored
        self.model: BackgroundModel | None = None
        self.restart(keep_stored=True)

    def restart(self, keep_stored: bool = False) -> None:
        """Forget what was learned and begin again."""
        self.model = None
        self._trial = self._trial if keep_stored else None
        self._frames = 0
        self._first_ns = 0
        self._misfits = 0
        self._low: np.ndarray | None = None

    def sift(self, returns: Returns, near_m: float) -> Sifted | None:
        """Part a frame with the model in use; None while there is none or it does not fit this frame."""
        if self.model is None:
            return None
        sifted = self._part(returns, self.model, near_m)
        misfit = sifted.known_share < 0.6 * self.model.known_share
        self._misfits = self._misfits + 1 if misfit else 0
        return None if misfit else sifted

    @property
    def lost(self) -> bool:
        """True when the scene has not looked as learned for a while: the sensor was moved, or the scene rebuilt."""
        return self._misfits >= 20

    def recognise(self, returns: Returns) -> None:
        """Take the stored model if it explains this frame nearly as well as it did when it was learned."""
        if self._trial is None:
            return
        if self._part(returns, self._trial, 0.0).known_share >= 0.8 * self._trial.known_share:
            self.model = self._trial
        self._trial = None

    def learn(
        self, stamp_ns: int, returns: Returns, ground: np.ndarray, road_user: np.ndarray, surface: np.ndarray
    ) -> np.ndarray | None:
        """Add a whole frame; ground, road_user (N,) bool of the same returns. Settles when it has seen enough: then it
        returns (N,) bool, the points where a road user often was; else None."""
        config = self._config
        if self._low is None:
            self._begin(stamp_ns, returns)
        tolerance, slope = np.float32(config.tolerance_m), np.float32(config.tolerance_slope)
        take, n = self._buffers.take, len(returns)
        cell, squared = take(INTS, n, np.int32), take(FLOATS, n, np.float32)
        locate(returns, self._columns, self._rows, cell, squared)
        kernels.learn(
            cell, squared, road_user, tolerance, slope, self._low, self._high, self._count, self._used, self._newest,
            self._switches,
        )  # fmt: skip
        self._frames += 1
        if self._frames < config.min_frames or stamp_ns - self._first_ns < config.learn_s * 1e9:
            return None
        self._low, users = None, self._settle(returns, cell, ground, surface)
        return np.asarray((cell >= 0) & users[cell])

    def _begin(self, stamp_ns: int, returns: Returns) -> None:
        rings = isinstance(returns, RangeImage) or returns.shape[1] > 4
        self._columns = self._config.azimuth_cells
        self._rows = MAX_RINGS if rings else kernels.ROWS_WITHOUT_RINGS
        cells = self._columns * self._rows
        self._first_ns = stamp_ns
        self._low = np.zeros((cells, kernels.MODES), np.float32)
        self._high = np.zeros((cells, kernels.MODES), np.float32)
        self._count = np.zeros((cells, kernels.MODES), np.uint16)
        self._used = np.zeros((cells, kernels.MODES), np.uint16)
        self._newest = np.zeros(cells, np.uint8)
        self._switches = np.zeros(cells, np.uint16)

    def _settle(self, returns: Returns, cell: np.ndarray, ground: np.ndarray, surface: np.ndarray) -> np.ndarray:
        """Makes the model; returns (cells,) bool, those where a road user often was, and their neighbours."""
        config, cells = self._config, self._columns * self._rows
        bounds, users = np.empty((cells, 4), np.float32), np.empty(cells, bool)
        kernels.settle(
            self._low, self._high, self._count, self._used, self._switches, self._frames, self._columns, self._rows,
            config.min_share, np.float32(config.tolerance_m), np.float32(config.tolerance_slope), bounds, users,
        )  # fmt: skip
        road, there = np.zeros(cells, bool), cell >= 0
        road[cell[ground & there]] = True
        users = _widened(users.reshape(self._columns, self._rows)).ravel()
        bounds[users] = (1.0, 0.0, 1.0, 0.0)
        ranges = np.empty((2, cells), np.int32)
        kernels.pack(bounds, road, ranges)
        model = BackgroundModel(ranges, self._columns, self._rows, 1.0, surface.copy())
        self.model = replace(model, known_share=self._part(returns, model, 0.0).known_share)
        return users

    def _part(self, returns: Returns, model: BackgroundModel, near_m: float) -> Sifted:
        n, take = len(returns), self._buffers.take
        room = n + -n % LINE_FLOATS
        source, fresh = np.empty(room + LINE_FLOATS, np.int32), take(FLOATS, 3 * room, np.float32).reshape(3, room)
        out = np.float32(near_m), source, fresh
        if isinstance(returns, RangeImage):
            image = returns
            m, number, near = kernels_image.sift_image(
                image.range_m, image.cos, image.sin, image.bank, image.beams, model.columns, model.ranges, *out
            )
        else:
            points = np.ascontiguousarray(returns, np.float32)
            m, number, near = kernels.sift(points, model.columns, model.rows, model.ranges, *out)
        return Sifted(fresh, source[:m], number, near)


def locate(returns: Returns, columns: int, rows: int, cell: np.ndarray, squared: np.ndarray) -> None:
    """Write the cells of N returns, int32, -1 = no return, and their squared distances, float32; both have room for a
    vector more."""
    if isinstance(returns, RangeImage):
        kernels_image.locate_image(returns.range_m, _first_cells(returns, columns), cell, squared)
    else:
        kernels.locate(np.ascontiguousarray(returns, np.float32), columns, rows, cell, squared)


def _first_cells(image: RangeImage, columns: int) -> np.ndarray:
    """(R,) int32: the cell of the first range of each row."""
    rows, width = image.range_m.shape
    first = np.empty(rows + LINE_FLOATS, np.int32)[:rows]
    kernels_image.locate_rows(image.cos, image.sin, image.bank, width, columns, first)
    return first


def _widened(users: np.ndarray) -> np.ndarray:
    """Cells of road users and their neighbours in azimuth: the edge of a parked car must not become background."""
    return np.asarray(users | np.roll(users, 1, axis=0) | np.roll(users, -1, axis=0))
