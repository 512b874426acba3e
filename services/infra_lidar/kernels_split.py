"""Compiled second looks at clusters, all from the article: trimmed feet, people in a row, things inside things.

Points of cluster k lie together from offsets[k] on; planar (4, T) float32 as in ``kernels_clusters``. What is decided
is written into their labels, and then they are grouped anew, once.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.extremes import low_high, smallest_but
from services.infra_lidar.jit import inner, sum_kernel
from services.infra_lidar.vectors import LANES, lane_max, lane_min, larger, load, select, smaller, splat

BINS = 29  # along the main axis, between 30 edges
GAP_SHARE = 0.2  # a bin with less than this share of the mean is a gap
TRIM_ABOVE_ROAD_M, TRIM_MIN_HEIGHT_M, TRIM_SHARE = 0.25, 0.5, 0.05
FAR_M = np.float32(1e9)


@inner
def second_look(points, offsets, box, good, look, scratch, label):  # type: ignore[no-untyped-def]
    """Label the points of clusters, trimmed, cut and joined as ``look`` says; -1 where ``good`` (K,) int32 is.

    label (T,) int32 is written; scratch (4, T) float32 is overwritten. Returns the number of labels: K and one more for
    each piece, of which some have no points.
    """
    total = clusters = offsets.shape[0] - 1
    most = clusters + label.shape[0] // 20 + 1  # a piece has 20 points
    extent, count = np.zeros((6, most), np.float32), np.zeros(most, np.int64)
    for k in range(clusters):
        first, last = offsets[k], offsets[k + 1]
        mine, z = label[first:last], points[2, first:last]
        mine[:] = good[k]
        if good[k] < 0:
            continue
        foot_m = _foot_m(z, box[k]) if look.trim else -FAR_M
        count[k] = _label_above(z, foot_m, mine)
        for axis in range(3):
            extent[axis, k], extent[3 + axis, k] = _extent_above(points[axis, first:last], z, foot_m)
        if look.split and 150 < count[k] <= 2000 and 1.0 <= extent[5, k] - extent[2, k] <= 2.2:
            n = _keep(points[0, first:last], points[1, first:last], z, mine, scratch)
            total = _split_row(scratch[0, :n], scratch[1, :n], scratch[2, :n], mine, k, total, extent, count)
    if look.engulf:
        _join_engulfed(extent[:, :total], count[:total], label)
    return total


@inner
def _foot_m(z, box):  # type: ignore[no-untyped-def]
    """Up to where the lowest twentieth of a cluster that stands on the road reaches: that is road. As in the article,
    the road is that of the calibration, z = 0."""
    if box[2] - 0.5 * box[5] >= TRIM_ABOVE_ROAD_M or box[5] <= TRIM_MIN_HEIGHT_M:
        return -FAR_M
    return smallest_but(z, int(TRIM_SHARE * len(z)))


@inner
def _label_above(z, limit, label):  # type: ignore[no-untyped-def]
    """The label of points not higher than ``limit`` becomes -1; returns how many are higher."""
    number = np.int32(0)
    for i in range(len(z)):
        number += np.int32(z[i] > limit)
    for i in range(len(z)):
        label[i] = label[i] if z[i] > limit else np.int32(-1)
    return number


@inner
def _extent_above(values, z, limit):  # type: ignore[no-untyped-def]
    """Smallest and largest of the values (n,) float32 of the points higher than ``limit``."""
    n, none = len(z), splat(FAR_M)
    lowest, highest, rest = none, none * np.float32(-1.0), n - n % LANES
    for i in range(0, rest, LANES):
        counts, x = load(z, i) > limit, load(values, i)
        lowest, highest = smaller(lowest, select(counts, x, FAR_M)), larger(highest, select(counts, x, -FAR_M))
    low, high = lane_min(lowest), lane_max(highest)
    for i in range(rest, n):
        if z[i] > limit:
            low, high = min(low, values[i]), max(high, values[i])
    return low, high


@inner
def _keep(x, y, z, label, kept):  # type: ignore[no-untyped-def]
    """Copies of the points that are labelled, planar in ``kept``; returns how many."""
    n, to_x, to_y, to_z = np.uint64(0), kept[0], kept[1], kept[2]
    for i in range(len(label)):
        to_x[n], to_y[n], to_z[n] = x[i], y[i], z[i]
        n += np.uint64(label[i] >= 0)
    return n


@inner
def _split_row(x, y, z, label, own, total, extent, count):  # type: ignore[no-untyped-def]
    """Cut an elongated cluster of a person's height at gaps along its main axis, if the pieces look like people.

    x, y, z (n,) are the points that are labelled ``own``. Rewrites ``label``; pieces get numbers from ``total`` on, and
    their extents are noted. Returns the new total.
    """
    linearity, axis = _main_axis(x, y, z)
    if linearity <= 0.3 or abs(axis[2]) > 0.5:
        return total
    piece = np.empty(len(z), np.int32)
    number = _name_pieces(x, y, z, piece, _pieces(x, y, z, axis, piece), total)
    if len(number) == 0:
        return total
    j = 0
    for i in range(len(label)):
        if label[i] >= 0:
            label[i] = number[piece[j]]
            j += 1
    part, count[own] = np.empty((3, len(z)), np.float32), 0
    for k in range(total, number.max() + 1):
        m = 0
        for i in range(len(z)):
            if number[piece[i]] == k:
                part[0, m], part[1, m], part[2, m] = x[i], y[i], z[i]
                m += 1
        count[k] = m
        for side in range(3):
            extent[side, k], extent[3 + side, k] = low_high(part[side, :m])
    return number.max() + 1


@sum_kernel
def _covariance(x, y, z):  # type: ignore[no-untyped-def]
    """xx, yy, zz, xy, xz, yz of the points."""
    n, x0, y0, z0 = len(x), x[0], y[0], z[0]
    sx = sy = sz = sxx = syy = szz = sxy = sxz = syz = 0.0
    for i in range(n):
        a, b, c = np.float64(x[i] - x0), np.float64(y[i] - y0), np.float64(z[i] - z0)
        sx += a
        sy += b
        sz += c
        sxx += a * a
        syy += b * b
        szz += c * c
        sxy += a * b
        sxz += a * c
        syz += b * c
    mx, my, mz = sx / n, sy / n, sz / n
    return (
        sxx / n - mx * mx,
        syy / n - my * my,
        szz / n - mz * mz,
        sxy / n - mx * my,
        sxz / n - mx * mz,
        syz / n - my * mz,
    )


@inner
def _main_axis(x, y, z):  # type: ignore[no-untyped-def]
    """(linearity (l1 - l2) / (l1 + l2 + l3), unit vector) of the points' covariance.

    Eigenvalues in closed form (Smith, CACM 1961); every column of (A - l2)(A - l3) is along the first eigenvector.
    """
    xx, yy, zz, xy, xz, yz = _covariance(x, y, z)
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = math.sqrt((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0) + 1e-30
    half_det = 0.5 * (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / spread**3
    phi = math.acos(min(1.0, max(-1.0, half_det))) / 3.0
    first, third = 2.0 * spread * math.cos(phi), 2.0 * spread * math.cos(phi + 2.0 * math.pi / 3.0)
    second = -first - third  # all about the mean
    A = np.array([[a, xy, xz], [xy, b, yz], [xz, yz, c]])
    axis, longest = np.array([1.0, 0.0, 0.0]), 0.0
    for j in range(3):
        column = np.zeros(3)
        for i in range(3):
            for k in range(3):
                column[i] += (A[i, k] - (second if i == k else 0.0)) * (A[k, j] - (third if k == j else 0.0))
        length = math.sqrt(column[0] ** 2 + column[1] ** 2 + column[2] ** 2)
        if length > longest:
            axis, longest = column / length, length
    return (first - second) / max(3.0 * mean, 1e-12), axis


@inner
def _pieces(x, y, z, axis, piece):  # type: ignore[no-untyped-def]
    """piece (n,) of each point: cuts in the middle of each run of nearly empty bins. Returns the number of pieces."""
    n = len(piece)
    along = np.empty(n)
    for i in range(n):
        along[i] = axis[0] * x[i] + axis[1] * y[i] + axis[2] * z[i]
    low, high = along.min(), along.max()
    width = (high - low) / BINS
    histogram, cuts = np.zeros(BINS, np.int64), np.empty(BINS)
    for i in range(n):
        histogram[min(int((along[i] - low) / width), BINS - 1)] += 1
    limit = max(GAP_SHARE * n / BINS, 1.0)
    count, first = 0, -1
    for b in range(BINS):
        if histogram[b] < limit:
            first = b if first < 0 else first
        elif first >= 0:
            cuts[count] = low + width * 0.5 * (first + b)
            count += 1
            first = -1
    for i in range(n):
        piece[i] = 0
        for c in range(count):
            piece[i] += np.int32(along[i] > cuts[c])
    return count + 1


@inner
def _name_pieces(x, y, z, piece, pieces, total):  # type: ignore[no-untyped-def]
    """Number of each piece, from ``total`` on: those that look like people get numbers of their own, the rest another
    one, or -1 where it is too small or too large. None where it is not people side by side."""
    number, least, most, people, members = np.full(pieces, -1, np.int32), len(piece), 0, 0, 0
    part = np.empty((3, len(piece)), np.float32)
    for p in range(pieces):
        n = 0
        for i in range(len(piece)):
            if piece[i] == p:
                part[0, n], part[1, n], part[2, n] = x[i], y[i], z[i]
                n += 1
        if _is_person(part[0, :n], part[1, :n], part[2, :n]):
            number[p] = total + people
            people += 1
            members += n
            least, most = min(least, n), max(most, n)
    if people < 2 or least < 0.25 * most:
        return number[:0]
    if 20 <= len(piece) - members <= 1000:
        number[number < 0] = total + people
    return number


@inner
def _is_person(x, y, z):  # type: ignore[no-untyped-def]
    """The article's test of a piece: as tall and as wide as one person, with points all the way up."""
    n = len(z)
    if n < 20 or n > 1000:
        return False
    low, high = low_high(z)
    x0, x1 = low_high(x)
    y0, y1 = low_high(y)
    tall, wide = high - low, np.hypot(x1 - x0, y1 - y0)
    if tall < 0.8 or wide < 0.3 or wide > 1.5 or tall / wide < 0.8:
        return False
    if smallest_but(z, int(0.95 * (n - 1))) - smallest_but(z, int(0.05 * (n - 1))) < 0.3:
        return False
    layers, mean, spread = np.zeros(4), n / 4.0, 0.0
    for h in z:
        layers[min(int((h - low) / tall * 4.0), 3)] += 1.0
    for count in layers:
        spread += (count - mean) ** 2
    return math.sqrt(spread / 4.0) / mean <= 1.5


@inner
def _join_engulfed(extent, count, label):  # type: ignore[no-untyped-def]
    """A cluster whose box lies inside another's, with less than half of its points, joins it: its label changes.

    extent (6, K) float32: smallest and largest x, y, z of each label, count (K,) its points.
    """
    total, joined = len(count), False
    group = np.arange(total)
    for b in range(total):
        x0, x1, most = extent[0, b], extent[3, b], 2 * count[b]
        if count[b] == 0:
            continue
        for a in range(total):
            if (
                (extent[0, a] <= x0) & (extent[3, a] >= x1) and count[a] > most
                and extent[1, a] <= extent[1, b] and extent[4, a] >= extent[4, b]
                and extent[2, a] <= extent[2, b] and extent[5, a] >= extent[5, b]
            ):  # fmt: skip
                group[b] = a
                joined = True
                break
    if not joined:
        return
    for b in range(total):
        while group[group[b]] != group[b]:
            group[b] = group[group[b]]
    for i in range(len(label)):
        if label[i] >= 0:
            label[i] = group[label[i]]
