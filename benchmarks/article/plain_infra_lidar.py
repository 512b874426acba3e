"""The article's pipeline written plainly: numpy, scipy and scikit-learn, one loop per cell, cluster and pair.

This is what ``benchmarks/infra_lidar/speed.py`` takes its ratios against: careful, readable code without a compiler,
of the kind one writes first. Points are levelled once and stay in that frame. Constants are those of the article.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

RANGE_M, LOW_M, HIGH_M = 80.0, -1.0, 3.0
RING_M, SECTOR_DEG = 5.0, 5.0
CELL_M = 0.15


def ground_and_rest(points: np.ndarray, T_level_sensor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) ground mask and (N,) mask of the points to cluster, of (N, 3+) sensor-frame points."""
    level = points[:, :3].astype(np.float64) @ T_level_sensor[:3, :3].T + T_level_sensor[:3, 3]
    radius = np.hypot(level[:, 0], level[:, 1])
    z = level[:, 2]
    inside = (radius <= RANGE_M) & (z >= LOW_M) & (z <= HIGH_M)
    sectors = round(360 / SECTOR_DEG)
    angle = np.arctan2(level[:, 1], level[:, 0]) + np.pi
    sector = np.minimum((angle * sectors / (2 * np.pi)).astype(int), sectors - 1)
    cell = np.where(inside, (radius / RING_M).astype(int) * sectors + sector, -1)
    height = np.zeros(cell.max() + 1)
    order = np.argsort(cell, kind="stable")
    ids, starts = np.unique(cell[order], return_index=True)
    for cell_id, members in zip(ids, np.split(order, starts[1:]), strict=True):
        if cell_id < 0 or len(members) < 5:
            continue
        k = max(1, int(0.05 * len(members)))
        low = np.partition(z[members], k)[k]
        allowed = min(0.5 + 0.08 * (cell_id // sectors + 0.5) * RING_M, 2.0)
        height[cell_id] = low if abs(low) <= allowed else 0.0
    local = height[np.maximum(cell, 0)]
    ground = inside & (z >= local - 0.10) & (z <= local + 0.15)
    return ground, inside & ~ground


def find_clusters(xyz: np.ndarray) -> list[np.ndarray]:
    """Index arrays of the clusters among (M, 3) level-frame points that are not ground."""
    column = np.floor(xyz[:, :2] / CELL_M).astype(int)
    column -= column.min(axis=0)
    count = np.zeros(column.max(axis=0) + 1, int)
    np.add.at(count, (column[:, 0], column[:, 1]), 1)
    labels, found = ndimage.label(count >= 2)
    of_point = labels[column[:, 0], column[:, 1]]
    clusters = []
    for label in range(1, found + 1):
        members = np.flatnonzero(of_point == label)
        if 20 <= len(members) <= 15_000 and _possible_size(xyz[members]):
            clusters.append(members)
    clusters = [_without_feet(xyz, members) for members in clusters]
    pieces = [piece for members in clusters for piece in _split_row(xyz, members)]
    return _join_engulfed(xyz, pieces)


def _footprint(xy: np.ndarray) -> tuple[float, float]:
    """Length and width along the principal axes."""
    centred = xy - xy.mean(axis=0)
    _, vectors = np.linalg.eigh(centred.T @ centred / len(xy))
    along = centred @ vectors[:, ::-1]
    length, width = np.ptp(along, axis=0)
    return float(length), float(width)


def _possible_size(xyz: np.ndarray) -> bool:
    return bool(np.ptp(xyz[:, 2]) <= 5.0 and np.hypot(*_footprint(xyz[:, :2])) <= 15.0)


def _without_feet(xyz: np.ndarray, members: np.ndarray) -> np.ndarray:
    z = xyz[members, 2]
    if z.min() >= 0.25 or np.ptp(z) <= 0.5:
        return members
    k = int(0.05 * len(members))
    return members[z > np.partition(z, k)[k]]


def _split_row(xyz: np.ndarray, members: np.ndarray) -> list[np.ndarray]:
    z = xyz[members, 2]
    if not (150 < len(members) <= 2000 and 1.0 <= np.ptp(z) <= 2.2):
        return [members]
    centred = xyz[members] - xyz[members].mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / len(members))
    if (values[2] - values[1]) / values.sum() <= 0.3 or abs(vectors[2, 2]) > 0.5:
        return [members]
    along = centred @ vectors[:, 2]
    edges = np.linspace(along.min(), along.max(), 30)
    histogram = np.histogram(along, edges)[0]
    empty = histogram < max(0.2 * histogram.mean(), 1.0)
    cuts, first = [], None
    for b, gap in enumerate(empty):
        if gap and first is None:
            first = b
        elif not gap and first is not None:
            cuts.append(0.5 * (edges[first] + edges[b]))
            first = None
    piece = np.searchsorted(cuts, along)
    parts = [members[piece == p] for p in range(len(cuts) + 1)]
    people = [part for part in parts if _is_person(xyz[part])]
    sizes = [len(part) for part in people]
    if len(people) < 2 or min(sizes) < 0.25 * max(sizes):
        return [members]
    rest = np.concatenate([part for part in parts if not _is_person(xyz[part])] or [np.zeros(0, int)])
    return people + ([rest] if 20 <= len(rest) <= 1000 else [])


def _is_person(xyz: np.ndarray) -> bool:
    n = len(xyz)
    if not 20 <= n <= 1000:
        return False
    z = np.sort(xyz[:, 2])
    tall, wide = np.ptp(z), np.hypot(*np.ptp(xyz[:, :2], axis=0))
    if tall < 0.8 or not 0.3 <= wide <= 1.5 or tall / wide < 0.8:
        return False
    if z[int(0.95 * (n - 1))] - z[int(0.05 * (n - 1))] < 0.3:
        return False
    layers = np.bincount(np.minimum(((z - z[0]) / tall * 4).astype(int), 3), minlength=4)
    return bool(layers.std() / layers.mean() <= 1.5)


def _join_engulfed(xyz: np.ndarray, clusters: list[np.ndarray]) -> list[np.ndarray]:
    boxes = [(xyz[c].min(axis=0), xyz[c].max(axis=0)) for c in clusters]
    host = list(range(len(clusters)))
    for b, (low_b, high_b) in enumerate(boxes):
        for a, (low_a, high_a) in enumerate(boxes):
            small = len(clusters[b]) < 0.5 * len(clusters[a])
            if a != b and small and (low_b >= low_a).all() and (high_b <= high_a).all():
                host[b] = a
                break
    for b in range(len(host)):
        while host[host[b]] != host[b]:
            host[b] = host[host[b]]
    hosts = [a for a in range(len(host)) if host[a] == a]
    return [np.concatenate([clusters[b] for b in range(len(host)) if host[b] == a]) for a in hosts]


def features(xyz: np.ndarray) -> np.ndarray:
    """(22,) of one cluster: the article's 23 without the hull's share of vertices."""
    n, z = len(xyz), np.sort(xyz[:, 2])
    tall = z[-1] - z[0]
    centred = xyz - xyz.mean(axis=0)
    flat_values, flat_vectors = np.linalg.eigh(centred[:, :2].T @ centred[:, :2] / n)
    along = centred[:, :2] @ flat_vectors[:, ::-1]
    length, width = np.ptp(along, axis=0)
    spread, area = np.hypot(length, width), length * width
    l3, l2, l1 = np.maximum(np.linalg.eigvalsh(centred.T @ centred / n), 1e-9)
    layer = ((xyz[:, 2] - z[0]) / max(tall, 1e-9) * 5).astype(int)
    shares = [np.sum(layer == k) / n for k in range(5)]
    slices = np.zeros(5)
    if n > 20 and tall > 0.1:
        for k in range(5):
            part = along[layer == k]  # the topmost point is in none of them
            slices[k] = np.hypot(*np.ptp(part, axis=0)) if len(part) > 2 else 0.0
    near = 0.0
    if n > 6:
        distance, _ = KDTree(xyz).query(xyz, k=6)
        near = distance[:, 1:].mean(axis=1).std()
    return np.array([
        spread, area, tall, tall / max(spread, 1e-9), n / max(area * np.sqrt(tall), 1e-9), z[int(0.25 * (n - 1))],
        z[int(0.75 * (n - 1))], z.std(), n, max(flat_values[1], 1e-9) / max(flat_values[0], 1e-9), l3 / l1,
        (l1 - l2) / l1, (l2 - l3) / l1, *shares, slices.std(), near, slices.mean(),
        z[int(0.95 * (n - 1))] - z[int(0.05 * (n - 1))],
    ])  # fmt: skip


@dataclass
class Track:
    """One object: state x y z vx vy vz and its covariance."""

    number: int
    label: int
    x: np.ndarray
    P: np.ndarray
    hits: int = 1
    misses: int = 0
    confirmed: bool = False


@dataclass
class Tracker:
    """The article's tracker: a 6-state filter a track, a loop over all pairs, Hungarian, hits and misses in frames."""

    dt_s: float = 0.1
    tracks: list[Track] = field(default_factory=list)
    _next: int = 0

    def update(self, centres: np.ndarray, labels: np.ndarray) -> list[Track]:
        """Detections (K, 3) with their class (K,); returns the confirmed tracks."""
        F, Q = np.eye(6), np.diag([0.5] * 3 + [2.0] * 3)
        F[:3, 3:] = self.dt_s * np.eye(3)
        H, R = np.eye(3, 6), 0.3 * np.eye(3)
        for track in self.tracks:
            track.x, track.P = F @ track.x, F @ track.P @ F.T + Q
        cost = np.full((len(self.tracks), len(centres)), 1e6)
        for i, track in enumerate(self.tracks):
            for j, centre in enumerate(centres):
                if labels[j] == track.label:
                    y = centre - H @ track.x
                    d2 = y @ np.linalg.solve(H @ track.P @ H.T + R, y)
                    cost[i, j] = np.sqrt(d2) if d2 <= 7.81 else 1e6
        rows, columns = linear_sum_assignment(cost)
        taken = {i: j for i, j in zip(rows, columns, strict=True) if cost[i, j] < 5.0}
        for i, track in enumerate(self.tracks):
            if i in taken:
                K = track.P @ H.T @ np.linalg.inv(H @ track.P @ H.T + R)
                track.x = track.x + K @ (centres[taken[i]] - H @ track.x)
                track.P = (np.eye(6) - K @ H) @ track.P
                track.hits, track.misses = track.hits + 1, 0
                track.confirmed |= track.hits >= 2
            else:
                track.misses += 1
        self.tracks = [t for t in self.tracks if t.misses < (3 if t.confirmed else 1)]
        for j in sorted(set(range(len(centres))) - set(taken.values())):
            state = np.concatenate([centres[j], np.zeros(3)])
            self.tracks.append(Track(self._next, int(labels[j]), state, np.diag([0.5] * 3 + [10.0] * 3)))
            self._next += 1
        return [t for t in self.tracks if t.confirmed]


class PlainPipeline:
    """Raw points to tracks; ``model`` is a fitted scikit-learn forest over ``features``."""

    def __init__(self, model: object, background: int = 0) -> None:
        self._model = model
        self._background = background
        self.tracker = Tracker()

    def process(self, points: np.ndarray, T_level_sensor: np.ndarray) -> dict[str, object]:
        """One frame: ground mask, clusters (index arrays), their features and labels, confirmed tracks."""
        ground, rest = ground_and_rest(points, T_level_sensor)
        kept = np.flatnonzero(rest)
        xyz = points[kept, :3].astype(np.float64) @ T_level_sensor[:3, :3].T + T_level_sensor[:3, 3]
        clusters = find_clusters(xyz)
        table = np.array([features(xyz[c]) for c in clusters]).reshape(-1, 22).astype(np.float32)
        probabilities = self._model.predict_proba(table)  # type: ignore[attr-defined]
        labels = self._model.classes_[probabilities.argmax(axis=1)]  # type: ignore[attr-defined]
        objects = np.flatnonzero(labels != self._background)
        centres = np.array([xyz[clusters[k]].mean(axis=0) for k in objects]).reshape(-1, 3)
        tracks = self.tracker.update(centres, labels[objects])
        return {
            "ground": ground, "clusters": [kept[c] for c in clusters], "features": table, "labels": labels,
            "centres": centres, "tracks": tracks,
        }  # fmt: skip
