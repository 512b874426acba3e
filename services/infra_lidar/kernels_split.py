"""Compiled second looks at clusters, all from the article: trimmed feet, people in a row, things inside things."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.extremes import low_high, ordered, smallest_but, unordered
from services.infra_lidar.jit import inline, kernel

BINS = 30  # edges along the main axis
GAP_SHARE = 0.2  # a bin with less than this share of the mean is a gap
TRIM_ABOVE_ROAD_M, TRIM_MIN_HEIGHT_M, TRIM_SHARE = 0.25, 0.5, 0.05


@kernel
def trim_feet(z, box, offsets, label):  # type: ignore[no-untyped-def]
    """Take the lowest twentieth off clusters that stand on the road: it is road. Their label becomes -1.

    Clusters whose points are labelled -1 already are left alone.

    Points of cluster k lie together from offsets[k] on. As in the article the road is that of the calibration, z = 0.
    """
    for k in range(offsets.shape[0] - 1):
        first, last = offsets[k], offsets[k + 1]
        dropped = label[first] < 0
        if dropped or box[k, 2] - 0.5 * box[k, 5] >= TRIM_ABOVE_ROAD_M or box[k, 5] <= TRIM_MIN_HEIGHT_M:
            continue
        limit = smallest_but(z[first:last], int(TRIM_SHARE * (last - first)))
        _drop_low(z[first:last], limit, label[first:last])


@kernel
def _drop_low(z, limit, label):  # type: ignore[no-untyped-def]
    for i in range(len(z)):
        label[i] = label[i] if z[i] > limit else np.int32(-1)


@inline
def _low_percentile(values, share):  # type: ignore[no-untyped-def]
    k = int(share * (len(values) - 1))
    return np.partition(values, k)[k]


@kernel
def _is_person(x, y, z, members):  # type: ignore[no-untyped-def]
    """The article's test of a piece: as tall and as wide as one person, with points all the way up."""
    n = len(members)
    if n < 20 or n > 1000:
        return False
    heights = z[members]
    low, high = heights.min(), heights.max()
    tall = high - low
    wide = np.hypot(x[members].max() - x[members].min(), y[members].max() - y[members].min())
    if tall < 0.8 or wide < 0.3 or wide > 1.5 or tall / wide < 0.8:
        return False
    if _low_percentile(heights, 0.95) - _low_percentile(heights, 0.05) < 0.3:
        return False
    layers = np.zeros(4)
    for h in heights:
        layers[min(int((h - low) / tall * 4.0), 3)] += 1.0
    mean = n / 4.0
    spread = 0.0
    for share in layers:
        spread += (share - mean) ** 2
    return np.sqrt(spread / 4.0) / mean <= 1.5


@kernel
def _main_axis(x, y, z, members):  # type: ignore[no-untyped-def]
    """(linearity (l1 - l2) / (l1 + l2 + l3), unit vector) of the points."""
    n = len(members)
    points = np.empty((n, 3))
    for j in range(n):
        i = members[j]
        points[j, 0], points[j, 1], points[j, 2] = x[i], y[i], z[i]
    for axis in range(3):
        points[:, axis] -= points[:, axis].mean()
    values, vectors = np.linalg.eigh(points.T @ points / n)
    axis = np.ascontiguousarray(vectors[:, 2])
    return (values[2] - values[1]) / max(values.sum(), 1e-12), axis, points @ axis


@kernel
def split_rows(x, y, z, offsets, label):  # type: ignore[no-untyped-def]
    """Cut elongated clusters of a person's height at gaps along their main axis, if the pieces look like people.

    Points of cluster k lie together from offsets[k] on; those of label -1 (trimmed) do not count. Rewrites ``label``;
    pieces get numbers from K on. Returns the number of labels.
    """
    total = offsets.shape[0] - 1
    for k in range(offsets.shape[0] - 1):
        first, last = offsets[k], offsets[k + 1]
        if last - first <= 150 or not _is_row(z[first:last], label[first:last]):
            continue
        members = np.arange(first, last)
        members = members[label[members] >= 0]
        linearity, axis, along = _main_axis(x, y, z, members)
        if linearity > 0.3 and abs(axis[2]) <= 0.5:
            total = _split(x, y, z, members, _pieces(along), label, total)
    return total


@kernel
def _is_row(z, label):  # type: ignore[no-untyped-def]
    """Number and height of the points that were not trimmed are those of some people side by side."""
    number, none_low, none_high = np.int32(0), np.int32(2**31 - 1), np.int32(-(2**31) + 1)
    low, high = none_low, none_high
    for i in range(len(z)):
        number += np.int32(label[i] >= 0)
    for i in range(len(z)):
        low = np.int32(min(low, ordered(z[i]) if label[i] >= 0 else none_low))
    for i in range(len(z)):
        high = np.int32(max(high, ordered(z[i]) if label[i] >= 0 else none_high))
    return 150 < number <= 2000 and 1.0 <= unordered(high) - unordered(low) <= 2.2


@kernel
def _split(x, y, z, members, piece, label, total):  # type: ignore[no-untyped-def]
    """Give the pieces that look like people numbers of their own, and the rest another; returns the new total."""
    pieces = piece.max() + 1
    counts = np.zeros(pieces, np.int64)
    for p in range(pieces):
        part = members[piece == p]
        if _is_person(x, y, z, part):
            counts[p] = len(part)
    people = counts[counts > 0]
    if len(people) < 2 or people.min() < 0.25 * people.max():
        return total
    leftover = len(members) - people.sum()
    rest = total + len(people) if 20 <= leftover <= 1000 else -1
    number = np.full(pieces, rest)
    for p in range(pieces):
        if counts[p] > 0:
            number[p] = total
            total += 1
    for j in range(len(members)):
        label[members[j]] = number[piece[j]]
    return total + (rest >= 0)


@kernel
def _pieces(along):  # type: ignore[no-untyped-def]
    """(n,) number of the piece of each point: cuts in the middle of each run of nearly empty bins."""
    low, high = along.min(), along.max()
    width = (high - low) / (BINS - 1)
    histogram = np.zeros(BINS - 1, np.int64)
    for a in along:
        histogram[min(int((a - low) / width), BINS - 2)] += 1
    limit = max(GAP_SHARE * len(along) / (BINS - 1), 1.0)
    cuts = np.empty(BINS)
    count, first = 0, -1
    for b in range(BINS - 1):
        if histogram[b] < limit:
            first = b if first < 0 else first
        elif first >= 0:
            cuts[count] = low + width * 0.5 * (first + b)
            count += 1
            first = -1
    return np.searchsorted(cuts[:count], along)


@kernel
def join_engulfed(x, y, z, offsets, group):  # type: ignore[no-untyped-def]
    """A cluster whose box lies inside another's, with less than half of its points, joins it. group (K,) is written."""
    total = offsets.shape[0] - 1
    box = np.empty((total, 6), np.float32)
    for k in range(total):
        first, last = offsets[k], offsets[k + 1]
        box[k, 0], box[k, 3] = low_high(x[first:last])
        box[k, 1], box[k, 4] = low_high(y[first:last])
        box[k, 2], box[k, 5] = low_high(z[first:last])
    for b in range(total):
        group[b] = b
        for a in range(total):
            if a == b or (offsets[b + 1] - offsets[b]) >= 0.5 * (offsets[a + 1] - offsets[a]):
                continue
            if (
                (box[b, 0] >= box[a, 0]) & (box[b, 1] >= box[a, 1]) & (box[b, 2] >= box[a, 2])
                & (box[b, 3] <= box[a, 3]) & (box[b, 4] <= box[a, 4]) & (box[b, 5] <= box[a, 5])
            ):  # fmt: skip
                group[b] = a
                break
    for b in range(total):
        while group[group[b]] != group[b]:
            group[b] = group[group[b]]
