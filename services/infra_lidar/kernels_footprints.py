"""Footprints of pieces, seen from above: many of them side by side, and how far they reach along a direction.

A list of pieces, (n,) int32, has room for a vector more behind its end.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner
from services.infra_lidar.vectors import (
    LANES,
    fma,
    gather_listed,
    lane_max,
    lane_min,
    larger,
    load_of_row,
    magnitude,
    smaller,
    splat,
    store,
)

X, Y, COS, SIN, HALF_LENGTH, HALF_WIDTH, TOP, ROWS = range(8)


@inner
def footprints(box):  # type: ignore[no-untyped-def]
    """(ROWS, K) float32 of boxes (K, 8) as measured by ``kernels_clusters.measure``: centre, cosine and sine of the
    yaw, half the length and the width, height of the top above the road."""
    foot = np.empty((ROWS, len(box)), np.float32)
    for k in range(len(box)):
        foot[X, k], foot[Y, k], foot[COS, k], foot[SIN, k] = box[k, 0], box[k, 1], 1.0, 0.0
        foot[HALF_LENGTH, k], foot[HALF_WIDTH, k] = np.float32(0.5) * box[k, 3], np.float32(0.5) * box[k, 4]
        foot[TOP, k] = box[k, 7] + box[k, 5]
        if box[k, 6] != 0.0:  # most pieces are a single return
            foot[COS, k], foot[SIN, k] = np.cos(box[k, 6]), np.sin(box[k, 6])
    return foot


@inner
def side_by_side(foot, listed, n, out):  # type: ignore[no-untyped-def]
    """Copy the footprints of n > 0 listed pieces to out (ROWS, n and a vector or more), the first of them once more
    into what is left of the last vector."""
    store(listed, n, splat(listed[0]))
    for row in range(ROWS):
        values, to = foot[row], out[row]
        for i in range(0, n, LANES):
            store(to, i, gather_listed(values, listed, i))


@inline
def along(pieces, i, c, s):  # type: ignore[no-untyped-def]
    """Extents of the pieces from i on along the direction (c, s), and across it: lowest, highest, and the same."""
    x, y = load_of_row(pieces, X, i), load_of_row(pieces, Y, i)
    own_c, own_s = load_of_row(pieces, COS, i), load_of_row(pieces, SIN, i)
    half_l, half_w = load_of_row(pieces, HALF_LENGTH, i), load_of_row(pieces, HALF_WIDTH, i)
    dot, cross = magnitude(fma(own_c, c, own_s * s)), magnitude(fma(own_c, s, own_s * -c))
    u, v = fma(x, c, y * s), fma(y, c, x * -s)
    half_u, half_v = fma(half_l, dot, half_w * cross), fma(half_l, cross, half_w * dot)
    return u - half_u, u + half_u, v - half_v, v + half_v


@inner
def extent(pieces, n, c, s):  # type: ignore[no-untyped-def]
    """The same of all n pieces together, which are ``side_by_side``."""
    far = splat(np.float32(np.inf))
    u_low, u_high, v_low, v_high = far, far * np.float32(-1.0), far, far * np.float32(-1.0)
    for i in range(0, n, LANES):
        a, b, d, e = along(pieces, i, c, s)
        u_low, u_high, v_low, v_high = smaller(u_low, a), larger(u_high, b), smaller(v_low, d), larger(v_high, e)
    return lane_min(u_low), lane_max(u_high), lane_min(v_low), lane_max(v_high)


@inner
def width_of(foot, k, c, s):  # type: ignore[no-untyped-def]
    """How wide piece k is across the direction (c, s)."""
    dot, cross = foot[COS, k] * c + foot[SIN, k] * s, foot[COS, k] * s - foot[SIN, k] * c
    return np.float32(2.0) * (foot[HALF_LENGTH, k] * abs(cross) + foot[HALF_WIDTH, k] * abs(dot))


@inner
def highest(pieces, n):  # type: ignore[no-untyped-def]
    """The highest top of n pieces side by side."""
    top = load_of_row(pieces, TOP, 0)
    for i in range(LANES, n, LANES):
        top = larger(top, load_of_row(pieces, TOP, i))
    return lane_max(top)
