"""Compiled grouping of labelled points: copies that lie together by cluster, and what can be measured of them.

Points are planar, (4, M or more) float32: x, y, z in the level frame and the height above the local road. ``source``
(M,) int32 is their index in the frame.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.extremes import low_high
from services.infra_lidar.jit import inner, sum_kernel
from services.infra_lidar.kernels_runs import find_runs
from services.infra_lidar.vectors import (
    LANES,
    fma,
    lane_max,
    lane_min,
    lane_sum,
    larger,
    load,
    smaller,
    splat,
    store,
)


@inner
def regroup(  # type: ignore[no-untyped-def]
    begin, label, components, fewest, most, across, widest, narrow, enough, points, source, scratch, offsets, shape,
    flat, grouped_source, box,
):  # fmt: skip
    """Copy the points so that those of a label lie together, label by label, and measure each of these clusters.

    begin (R + 1,) int: where runs of points of one label begin; label (R,) int32 in -1 .. components - 1. -1 is left
    out, and so are labels of fewer than ``fewest`` points or more than ``most``, and those that are more than
    ``widest`` cells ``across`` (components,), none = unknown. Of a cluster of more than ``enough`` points so many are
    copied, evenly drawn: they tell its shape; all of one that is at most ``narrow`` cells across. Written: offsets
    (K + 1,), where each cluster begins in grouped_source (T,), the indices of all its points, and shape (K + 1,), where
    it begins in flat, the head of which becomes a (4, S) array of points; box (K, 8), see ``measure``. scratch (2,
    R + 1 and components + 1 or more) int32 has room for a vector more. Returns (K, T, S).
    """
    spans, number = scratch[0], scratch[1]
    begins = spans[: find_runs(label, spans) + 1]  # of runs: those of one label, one behind the other, are one span
    clusters = _number_clusters(
        begin, label, begins, components, fewest, most, across, widest, narrow, enough, number, offsets, shape
    )
    total, copied = offsets[clusters], shape[clusters]
    there = flat[: 4 * copied].reshape(4, copied)
    _arrange(
        begin, label, begins, number, offsets[: clusters + 1], shape[: clusters + 1], points, source, there,
        grouped_source,
    )  # fmt: skip
    measure(there, shape[: clusters + 1], box)
    return clusters, total, copied


@inner
def _number_clusters(  # type: ignore[no-untyped-def]
    begin, label, begins, components, fewest, most, across, widest, narrow, enough, number, offsets, shape
):
    """number (components + 1,): the cluster that label -1, 0, 1 ... becomes, -1 = left out. Returns how many."""
    number[: components + 1] = 0
    for r in range(len(begins) - 1):
        number[np.uint32(label[begins[r]] + 1)] += begin[begins[r + 1]] - begin[begins[r]]
    number[0] = -1
    clusters, total, copied = 0, 0, 0
    for c in range(components):
        count = number[c + 1]
        number[c + 1] = -1
        if max(fewest, 1) <= count <= most and (len(across) == 0 or across[c] <= widest):
            offsets[clusters], shape[clusters] = total, copied
            number[c + 1] = clusters
            clusters += 1
            total += count
            copied += count if len(across) and across[c] <= narrow else min(count, enough)
    offsets[clusters], shape[clusters] = total, copied
    return clusters


@inner
def _arrange(  # type: ignore[no-untyped-def]
    begin, label, begins, number, offsets, shape, points, source, there, there_source
):
    """A stable counting sort by the clusters of labels, span by span."""
    slot, drawn, step = offsets.copy(), np.zeros(len(offsets), np.int64), np.empty(len(offsets), np.int64)
    for k in range(len(offsets) - 1):
        step[k] = (np.int64(offsets[k + 1] - offsets[k]) << 16) // (shape[k + 1] - shape[k])
    for r in range(len(begins) - 1):
        k = number[np.uint32(label[begins[r]] + 1)]
        if k < 0:
            continue
        k = np.uint32(k)
        first = begin[begins[r]]
        n, to = begin[begins[r + 1]] - first, slot[k]
        slot[k] += n
        seen, wanted = to - offsets[k], shape[k + 1] - shape[k]
        if wanted == offsets[k + 1] - offsets[k]:
            _copy(points, source, first, n, there, there_source, shape[k] + seen, to, offsets[k + 1])
        else:
            i, end = 0, offsets[k + 1]
            while i < n and to + i + LANES <= end:
                store(there_source, to + i, load(source, first + i))
                i += LANES
            while i < n:
                there_source[to + i] = source[first + i]
                i += 1
            drawn[k] = _draw(points, first, n, seen, step[k], wanted, there, shape[k], drawn[k])


@inner
def _copy(points, source, first, n, there, there_source, to, source_to, end):  # type: ignore[no-untyped-def]
    """Copy n points (4, N) from ``first`` on to there (4, S) from ``to`` on, and their ``source`` from ``source_to``
    on; nothing else is there yet before ``end``."""
    x, y, z, above = points[0], points[1], points[2], points[3]
    there_x, there_y, there_z, there_above = there[0], there[1], there[2], there[3]
    i, last = 0, end - source_to - LANES
    while i < n and i <= last:  # whole vectors: the next span writes over what is too much
        a, b = first + i, to + i
        store(there_source, source_to + i, load(source, a))
        store(there_x, b, load(x, a))
        store(there_y, b, load(y, a))
        store(there_z, b, load(z, a))
        store(there_above, b, load(above, a))
        i += LANES
    while i < n:
        a, b = np.uint32(first + i), np.uint32(to + i)
        there_source[np.uint32(source_to + i)] = source[a]
        there_x[b], there_y[b], there_z[b], there_above[b] = x[a], y[a], z[a], above[a]
        i += 1


@inner
def _draw(points, first, n, seen, step, wanted, there, to, drawn):  # type: ignore[no-untyped-def]
    """Copy those of n points, from ``first`` on, that are among the ``wanted`` of their cluster: the j-th of these is
    its point j * step / 65536.

    ``seen`` points of it came before, and the ``drawn`` copied ones of them lie from ``to`` on. Returns how many are
    drawn now.
    """
    x, y, z, above = points[0], points[1], points[2], points[3]
    there_x, there_y, there_z, there_above = there[0], there[1], there[2], there[3]
    at = (drawn * step) >> 16
    while drawn < wanted and at < seen + n:
        a, b = np.uint32(first + (at - seen)), np.uint32(to + drawn)
        there_x[b], there_y[b], there_z[b], there_above[b] = x[a], y[a], z[a], above[a]
        drawn += 1
        at = (drawn * step) >> 16
    return drawn


@inner
def _moments(x, y):  # type: ignore[no-untyped-def]
    """Sums of x, y, x x, x y, y y about the first point."""
    n, x0, y0, none = len(x), x[0], y[0], splat(np.float32(0.0))
    sx, sy, sxx, sxy, syy, rest = none, none, none, none, none, n - n % LANES
    for i in range(0, rest, LANES):
        dx, dy = load(x, i) - x0, load(y, i) - y0
        sx, sy = sx + dx, sy + dy
        sxx, sxy, syy = fma(dx, dx, sxx), fma(dx, dy, sxy), fma(dy, dy, syy)
    mx, my, mxx, mxy, myy = lane_sum(sx), lane_sum(sy), lane_sum(sxx), lane_sum(sxy), lane_sum(syy)
    for i in range(rest, n):
        ax, ay = x[i] - x0, y[i] - y0
        mx, my, mxx, mxy, myy = mx + ax, my + ay, mxx + ax * ax, mxy + ax * ay, myy + ay * ay
    return mx, my, mxx, mxy, myy


@inner
def _extents_along(x, y, c, s):  # type: ignore[no-untyped-def]
    """Smallest and largest place along (c, s) and across it, about the first point."""
    n, x0, y0, none = len(x), x[0], y[0], splat(np.float32(0.0))
    u_low, u_high, v_low, v_high, rest = none, none, none, none, n - n % LANES
    for i in range(0, rest, LANES):
        dx, dy = load(x, i) - x0, load(y, i) - y0
        u, v = fma(dx, c, dy * s), fma(dy, c, dx * -s)
        u_low, u_high, v_low, v_high = smaller(u_low, u), larger(u_high, u), smaller(v_low, v), larger(v_high, v)
    u0, u1, v0, v1 = lane_min(u_low), lane_max(u_high), lane_min(v_low), lane_max(v_high)
    for i in range(rest, n):
        bx, by = x[i] - x0, y[i] - y0
        along, across = c * bx + s * by, c * by - s * bx
        u0, u1, v0, v1 = min(u0, along), max(u1, along), min(v0, across), max(v1, across)
    return u0, u1, v0, v1


@inner
def measure(points, offsets, box):  # type: ignore[no-untyped-def]
    """Oriented extents of clusters whose points lie together: cluster k is offsets[k] to offsets[k + 1].

    box (K, 8) float32 is written: centre x, y, z, length, width, height (m, length along the larger principal axis of
    the footprint), yaw (rad), lowest height above the road.
    """
    x, y, z, above = points[0], points[1], points[2], points[3]
    for k in range(offsets.shape[0] - 1):
        first, last = offsets[k], offsets[k + 1]
        if last - first == 1:  # most pieces are a single return
            box[k, 0], box[k, 1], box[k, 2], box[k, 7] = x[first], y[first], z[first], above[first]
            box[k, 3:7] = 0.0
            continue
        measure_one(x[first:last], y[first:last], z[first:last], box[k])
        box[k, 7], _ = low_high(above[first:last])


@inner
def measure_one(x, y, z, box):  # type: ignore[no-untyped-def]
    """The first seven numbers of a cluster's box (8,) from its points, each (n,) float32."""
    n = len(x)
    sx, sy, sxx, sxy, syy = _moments(x, y)
    mx, my = sx / n, sy / n
    cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
    c, s = _principal(cxx - cyy, 2.0 * cxy)
    u0, u1, v0, v1 = _extents_along(x, y, c, s)
    w0, w1 = low_high(z)
    u, v = (u0 + u1) * np.float32(0.5), (v0 + v1) * np.float32(0.5)
    box[0] = x[0] + c * u - s * v
    box[1] = y[0] + s * u + c * v
    box[2] = (w0 + w1) * np.float32(0.5)
    box[3], box[4], box[5] = u1 - u0, v1 - v0, w1 - w0
    box[6] = np.arctan2(s, c)


@inner
def _principal(difference, twice):  # type: ignore[no-untyped-def]
    """Cosine and sine of half the angle of (difference, twice), which is that of the larger principal axis."""
    length = np.sqrt(difference * difference + twice * twice)
    if length == 0.0:
        return np.float32(1.0), np.float32(0.0)
    c, s = np.sqrt(0.5 + 0.5 * difference / length), np.sqrt(max(0.5 - 0.5 * difference / length, 0.0))
    return np.float32(c), np.float32(s if twice >= 0.0 else -s)


@sum_kernel
def means(points, offsets, out):  # type: ignore[no-untyped-def]
    """out (K, 3) float64: the mean of each cluster's points (3 or more, M)."""
    for k in range(out.shape[0]):
        for axis in range(3):
            values = points[axis, offsets[k] : offsets[k + 1]]
            first, total = values[0], np.float64(0.0)
            for i in range(len(values)):
                total += np.float64(values[i] - first)
            out[k, axis] = first + total / len(values)
