"""Collects sampled clusters, track histories and always-occupied cells of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from common.geometry import transform_points
from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.classification.features import compute_features
from services.infra_lidar.clustering.grid import CellGrid, cells_of
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.result import FrameResult

SAMPLE_S = 0.5  # between sampled revolutions: static objects look the same in consecutive ones
CELL_M = 0.3  # cell size near the sensor; cells grow with range like those of the clustering
BODY_M = 2.2  # cells above and below this height are separate: a tree crown may hang over a free road
MAX_CLUSTERS = 150_000  # no more are sampled after this


@dataclass
class TrackHistory:
    """A confirmed track from its first to its last revolution. votes: (C,) sum of its clusters' probabilities."""

    born_ns: int
    seen_ns: int
    first_m: np.ndarray
    votes: np.ndarray
    moved_m: float = 0.0  # greatest horizontal distance from its first position
    frames: int = 0
    moving_frames: int = 0
    hits: int = 0


class SiteRecord(NamedTuple):
    """K clusters of a recording, with the histories of their tracks and the occupancy of their cells.

    x: (K, F) float32 features. called: (K, C) probabilities. box: (K, 8) as in ``ClusterSet``. stamp_ns: (K,).
    track: (K,) id of the track that it belongs to, -1 = none, -2 = of several. standing: (K,) share of its points
    in cells that are occupied in ``STANDING_SHARE`` of the sampled revolutions or more. tracks: by id.
    sampled_ns: (P,) stamps of the sampled revolutions.
    """

    x: np.ndarray
    called: np.ndarray
    box: np.ndarray
    stamp_ns: np.ndarray
    track: np.ndarray
    standing: np.ndarray
    tracks: dict[int, TrackHistory]
    sampled_ns: np.ndarray


STANDING_SHARE = 0.75


class SiteRecorder:
    """Gets every revolution of a recording; ``record`` returns what was collected.

    names: the features that are stored for each cluster.
    """

    def __init__(self, names: tuple[str, ...], range_max_m: float) -> None:
        self._names = names
        self._grid = CellGrid(ClusteringConfig(cell_m=CELL_M), range_max_m)
        self._occupied = np.zeros(2 * self._grid.side**2, np.uint32)
        self._rows: list[tuple[np.ndarray, ...]] = []
        self._cells: list[np.ndarray] = []  # the cell of each point
        self._counts: list[np.ndarray] = []  # points per cluster
        self._tracks: dict[int, TrackHistory] = {}
        self._sampled_ns: list[int] = []
        self._clusters = 0

    def add(self, result: FrameResult, cluster_of: dict[int, int]) -> None:
        """Add a revolution; cluster_of: track id -> its cluster, as in ``MultiObjectTracker.matches``."""
        self._follow(result, cluster_of)
        since_s = (result.stamp_ns - self._sampled_ns[-1]) * 1e-9 if self._sampled_ns else np.inf
        if since_s >= SAMPLE_S and len(result.clusters) and self._clusters < MAX_CLUSTERS:
            self._sample(result, cluster_of)

    def record(self) -> SiteRecord:
        """Everything collected so far.

        Raises:
            ValueError: no cluster was seen.
        """
        if not self._rows:
            raise ValueError("no cluster was seen")
        x, called, box, stamp_ns, track = (np.concatenate(column) for column in zip(*self._rows, strict=True))
        fixed = self._occupied >= STANDING_SHARE * len(self._sampled_ns)
        counts = np.concatenate(self._counts)
        first = np.concatenate(([0], np.cumsum(counts)[:-1]))
        standing = np.add.reduceat(fixed[np.concatenate(self._cells)], first, dtype=int) / counts
        return SiteRecord(x, called, box, stamp_ns, track, standing, self._tracks, np.array(self._sampled_ns))

    def _follow(self, result: FrameResult, cluster_of: dict[int, int]) -> None:
        table = result.table
        for k in np.flatnonzero(table.state > 0):
            position, number = table.position_m[k], int(table.track_id[k])
            history = self._tracks.get(number)
            if history is None:
                history = TrackHistory(result.stamp_ns, result.stamp_ns, position, np.zeros(len(CLASSES)))
                self._tracks[number] = history
            history.seen_ns = result.stamp_ns
            history.moved_m = max(history.moved_m, float(np.hypot(*(position - history.first_m)[:2])))
            history.frames += 1
            history.moving_frames += bool(np.any(table.velocity_mps[k]))
            if number in cluster_of:
                history.votes += result.clusters.probabilities[cluster_of[number]]
                history.hits += 1

    def _sample(self, result: FrameResult, cluster_of: dict[int, int]) -> None:
        clusters = result.clusters
        points = transform_points(result.T_level_sensor, result.points[clusters.members, :3]).astype(np.float32)
        track = np.full(len(clusters), -1, np.int64)
        for number, cluster in cluster_of.items():
            track[cluster] = number if track[cluster] == -1 else -2
        cells = self._cells_of_points(points, points[:, 2] - np.repeat(clusters.ground_z_m, clusters.counts))
        self._occupied[np.unique(cells)] += 1
        x = compute_features(points, clusters.offsets, clusters.ground_z_m, self._names)
        stamps = np.full(len(clusters), result.stamp_ns)
        self._rows.append((x, clusters.probabilities, clusters.box, stamps, track))
        self._cells.append(cells)
        self._counts.append(clusters.counts)
        self._sampled_ns.append(result.stamp_ns)
        self._clusters += len(clusters)

    def _cells_of_points(self, points: np.ndarray, height_m: np.ndarray) -> np.ndarray:
        """(M,) int32 cell of each point (M, 3), level frame; ``height_m`` (M,) is above the road."""
        high = height_m >= BODY_M
        return (high * self._grid.side**2 + cells_of(points, self._grid.scale)).astype(np.int32)
