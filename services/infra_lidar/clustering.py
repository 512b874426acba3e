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
from services.infra_lidar.buffers import Buffers
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.ground import Levelled

TALL_BAND_M = 0.4  # a component with points in the top of the body band goes on above it
TALL_SHARE = 0.03
MIN_FRAGMENT_POINTS = 3  # smaller pieces have no shape to judge by: they can only be adopted


@dataclass(frozen=True)
class ClusterPoints:
    """Clusters of one frame in the level frame.

    cluster_id: (N,) int32 per point of the frame, -1 = none. points: (M, 3) float32, the transpose of a (3, M)
    array, grouped; cluster k has
    points[offsets[k]:offsets[k + 1]]. box: (K, 8) float32: centre x, y, z, length, width, height, yaw, gap to the road.
    """

    cluster_id: np.ndarray
    points: np.ndarray
    offsets: np.ndarray
    box: np.ndarray

    def __len__(self) -> int:
        return len(self.box)

    @property
    def counts(self) -> np.ndarray:
        """(K,) points per cluster."""
        return np.diff(self.offsets)

    @property
    def means(self) -> np.ndarray:
        """(K, 3) float64, the mean of each cluster's points."""
        if not len(self):
            return np.zeros((0, 3))
        return np.asarray(np.add.reduceat(self.points.astype(np.float64), self.offsets[:-1]) / self.counts[:, None])


@dataclass(frozen=True)
class _Points:
    """Planar float32 points, their height above the road, and their index in the frame."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    above: np.ndarray
    source: np.ndarray


@dataclass(frozen=True)
class _Grouped:
    """Points that lie together by cluster: cluster k from offsets[k] to offsets[k + 1], with its measured box."""

    points: _Points
    offsets: np.ndarray
    box: np.ndarray
    side: int  # which of the two sets of buffers holds the points


class Clustering:
    """Clusters one sensor's frames. Holds buffers: one instance per sensor, one thread at a time."""

    def __init__(self, config: ClusteringConfig, range_max_m: float, buffers: Buffers | None = None) -> None:
        self._config = config
        self._buffers = buffers or Buffers()
        c, g = config.cell_m, config.cell_growth_m
        reach = range_max_m / c if g == 0 else g / c * np.log1p(range_max_m / g)
        self.side = 2 * int(np.ceil(reach)) + 2
        words = (self.side + 63) // 64
        self._once = np.zeros((self.side, words), np.uint64)
        self._twice = np.zeros((self.side, words), np.uint64)
        self._starts = np.zeros((self.side, words), np.uint64)
        self._rank = np.zeros((self.side, words), np.int32)
        self._row_start = np.zeros(self.side + 1, np.int32)

    @property
    def nbytes(self) -> int:
        """Bytes of the cell grids."""
        return sum(a.nbytes for a in (self._once, self._twice, self._starts, self._rank, self._row_start))

    def cluster(self, frame: Levelled) -> ClusterPoints:
        """Group the points of a frame that are not ground."""
        config = self._config
        x, y, z, above, source, low = self._candidates(frame)
        label, components = self._components(x, y, low)
        if config.body_height_m > 0:
            self._join_high(label, above, low, components)
            components = self._label_high(x, y, label, low, components)
        found = self._arrange(label, components, _Points(x, y, z, above, source), 0, self._fewest_points)
        if config.merge == "fragments":
            found = self._join(found)
        good = self._possible(found)
        if config.trim_ground or config.split == "gap" or config.merge == "engulfed":
            found = self._second_look(found, good)
        else:
            found = self._regroup(found, np.where(good, np.arange(len(good)), -1))
        return self._result(frame, found)

    def _candidates(self, frame: Levelled) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
        m, take = len(frame.rest), self._buffers.take
        x, y, z, above = (take(f"c_{name}", m, np.float32) for name in ("x", "y", "z", "above"))
        source = take("c_source", m, np.int32)
        low, _ = clusters.gather_points(
            frame.rest, frame.x, frame.y, frame.z, frame.above_m, np.float32(self._config.body_height_m),
            x, y, z, above, source,
        )  # fmt: skip
        return x, y, z, above, source, low

    def _components(self, x: np.ndarray, y: np.ndarray, low: int, name: str = "label") -> tuple[np.ndarray, int]:
        """Component of every candidate: the cells are filled by the first ``low`` of them."""
        config, m, take = self._config, len(x), self._buffers.take
        row, column, label = take("row", m, np.int32), take("column", m, np.int32), take(name, m, np.int32)
        zero = np.float32(0.0)
        cell, growth = np.float32(config.cell_m), np.float32(config.cell_growth_m)
        labels.grid_cells(x, y, zero, zero, cell, growth, self.side, row, column)
        labels.occupy(row[:low], column[:low], self._once, self._twice)
        bits = self._once if config.min_cell_points == 1 else self._twice
        capacity = low + 1
        parent, first, last = (take(name, capacity, np.int32) for name in ("parent", "first", "last"))
        runs = labels.find_runs(bits, self._starts, self._rank, parent, first, last, self._row_start)
        labels.join_rows(parent, first, last, self._row_start, int(config.connectivity == 8))
        components = labels.number_components(parent, runs)
        labels.point_labels(row, column, bits, self._starts, self._rank, parent, label)
        return label, components

    def _join_high(self, label: np.ndarray, above: np.ndarray, low: int, components: int) -> None:
        take, body_m = self._buffers.take, self._config.body_height_m
        tall = take("tall", components, np.bool_)
        in_band, total = take("in_band", components, np.int32), take("total", components, np.int32)
        clusters.tall_components(
            label[:low], above[:low], components, np.float32(body_m - TALL_BAND_M), np.float32(body_m),
            TALL_SHARE, in_band, total, tall,
        )  # fmt: skip
        clusters.drop_high_of_low(label, low, tall)

    def _label_high(self, x: np.ndarray, y: np.ndarray, label: np.ndarray, low: int, components: int) -> int:
        """Components among the high points that joined nothing: a roof behind other cars, or a canopy."""
        free = low + np.flatnonzero(label[low:] < 0)
        if not len(free):
            return components
        high, found = self._components(x[free], y[free], len(free), "label_high")
        label[free] = np.where(high >= 0, high + components, -1)
        return components + found

    @property
    def _fewest_points(self) -> int:
        """Components with fewer points are not looked at."""
        return 1 if self._config.merge == "fragments" else self._config.min_points

    def _arrange(self, label: np.ndarray, components: int, points: _Points, side: int, fewest: int = 1) -> _Grouped:
        """Points by label, those of labels with ``fewest`` points or more, as copies that lie together."""
        counts = self._buffers.take("counts", components, np.int32)
        clusters.count_labels(label, counts)
        keep = counts >= fewest
        number = np.where(keep, np.cumsum(keep) - 1, -1).astype(np.int32)
        offsets = np.concatenate([[0], np.cumsum(counts[keep], dtype=np.int64)])
        total, take = int(offsets[-1]), self._buffers.take
        axes = [take(f"side{side}_{name}", total, np.float32) for name in ("x", "y", "z", "above")]
        there = _Points(axes[0], axes[1], axes[2], axes[3], take(f"side{side}_source", total, np.int32))
        clusters.arrange(
            label, number, offsets, points.x, points.y, points.z, points.above, points.source,
            there.x, there.y, there.z, there.above, there.source,
        )  # fmt: skip
        return _Grouped(there, offsets, _measured(there, offsets), side)

    def _regroup(self, found: _Grouped, group: np.ndarray) -> _Grouped:
        """Clusters with the same ``group`` become one; those of group -1 go. Untouched when nothing changes."""
        if len(group) == 0 or np.array_equal(group, np.arange(len(group))):
            return found
        used, number = np.unique(group, return_inverse=True)
        number = number.astype(np.int32) - (used[0] < 0)
        label = np.repeat(number, np.diff(found.offsets))
        return self._arrange(label, len(used) - int(used[0] < 0), found.points, 1 - found.side)

    def _join(self, found: _Grouped) -> _Grouped:
        """Join fragments of vehicles, and to tall ones the single returns along a side seen at a small angle."""
        group = np.empty(len(found.box), np.int32)
        merging.merge_fragments(found.box, np.diff(found.offsets), MIN_FRAGMENT_POINTS, group)
        adoption.adopt_strays(found.box, np.diff(found.offsets), self._config.min_points, group)
        return self._regroup(found, group)

    def _possible(self, found: _Grouped) -> np.ndarray:
        """(K,) bool: clusters of a possible size."""
        config, box, counts = self._config, found.box, np.diff(found.offsets)
        good = (counts >= config.min_points) & (counts <= config.max_points)
        good &= box[:, 5] <= config.max_height_m
        good &= box[:, 7] + box[:, 5] >= config.min_top_m
        good &= np.hypot(box[:, 3], box[:, 4]) <= config.max_diagonal_m
        return np.asarray(good)

    def _second_look(self, found: _Grouped, good: np.ndarray) -> _Grouped:
        """The article's trim, split and merge of those clusters that are ``good``."""
        config, count = self._config, len(found.box)
        number = np.where(good, np.arange(count, dtype=np.int32), np.int32(-1))
        label = np.repeat(number, np.diff(found.offsets))
        p = found.points
        if config.trim_ground:
            splitting.trim_feet(p.z, found.box, found.offsets, label)
        if config.split == "gap":
            count = splitting.split_rows(p.x, p.y, p.z, found.offsets, label)
        found = self._arrange(label, count, p, 1 - found.side)
        if config.merge != "engulfed":
            return found
        group = np.empty(len(found.box), np.int32)
        splitting.join_engulfed(found.points.x, found.points.y, found.points.z, found.offsets, group)
        return self._regroup(found, group)

    def _result(self, frame: Levelled, found: _Grouped) -> ClusterPoints:
        cluster_id = self._buffers.take("cluster_id", len(frame.x), np.int32)
        p = found.points
        clusters.write_ids(p.source, found.offsets, cluster_id)
        return ClusterPoints(cluster_id, np.stack([p.x, p.y, p.z]).T, found.offsets, found.box)


def _measured(points: _Points, offsets: np.ndarray) -> np.ndarray:
    box = np.empty((len(offsets) - 1, 8), np.float32)
    clusters.measure(points.x, points.y, points.z, points.above, offsets, box)
    return box
