"""The article's refinements of clusters: feet trimmed, people in a row split at gaps, boxes inside boxes joined.

Only the comparison with the article needs them. Heights are over the calibrated road plane, z = 0, as in the article.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.infra_lidar.clustering.boxes import ClusterPoints, group_by_label
from services.infra_lidar.jit import kernel

BINS = 29  # along the main axis, between 30 edges
GAP_SHARE = 0.2  # a bin with less than this share of the mean is a gap
TRIM_ABOVE_ROAD_M, TRIM_MIN_HEIGHT_M, TRIM_SHARE = 0.25, 0.5, 0.05
MIN_PIECE_POINTS = 20
KTH_BINS = 64  # values are counted in these, and only one of them is sorted
FAR_M = np.float32(1e9)


class Refinements(NamedTuple):
    """trim: leave out the lowest twentieth of what stands on the road. split: cut people in a row at gaps. join: boxes
    inside boxes."""

    trim: bool = True
    split: bool = True
    join: bool = True


ALL = Refinements()


def refine_clusters(clusters: ClusterPoints, options: Refinements = ALL) -> ClusterPoints:
    """Clusters as the article refines them; the gap to the road of a box is its lowest z."""
    points = _with_height(clusters.points)
    label = refined_labels(points, clusters.offsets, clusters.box, options)
    return group_by_label(points, clusters.members, label, len(label))


@kernel
def _with_height(points: np.ndarray) -> np.ndarray:
    """(S, 4) float32: x, y, z and, as height above the road, z again."""
    out = np.empty((len(points), 4), np.float32)
    for i in range(len(points)):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = points[i, 0], points[i, 1], points[i, 2], points[i, 2]
    return out


@kernel
def refined_labels(points: np.ndarray, offsets: np.ndarray, box: np.ndarray, options: Refinements) -> np.ndarray:
    """New cluster (S,) int32 of points (S, 3 or more) float32 of clusters as in ``ClusterPoints``, -1 = left out."""
    total = len(box)
    most = total + len(points) // MIN_PIECE_POINTS + 1
    label, extent = np.empty(len(points), np.int32), np.zeros((most, 6), np.float32)
    count = np.zeros(most, np.int64)
    for k in range(len(box)):
        cluster, mine = points[offsets[k] : offsets[k + 1]], label[offsets[k] : offsets[k + 1]]
        foot_m = _foot_m(cluster[:, 2], box[k]) if options.trim else -FAR_M
        above = _points_above(cluster, foot_m)
        count[k] = len(above)
        for i in range(len(cluster)):
            mine[i] = k if cluster[i, 2] > foot_m else -1
        if count[k] == 0:
            continue
        _extent(above, extent[k])
        if options.split and 150 < count[k] <= 2000 and 1.0 <= extent[k, 5] - extent[k, 2] <= 2.2:
            piece = _split_row(above, total)
            if len(piece) > 0:
                mine[mine == k], count[k] = piece, 0
                for new in range(total, piece.max() + 1):
                    part = above[piece == new]
                    count[new] = len(part)
                    _extent(part, extent[new])
                total = piece.max() + 1
    if options.join:
        _join_engulfed(extent[:total], count[:total], label)
    return label


@kernel
def _points_above(points: np.ndarray, foot_m: float) -> np.ndarray:
    """(n, 3) float32: x, y, z of the points (N, 3 or more) higher than ``foot_m``."""
    above, n = np.empty((len(points), 3), np.float32), 0
    for i in range(len(points)):  # no branch depends on a height, so that the processor need not guess
        above[n, 0], above[n, 1], above[n, 2] = points[i, 0], points[i, 1], points[i, 2]
        n += points[i, 2] > foot_m
    return above[:n]


@kernel
def _foot_m(z: np.ndarray, box: np.ndarray) -> float:
    """Up to where the lowest twentieth of a cluster that stands on the road reaches: that is road."""
    if box[2] - np.float32(0.5) * box[5] >= TRIM_ABOVE_ROAD_M or box[5] <= TRIM_MIN_HEIGHT_M:
        return -FAR_M
    return _kth_smallest(z, int(TRIM_SHARE * len(z)))


@kernel
def _kth_smallest(values: np.ndarray, k: int) -> float:
    """The value (n,) with k others before it in rising order: the values are counted in bins, and one bin is sorted."""
    n, low, high = len(values), values[0], values[0]
    for value in values:
        low, high = min(low, value), max(high, value)
    per_unit = (KTH_BINS - 1) / (high - low) if high - low > 1e-6 else np.float32(0.0)
    number, of_value = np.zeros(KTH_BINS, np.int32), np.empty(n, np.int32)
    for i in range(n):
        of_value[i] = (values[i] - low) * per_unit
        number[of_value[i]] += 1
    b, before = 0, 0
    while before + number[b] <= k:
        before += number[b]
        b += 1
    return np.sort(values[of_value == b])[k - before]


@kernel
def _extent(points: np.ndarray, extent: np.ndarray) -> None:
    """Write smallest x, y, z and largest x, y, z of points (n, 3 or more) to extent (6,)."""
    for axis in range(3):
        extent[axis] = extent[3 + axis] = points[0, axis]
        for i in range(1, len(points)):
            extent[axis] = min(extent[axis], points[i, axis])
            extent[3 + axis] = max(extent[3 + axis], points[i, axis])


@kernel
def _split_row(points: np.ndarray, total: int) -> np.ndarray:
    """New cluster of each of the points (n, 3 or more), numbers from ``total`` on, -1 = left out.

    An elongated cluster of a person's height is cut at gaps along its main axis, if the pieces look like people. Empty
    where it stays whole.
    """
    linearity, axis = _main_axis(points)
    none = np.empty(0, np.int32)
    if linearity <= 0.3 or abs(axis[2]) > 0.5:
        return none
    piece, pieces = _pieces(points, axis)
    number = _piece_numbers(points, piece, pieces, total)
    return number[piece] if len(number) > 0 else none


@kernel
def _main_axis(points: np.ndarray) -> tuple[float, np.ndarray]:
    """Linearity (l1 - l2) / (l1 + l2 + l3) of the points' covariance, and its first eigenvector (3,)."""
    n, x0, y0, z0 = len(points), points[0, 0], points[0, 1], points[0, 2]
    x = y = z = xx = xy = xz = yy = yz = zz = 0.0
    for i in range(n):  # about the first point: sums of large coordinates would lose digits
        a, b, c = points[i, 0] - x0, points[i, 1] - y0, points[i, 2] - z0
        x, y, z = x + a, y + b, z + c
        xx, xy, xz = xx + a * a, xy + a * b, xz + a * c
        yy, yz, zz = yy + b * b, yz + b * c, zz + c * c
    x, y, z = x / n, y / n, z / n
    covariance = np.empty((3, 3))
    covariance[0, 0], covariance[1, 1], covariance[2, 2] = xx / n - x * x, yy / n - y * y, zz / n - z * z
    covariance[0, 1] = covariance[1, 0] = xy / n - x * y
    covariance[0, 2] = covariance[2, 0] = xz / n - x * z
    covariance[1, 2] = covariance[2, 1] = yz / n - y * z
    values, vectors = np.linalg.eigh(covariance)
    return (values[2] - values[1]) / max(values.sum(), 1e-12), vectors[:, 2].copy()


@kernel
def _pieces(points: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, int]:
    """Piece (n,) int32 of each point, cut in the middle of each run of nearly empty bins; and how many there are."""
    n = len(points)
    along = np.empty(n)
    for i in range(n):
        along[i] = axis[0] * points[i, 0] + axis[1] * points[i, 1] + axis[2] * points[i, 2]
    low = along.min()
    width = (along.max() - low) / BINS
    histogram, cuts, count, first = np.zeros(BINS, np.int64), np.empty(BINS), 0, -1
    for i in range(n):
        histogram[min(int((along[i] - low) / width), BINS - 1)] += 1
    limit = max(GAP_SHARE * n / BINS, 1.0)
    for b in range(BINS):
        if histogram[b] < limit:
            first = b if first < 0 else first
        elif first >= 0:
            cuts[count] = low + width * 0.5 * (first + b)
            count, first = count + 1, -1
    piece = np.zeros(n, np.int32)
    for i in range(n):
        for c in range(count):
            piece[i] += along[i] > cuts[c]
    return piece, count + 1


@kernel
def _piece_numbers(points: np.ndarray, piece: np.ndarray, pieces: int, total: int) -> np.ndarray:
    """Number (P,) int32 of each piece, from ``total`` on: those that look like people get one each, the rest another
    one, or -1 where it is too small or too large. Empty where it is not people side by side."""
    number, least, most, people, members = np.full(pieces, -1, np.int32), len(piece), 0, 0, 0
    for p in range(pieces):
        part = points[piece == p]
        if _is_person(part):
            number[p] = total + people
            people, members = people + 1, members + len(part)
            least, most = min(least, len(part)), max(most, len(part))
    if people < 2 or least < 0.25 * most:
        return number[:0]
    if MIN_PIECE_POINTS <= len(piece) - members <= 1000:
        for p in range(pieces):
            number[p] = total + people if number[p] < 0 else number[p]
    return number


@kernel
def _is_person(points: np.ndarray) -> bool:
    """The article's test of a piece: as tall and as wide as one person, with points all the way up."""
    n, z, extent = len(points), points[:, 2], np.empty(6, np.float32)
    if n < MIN_PIECE_POINTS or n > 1000:
        return False
    _extent(points, extent)
    tall, wide = extent[5] - extent[2], np.hypot(extent[3] - extent[0], extent[4] - extent[1])
    if tall < 0.8 or wide < 0.3 or wide > 1.5 or tall / wide < 0.8:
        return False
    if _kth_smallest(z, int(0.95 * (n - 1))) - _kth_smallest(z, int(0.05 * (n - 1))) < 0.3:
        return False
    layers = np.zeros(4)
    for height in z:
        layers[min(int((height - extent[2]) / tall * 4.0), 3)] += 1.0
    return layers.std() / (n / 4.0) <= 1.5


@kernel
def _join_engulfed(extent: np.ndarray, count: np.ndarray, label: np.ndarray) -> None:
    """Give a cluster whose box lies inside another's, with less than half of its points, the other's label.

    extent (K, 6) float32: smallest and largest x, y, z of each label. count (K,): its points.
    """
    group = np.arange(len(count))
    for b in range(len(count)):
        for a in range(len(count)):
            if count[b] == 0 or count[a] <= 2 * count[b]:
                continue
            inside = True
            for axis in range(3):
                inside &= extent[a, axis] <= extent[b, axis] and extent[a, 3 + axis] >= extent[b, 3 + axis]
            if inside:
                group[b] = a
                break
    for b in range(len(count)):
        while group[group[b]] != group[b]:
            group[b] = group[group[b]]
    for i in range(len(label)):
        if label[i] >= 0:
            label[i] = group[label[i]]
