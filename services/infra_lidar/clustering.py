"""Clusters: connected components of occupied bird's-eye-view cells, sized by range, then split and merged.

Cells grow with range because the spacing of returns does: near the sensor 15 cm keep two pedestrians apart, far away
the same cell would break a car. Cells are filled by points up to the height of a body; what is above joins tall things
(buses) only, so that a tree's canopy does not tie the cars below it together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.infra_lidar import kernels_adopt as adoption
from services.infra_lidar import kernels_clusters as clusters
from services.infra_lidar import kernels_labels as labels
from services.infra_lidar import kernels_merge as merging
from services.infra_lidar import kernels_split as splitting
from services.infra_lidar.buffers import LINE_FLOATS, Buffers
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.ground import Levelled
from services.infra_lidar.kernels_runs import find_runs

TALL_BAND_M = 0.4  # a component with points in the top of the body band goes on above it
TALL_SHARE = 0.03
_UNKNOWN = np.zeros(0, np.int32)
MIN_FRAGMENT_POINTS = 3  # smaller pieces have no shape to judge by: they can only be adopted


@dataclass(frozen=True)
class ClusterPoints:
    """Clusters of one frame in the level frame.

    cluster_id: (N,) int32 per point of the frame, -1 = none. planar: (3, M) float32 x, y, z, grouped; cluster k has
    planar[:, offsets[k]:offsets[k + 1]]. offsets: (K + 1,) int32. box: (K, 8) float32: centre x, y, z, length, width,
    height, yaw, gap to the road. Only ``cluster_id`` is a view into a buffer, valid until the next frame.
    """

    cluster_id: np.ndarray
    planar: np.ndarray
    offsets: np.ndarray
    box: np.ndarray

    def __len__(self) -> int:
        return len(self.box)

    @property
    def points(self) -> np.ndarray:
        """(M, 3) float32, the same points row by row."""
        return self.planar.T

    @property
    def counts(self) -> np.ndarray:
        """(K,) points per cluster."""
        return np.diff(self.offsets)

    @property
    def means(self) -> np.ndarray:
        """(K, 3) float64, the mean of each cluster's points."""
        means = np.empty((len(self), 3))
        clusters.means(self.planar, self.offsets, means)
        return means


@dataclass(slots=True)
class _Runs:
    """Runs of points of one label, -1 = none: run r from begin[r] to begin[r + 1]. across: how many cells each label is
    across, empty = unknown."""

    begin: np.ndarray
    label: np.ndarray
    across: np.ndarray


@dataclass(slots=True)
class _Grouped:
    """Points that lie together by cluster: cluster k from offsets[k] to offsets[k + 1], with its measured box."""

    points: np.ndarray  # (4, T) float32: x, y, z, above
    source: np.ndarray
    offsets: np.ndarray
    box: np.ndarray
    side: int  # which of the two sets of buffers holds them


class Clustering:
    """Clusters one sensor's frames. Holds buffers: one instance per sensor, one thread at a time."""

    def __init__(self, config: ClusteringConfig, range_max_m: float, buffers: Buffers | None = None) -> None:
        self._config = config
        self._buffers = buffers or Buffers()
        c, g = config.cell_m, config.cell_growth_m
        reach = range_max_m / c if g == 0 else g / c * np.log1p(range_max_m / g)
        self.side = 2 * int(np.ceil(reach)) + 2
        words = (self.side + 63) // 64
        self._grid = np.zeros((self.side, words, 4), np.uint64)
        self._touched = np.zeros((self.side, (words + 63) // 64), np.uint64)
        self._row_start = np.zeros(self.side + 1, np.int32)
        self._limits = np.array(
            [config.min_points, config.max_points, config.max_height_m, config.min_top_m, config.max_diagonal_m],
            np.float32,
        )

    @property
    def nbytes(self) -> int:
        """Bytes of the cell grids."""
        return self._grid.nbytes + self._touched.nbytes + self._row_start.nbytes

    def cluster(self, frame: Levelled) -> ClusterPoints:
        """Group the points of a frame that are not ground."""
        # Components of cells that are occupied as low as a body; what is higher joins tall ones, or is on its own
        config, points = self._config, np.ascontiguousarray(frame.points)
        runs = self._components(points, len(frame.rest), self._body_m, "all")
        if config.body_height_m > 0:
            runs = self._label_high(points, runs)
        found = self._regroup(runs, points, frame.rest)

        # Pieces of vehicles, then the article's second look
        if config.merge == "fragments":
            found = self._join_fragments(found)
        found = self._second_look(found, self._possible(found))
        return self._result(frame, found)

    def _components(self, points: np.ndarray, m: int, body_m: np.float32, name: str) -> _Runs:
        """Components of the first m points (4, M): the cells are filled by those lower than ``body_m``."""
        config, take = self._config, self._buffers.take
        room = m + 1 + LINE_FLOATS
        scratch = take("cells", 5 * room, np.int32).reshape(5, room)
        begin, label = take(f"{name}_begin", m + 1, np.int32), take(f"{name}_label", m, np.int32)
        across = take(f"{name}_across", m, np.int32)
        runs, components = labels.label_points(
            points, m, body_m, np.float32(config.cell_m), np.float32(config.cell_growth_m), config.min_cell_points > 1,
            int(config.connectivity == 8), self._grid, self._touched, self._row_start, scratch, begin, label, across,
        )  # fmt: skip
        return _Runs(begin[: runs + 1], label[:runs], across[:components])

    def _label_high(self, points: np.ndarray, runs: _Runs) -> _Runs:
        """Give high points to tall components, and label those that join nothing: a roof behind other cars, or a
        canopy."""
        take, components, m = self._buffers.take, len(runs.across), runs.begin[-1]
        label, free = take("label", m, np.int32), take("free", m, np.int32)
        clusters.spread(runs.begin, runs.label, label)
        number = clusters.join_high(
            label, points[3], components, self._body_m - np.float32(TALL_BAND_M), self._body_m, TALL_SHARE,
            take("in_band", components, np.int32), take("total", components, np.int32), free,
        )  # fmt: skip
        across = runs.across
        if number > 0:
            free = free[:number]
            high = self._components(np.ascontiguousarray(points[:, free]), number, np.float32(np.inf), "high")
            clusters.join_labels(high.begin, high.label, components, free, label)
            across = np.concatenate((across, high.across))
        return self._runs(label, across)

    def _runs(self, label: np.ndarray, across: np.ndarray) -> _Runs:
        """Points with a label (M,) each, as runs of one label."""
        begin = self._buffers.take("begin", len(label) + 1, np.int32)
        runs = find_runs(label, begin)
        return _Runs(begin[: runs + 1], label[begin[:runs]], across)

    @property
    def _body_m(self) -> np.float32:
        """Cells are filled by points lower than this."""
        return np.float32(self._config.body_height_m or np.inf)

    @property
    def _fewest_points(self) -> int:
        """Components with fewer points are not looked at."""
        return 1 if self._config.merge == "fragments" else self._config.min_points

    def _regroup(self, runs: _Runs, points: np.ndarray, source: np.ndarray) -> _Grouped:
        """Points by component, of those that may be a cluster or a part of one, as copies that lie together."""
        config = self._config
        widest = int(config.max_diagonal_m / config.cell_m)  # cells only grow with range
        count = len(runs.across)
        return self._arranged(runs, count, points, source, 0, self._fewest_points, config.max_points, widest)

    def _rejoin(self, found: _Grouped, group: np.ndarray) -> _Grouped:
        """Clusters with the same ``group`` (K,) become one."""
        return self._again(found, _Runs(found.offsets, group, _UNKNOWN), len(found.box))

    def _again(self, found: _Grouped, runs: _Runs, count: int) -> _Grouped:
        """Points of clusters, grouped anew by ``count`` labels."""
        return self._arranged(runs, count, found.points, found.source, 1 - found.side, 1, len(found.source), 0)

    def _arranged(
        self, runs: _Runs, components: int, points: np.ndarray, source: np.ndarray, side: int, fewest: int, most: int,
        widest: int,
    ) -> _Grouped:  # fmt: skip
        m, take = len(source), self._buffers.take
        offsets, box = take(f"offsets{side}", components + 1, np.int32), np.empty((components, 8), np.float32)
        flat, there_source = take(f"points{side}", 4 * m, np.float32), take(f"source{side}", m, np.int32)
        count, total = clusters.regroup(
            runs.begin, runs.label, components, fewest, most, runs.across, widest, points, source,
            take("number", components, np.int32), offsets, flat, there_source, box,
        )  # fmt: skip
        return _Grouped(
            flat[: 4 * total].reshape(4, total), there_source[:total], offsets[: count + 1], box[:count], side
        )

    def _join_fragments(self, found: _Grouped) -> _Grouped:
        """Join fragments of vehicles, and to tall ones the single returns along a side seen at a small angle."""
        group = np.empty(len(found.box), np.int32)
        counts = np.diff(found.offsets)
        merging.merge_fragments(found.box, counts, MIN_FRAGMENT_POINTS, group)
        adoption.adopt_strays(found.box, counts, self._config.min_points, group)
        return self._rejoin(found, group)

    def _possible(self, found: _Grouped) -> np.ndarray:
        """(K,) bool: clusters of a possible size."""
        good = np.empty(len(found.box), bool)
        clusters.possible(found.box, found.offsets, self._limits, good)
        return good

    def _second_look(self, found: _Grouped, good: np.ndarray) -> _Grouped:
        """Those clusters that are ``good``, trimmed, cut and joined if the article's way is set."""
        config, total, take = self._config, len(found.source), self._buffers.take
        trim, split, engulf = config.trim_ground, config.split == "gap", config.merge == "engulfed"
        if not (trim or split or engulf):
            return (
                found if good.all() else self._rejoin(found, np.where(good, np.arange(len(good)), -1).astype(np.int32))
            )
        label, scratch = take("label", total, np.int32), take("kept", 4 * total, np.float32).reshape(4, total)
        count = splitting.second_look(found.points, found.offsets, found.box, good, trim, split, engulf, scratch, label)
        return self._again(found, self._runs(label, _UNKNOWN), count)

    def _result(self, frame: Levelled, found: _Grouped) -> ClusterPoints:
        cluster_id = self._buffers.take("cluster_id", len(frame.x), np.int32)
        clusters.write_ids(found.source, found.offsets, cluster_id)
        return ClusterPoints(cluster_id, found.points[:3].copy(), found.offsets.copy(), found.box)
