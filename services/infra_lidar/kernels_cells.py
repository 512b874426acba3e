"""Compiled mapping of points to bird's-eye cells that may grow with range; ``per_m`` and ``growth`` are ``per_m`` and
``growth_per_m`` of a ``CellGrid``.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner, kernel
from services.infra_lidar.vectors import (
    LANES,
    floor,
    fma,
    gather,
    lane_sum,
    lanes,
    larger,
    load,
    ones,
    root,
    select,
    smaller,
    splat,
    store,
    whole,
)

ONE, FOUR = np.float32(1.0), np.float32(4.0)
THIRD, FIFTH, SEVENTH, NINTH = (np.float32(1.0 / odd) for odd in (3, 5, 7, 9))


@inner
def cell_keys(points, n, body_m, per_m, growth, side, words, key):  # type: ignore[no-untyped-def]
    """key (n,) int32 of points (4, n or more) float32, x, y, z and height above the road; both have room for a vector
    more. It is twice the number of the bit of a point's cell on a side x side grid, rows of ``words`` of 64 one after
    the other, and one more if the point is lower than ``body_m``: then it fills the cell."""
    x, y, above = points[0], points[1], points[3]
    for i in range(0, n, LANES):
        row, column = _cell(load(x, i), load(y, i), per_m, growth, side)
        bit = row * np.int32(64 * words) + column
        store(key, i, bit + bit + ones(load(above, i) < body_m))


@inline
def _cell(x, y, per_m, growth, side):  # type: ignore[no-untyped-def]
    scale = splat(per_m)
    if growth > 0:  # ln(1 + u) / u, where ln(1 + u) = 4 artanh((t - 1) / (t + 1)), t the root of 1 + u
        t = root(fma(root(fma(x, x, y * y)), splat(growth), splat(ONE)))
        inverse = splat(ONE) / (t + ONE)
        w = (t - ONE) * inverse
        q = w * w
        series = fma(q, fma(q, fma(q, fma(q, splat(NINTH), splat(SEVENTH)), splat(FIFTH)), splat(THIRD)), splat(ONE))
        scale = scale * FOUR * inverse * inverse * series
    half, last = np.int32(side // 2), np.int32(side - 1)
    row, column = whole(floor(y * scale)) + half, whole(floor(x * scale)) + half
    return smaller(larger(row, 0), last), smaller(larger(column, 0), last)


@kernel
def mark_within(  # type: ignore[no-untyped-def]
    drawn, planar, offsets, ground_z, body_m, per_m, growth, enough, min_share, as_, classes
):
    """Write ``as_`` into classes (K,) for clusters of which ``min_share`` of the points or more are on a map, below and
    above ``body_m`` over the road, ground_z (K,) float32. Of a large cluster hardly more than ``enough`` points are
    asked, evenly drawn.

    drawn (2, side, words) int32: a bit for each cell, the lower ones first. planar (3, M) float32, with room for a
    vector behind it, and offsets (K + 1,): the clusters' points, as in ``ClusterPoints``.
    """
    _, side, words = drawn.shape
    x, y, z, flat = planar[0], planar[1], planar[2], drawn.reshape(drawn.size)
    for k in range(len(classes)):
        first, last = offsets[k], offsets[k + 1]
        top, hits, asked = splat(ground_z[k] + body_m), splat(np.int32(0)), 0
        for i in range(first, last, LANES * (1 + (last - first) // enough)):
            row, column = _cell(load(x, i), load(y, i), per_m, growth, side)
            row += ones(load(z, i) >= top) * np.int32(side)
            word = gather(flat, row * np.int32(words) + (column >> np.int32(5)))
            hit = (word >> (column & np.int32(31))) & np.int32(1)
            hits += select(lanes() < np.int32(last - i), hit, np.int32(0))
            asked += min(LANES, last - i)
        if lane_sum(hits) >= min_share * asked:
            classes[k] = as_
