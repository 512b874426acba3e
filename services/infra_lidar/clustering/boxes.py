"""Points grouped by cluster, and the oriented box of each cluster."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.jit import kernel


class ClusterPoints(NamedTuple):
    """K clusters of one frame in the level frame.

    points: (S, 4) float32 rows x, y, z (m) and height above the local road (m), grouped: cluster k is rows
    offsets[k]:offsets[k + 1]. members: (S,) int32, index of the same points in the frame. offsets: (K + 1,) int32.
    box: (K, 8) float32: centre x, y, z, length, width, height (m), yaw (rad), gap to the road (m).
    """

    points: np.ndarray
    members: np.ndarray
    offsets: np.ndarray
    box: np.ndarray

    @property
    def counts(self) -> np.ndarray:
        """(K,) int32 number of points of each cluster."""
        return np.diff(self.offsets)

    def cluster_id(self, n: int) -> np.ndarray:
        """(N,) int32: the cluster of each point of a frame of n, -1 = none."""
        return of_points(self.members, self.offsets, n)


def of_points(members: np.ndarray, offsets: np.ndarray, n: int) -> np.ndarray:
    """(N,) int32: the cluster of each point of a frame of n, -1 = none; members and offsets of ``ClusterPoints``."""
    of_point = np.full(n, -1, np.int32)
    of_point[members] = np.repeat(np.arange(len(offsets) - 1, dtype=np.int32), np.diff(offsets))
    return of_point


@kernel
def group_by_label(points: np.ndarray, index: np.ndarray, label: np.ndarray, most: int) -> ClusterPoints:
    """Points sorted by label, with the box of each group: a stable counting sort.

    points (M, 4) float32; index, label (M,) int32. Points of label -1 are left out, and labels with more than ``most``
    points.
    """
    count = np.zeros(label.max() + 1 if len(label) else 0, np.int32)
    for i in range(len(label)):
        if label[i] >= 0:
            count[label[i]] += 1
    place, offsets, groups = np.empty(len(count), np.int32), np.zeros(len(count) + 1, np.int32), 0
    for k in range(len(count)):
        place[k] = -1
        if 0 < count[k] <= most:
            place[k] = offsets[groups]
            offsets[groups + 1] = offsets[groups] + count[k]
            groups += 1
    total = offsets[groups]
    grouped, members = np.empty((total, 4), np.float32), np.empty(total, np.int32)
    for i in range(len(label)):
        if label[i] >= 0 and place[label[i]] >= 0:
            to = place[label[i]]
            place[label[i]] += 1
            members[to] = index[i]
            for column in range(4):
                grouped[to, column] = points[i, column]
    offsets = offsets[: groups + 1]
    return ClusterPoints(grouped, members, offsets, fit_boxes(grouped, offsets))


@kernel
def fit_boxes(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(K, 8) float32 boxes of groups of points (S, 4) float32, as in ``ClusterPoints``.

    The length is along the larger principal axis of the footprint.
    """
    box = np.zeros((len(offsets) - 1, 8), np.float32)
    for k in range(len(box)):
        fit_box(points[offsets[k] : offsets[k + 1]], box[k])
    return box


@kernel
def fit_box(points: np.ndarray, box: np.ndarray) -> None:
    """Write the box (8,) float32 of points (n, 4) float32, n > 0."""
    x0, y0, n = points[0, 0], points[0, 1], len(points)
    if n == 1:
        box[:] = 0.0
        box[0], box[1], box[2], box[7] = x0, y0, points[0, 2], points[0, 3]
        return
    c, s = _principal_axis(points)
    u_low = u_high = v_low = v_high = np.float32(0.0)
    z_low = z_high = points[0, 2]
    gap = points[0, 3]
    for i in range(n):
        dx, dy, z = points[i, 0] - x0, points[i, 1] - y0, points[i, 2]
        u, v = c * dx + s * dy, c * dy - s * dx
        u_low, u_high, v_low, v_high = min(u_low, u), max(u_high, u), min(v_low, v), max(v_high, v)
        z_low, z_high, gap = min(z_low, z), max(z_high, z), min(gap, points[i, 3])
    u, v = (u_low + u_high) * np.float32(0.5), (v_low + v_high) * np.float32(0.5)
    box[0], box[1], box[2] = x0 + c * u - s * v, y0 + s * u + c * v, (z_low + z_high) * np.float32(0.5)
    box[3], box[4], box[5] = u_high - u_low, v_high - v_low, z_high - z_low
    box[6], box[7] = math.atan2(s, c), gap


@kernel
def _principal_axis(points: np.ndarray) -> tuple[np.float32, np.float32]:
    """Cosine and sine of the direction of the larger principal axis of a footprint."""
    sx = sy = sxx = sxy = syy = 0.0
    n = len(points)
    for i in range(n):
        dx, dy = np.float64(points[i, 0] - points[0, 0]), np.float64(points[i, 1] - points[0, 1])
        sx, sy = sx + dx, sy + dy
        sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
    difference = (sxx - syy) / n - (sx * sx - sy * sy) / (n * n)
    twice = 2.0 * (sxy / n - sx * sy / (n * n))
    length = math.sqrt(difference * difference + twice * twice)
    if length == 0.0:
        return np.float32(1.0), np.float32(0.0)
    c, s = math.sqrt(max(0.5 + 0.5 * difference / length, 0.0)), math.sqrt(max(0.5 - 0.5 * difference / length, 0.0))
    return np.float32(c), np.float32(s if twice >= 0.0 else -s)


class SizeRules(NamedTuple):
    """How many points a cluster has and how large its box is, in m: at most its height and the diagonal of its
    footprint, at least the height of its top above the road."""

    min_points: int
    max_points: int
    max_height_m: np.float32
    min_top_m: np.float32
    max_diagonal_m: np.float32


def size_rules(config: ClusteringConfig) -> SizeRules:
    """The rules in a configuration."""
    lengths_m = (np.float32(m) for m in (config.max_height_m, config.min_top_m, config.max_diagonal_m))
    return SizeRules(config.min_points, config.max_points, *lengths_m)


@kernel
def join_clusters(clusters: ClusterPoints, group: np.ndarray, rules: SizeRules) -> ClusterPoints:
    """Clusters joined, without those that have no possible size.

    group: (K,) int32, the smallest index of the clusters that each one is joined with.
    """
    following, last = np.full(len(group), -1, np.int32), np.arange(len(group))
    for k in range(len(group)):
        if group[k] != k:
            following[last[group[k]]] = k
            last[group[k]] = k
    total = len(clusters.members)
    points, members = np.empty((total, 4), np.float32), np.empty(total, np.int32)
    offsets, box, number = np.zeros(len(group) + 1, np.int32), clusters.box.copy(), 0
    for first in range(len(group)):
        alone = following[first] < 0
        if group[first] != first or (alone and not _fits(clusters.box[first], _count(clusters, first), rules)):
            continue
        begin, k = np.uint32(offsets[number]), first
        end = begin
        while k >= 0:
            end, k = _append_points(clusters, k, points, members, end), following[k]
        box[number] = clusters.box[first]
        if not alone:
            fit_box(points[begin:end], box[number])
        if alone or _fits(box[number], int(end - begin), rules):
            number += 1
            offsets[number] = end
    end = offsets[number]
    return ClusterPoints(points[:end], members[:end], offsets[: number + 1], box[:number])


@kernel
def _count(clusters: ClusterPoints, k: int) -> int:
    return clusters.offsets[k + 1] - clusters.offsets[k]


@kernel
def _fits(box: np.ndarray, count: int, rules: SizeRules) -> bool:
    """Whether a cluster of ``count`` points with this box (8,) has a possible size."""
    tall, top_m = box[5], box[7] + box[5]
    if count < rules.min_points or count > rules.max_points or tall > rules.max_height_m or top_m < rules.min_top_m:
        return False
    return bool(math.hypot(box[3], box[4]) <= rules.max_diagonal_m)


@kernel
def _append_points(
    clusters: ClusterPoints, k: int, points: np.ndarray, members: np.ndarray, to: np.uint32
) -> np.uint32:
    """Copy the points of cluster k to the rows of points and members from ``to`` on; returns the row after them."""
    for i in range(clusters.offsets[k], clusters.offsets[k + 1]):
        members[to] = clusters.members[i]
        for column in range(4):
            points[to, column] = clusters.points[i, column]
        to += np.uint32(1)
    return to
