"""Constant false alarm rate detection on the range-Doppler power map: cell averaging and ordered statistic.

Noise is estimated in *linear* power from training cells around a guard zone. Range has ends: cells beyond them do not
exist and are left out of the mean. Doppler is cyclic: the training zone continues on the other side.
Methods: Finn and Johnson 1968 (cell averaging), Rohling 1983 (ordered statistic).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from services.radar_pi.cfar_design import ca_scale, os_mean_ratio, os_scale
from services.radar_pi.config import CfarConfig
from services.radar_pi.noise import RowNoise

LEVELS = np.array([0.1, 0.25, 0.4, 0.6, 0.9, 1.2, 2.0], np.float32)  # of the median cell, for the ordered statistic
MIN_TRAINING = 0.1  # share of the training cells that has to be left


@dataclass(frozen=True)
class Hits:
    """Cells over threshold: three arrays of equal length."""

    row: np.ndarray  # range
    column: np.ndarray  # Doppler
    noise: np.ndarray  # estimated mean noise power of the cell

    def shifted(self, rows: int) -> Hits:
        """The same cells in a map that has so many more rows before the first."""
        return Hits(self.row + rows, self.column, self.noise)


class Zone:
    """Guard and training cells of a map; the Doppler extent is cut where it would meet itself."""

    def __init__(self, config: CfarConfig, rows: int, columns: int) -> None:
        free = (columns - 1) // 2
        self.guard = (config.guard_range, min(config.guard_doppler, max(0, free - 1)))
        self.outer = (
            config.guard_range + config.train_range,
            min(config.guard_doppler + config.train_doppler, free),
        )
        self.outer_rows = _band(rows, self.outer[0], cyclic=False)
        self.train_rows = self.outer_rows - _band(rows, self.guard[0], cyclic=False)
        self.guard_columns = _band(columns, self.guard[1], cyclic=True)
        self.train_columns = _band(columns, self.outer[1], cyclic=True) - self.guard_columns

    def sums(self, power: np.ndarray) -> np.ndarray:
        """Sum over the training cells of every cell, (R, D). No difference of large sums is taken."""
        beside = self.outer_rows @ power @ self.train_columns
        before_and_behind = self.train_rows @ power @ self.guard_columns
        total: np.ndarray = beside + before_and_behind
        return total

    def sums_at(self, power: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """The same sums of the cells (row[i], column[i]) only, (N,)."""
        beside = np.vecdot(self.outer_rows[row] @ power, self.train_columns[column])
        before_and_behind = np.vecdot(self.train_rows[row] @ power, self.guard_columns[column])
        total: np.ndarray = beside + before_and_behind
        return total

    def offsets(self) -> tuple[np.ndarray, np.ndarray]:
        """Row and column offsets of all training cells of an inner cell."""
        rows, columns = np.mgrid[-self.outer[0] : self.outer[0] + 1, -self.outer[1] : self.outer[1] + 1]
        train = (np.abs(rows) > self.guard[0]) | (np.abs(columns) > self.guard[1])
        return rows[train], columns[train]


class CellAveraging:
    """Noise = the mean of the training cells, without those that are no noise.

    Excision (Goldman and Bar-David 1988): a body spreads over many cells and would hide itself, so training cells far
    above the level of their range row are left out. The row's level is a low quantile over Doppler, which a body does
    not reach. In white noise next to nothing is left out.
    """

    def __init__(self, config: CfarConfig, rows: int, columns: int, looks: int) -> None:
        self._zone = Zone(config, rows, columns)
        self._count = self._zone.sums(np.ones((rows, columns), np.float32))
        self._scale = np.full((rows, columns), 10 ** (config.threshold_db / 10), np.float32)
        if config.p_fa:
            self._scale = _per_count(self._count, lambda n: ca_scale(config.p_fa, n, looks))
        self._row_noise = RowNoise(columns, looks)
        self._excise = np.float32(10 ** (config.excise_db / 10)) if config.excise_db else None

    def detect(self, power: np.ndarray, row_noise: np.ndarray | None = None) -> Hits:
        """Cells of the (R, D) float32 power map that exceed scale times their noise.

        ``row_noise``: (R, 1), what ``RowNoise`` says of this map, when the caller has asked already.
        """
        if self._excise is None:
            noise = self._zone.sums(power) / self._count
            row, column = np.nonzero(power > self._scale * noise)
            return Hits(row, column, noise[row, column])
        return self._excised(power, self._row_noise.estimate(power) if row_noise is None else row_noise, self._excise)

    def _excised(self, power: np.ndarray, row_noise: np.ndarray, excise: np.float32) -> Hits:
        limit = excise * row_noise
        left = power <= limit
        total = self._zone.sums(power * left)
        # What is left is at most all cells, so no noise is below this: few cells need their cells counted.
        least = np.minimum(total / self._count, limit)
        row, column = np.divmod(np.flatnonzero(power > self._scale * least), power.shape[1])
        count = self._zone.sums_at(left.astype(np.float32), row, column)
        mean = total[row, column] / np.maximum(count, 1.0)
        noise = np.where(count > MIN_TRAINING * self._count[row, column], mean, limit[row, 0])
        over = power[row, column] > self._scale[row, column] * noise
        return Hits(row[over], column[over], noise[over])


class OrderedStatistic:
    """Noise from the k-th smallest training cell: a second target in the training zone does not raise it."""

    def __init__(self, config: CfarConfig, rows: int, columns: int, looks: int) -> None:
        self._zone = Zone(config, rows, columns)
        self._offsets = self._zone.offsets()
        count = self._zone.sums(np.ones((rows, columns), np.float32))
        rank = np.maximum(1, np.round(config.os_fraction * count)).astype(np.intp)
        ratio = _per_count(count, lambda n: os_mean_ratio(max(1, round(config.os_fraction * n)), n, looks))
        if config.p_fa:
            scale = _per_count(count, lambda n: os_scale(config.p_fa, max(1, round(config.os_fraction * n)), n, looks))
        else:
            scale = 10 ** (config.threshold_db / 10) / ratio
        self._rank, self._ratio, self._scale = rank, ratio, scale.astype(np.float32)

    def detect(self, power: np.ndarray, row_noise: np.ndarray | None = None) -> Hits:
        """Cells of the (R, D) float32 power map over scale times their order statistic; ``row_noise`` is not asked."""
        row, column = np.nonzero(power > self._scale * self._at_least(power))
        statistic = self._statistic(power, row, column)
        over = power[row, column] > self._scale[row, column] * statistic
        row, column = row[over], column[over]
        return Hits(row, column, statistic[over] / self._ratio[row, column])

    def _at_least(self, power: np.ndarray) -> np.ndarray:
        """A lower bound of every cell's statistic, exact and cheap: it spares most cells the sorting.

        Where fewer than k training cells lie below a level, the k-th smallest is not below that level.
        """
        usual = np.median(power)
        bound = np.zeros_like(power)
        for level in usual * LEVELS:
            below = self._zone.sums((power < level).astype(np.float32))
            bound = np.where(below < self._rank, level, bound)
        return bound

    def _statistic(self, power: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """The k-th smallest training cell of the given cells; cells beyond the ends of range sort last."""
        margin = self._zone.outer[0]
        padded = np.pad(power, ((margin, margin), (0, 0)), constant_values=np.inf)
        rows = row[:, None] + self._offsets[0] + margin
        columns = (column[:, None] + self._offsets[1]) % power.shape[1]
        cells = np.sort(padded[rows, columns], axis=1)
        return np.take_along_axis(cells, self._rank[row, column][:, None] - 1, axis=1)[:, 0]


Cfar = CellAveraging | OrderedStatistic


def build_cfar(config: CfarConfig, rows: int, columns: int, looks: int) -> Cfar:
    """The configured detector for a (rows, columns) map that is the mean of ``looks`` receivers."""
    kind = CellAveraging if config.kind == "ca" else OrderedStatistic
    return kind(config, rows, columns, looks)


def _band(length: int, half_width: int, *, cyclic: bool) -> np.ndarray:
    """(length, length) float32 of 0 and 1: which cells lie within half_width of each cell."""
    index = np.arange(length)
    distance = np.abs(index[:, None] - index[None, :])
    if cyclic:
        distance = np.minimum(distance, length - distance)
    return (distance <= half_width).astype(np.float32)


def _per_count(count: np.ndarray, value_of: Callable[[int], float]) -> np.ndarray:
    """Evaluate a function of the number of training cells once per distinct number."""
    result = np.empty(count.shape, np.float32)
    for n in np.unique(count):
        result[count == n] = value_of(round(float(n)))
    return result
