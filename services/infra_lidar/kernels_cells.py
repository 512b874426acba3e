"""Compiled mapping of points to bird's-eye cells that may grow with range."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner, kernel
from services.infra_lidar.vectors import (
    LANES,
    floor,
    fma,
    gather,
    larger,
    load,
    real,
    root,
    smaller,
    splat,
    store,
    whole,
)

STEPS = 1024  # of the table of scales


@kernel
def grid_cells(x, y, cell_m, growth_m, side, row, column):  # type: ignore[no-untyped-def]
    """Cell of each point (N,) float32 on a side x side grid centred on the origin; row, column (N,) int32 written.

    growth_m > 0: radii are compressed by f(r) = g / c * ln(1 + r / g), so that a cell measures c near the sensor and
    c (1 + r / g) along the ray at range r. growth_m = 0: plain squares of cell_m.
    """
    table, per_m = _scale_table(cell_m, growth_m, side)
    n, grows = len(x), growth_m > 0
    rest = n - n % LANES
    for i in range(0, rest, LANES):
        r, c = _cell(load(x, i), load(y, i), table, per_m, grows, side)
        store(row, i, r)
        store(column, i, c)
    if rest < n:
        last, cells = np.zeros((2, LANES), np.float32), np.zeros((2, LANES), np.int32)
        for i in range(rest, n):
            last[0, i - rest], last[1, i - rest] = x[i], y[i]
        r, c = _cell(load(last[0], 0), load(last[1], 0), table, per_m, grows, side)
        store(cells[0], 0, r)
        store(cells[1], 0, c)
        for i in range(rest, n):
            row[i], column[i] = cells[0, i - rest], cells[1, i - rest]


@inline
def _cell(x, y, table, per_m, grows, side):  # type: ignore[no-untyped-def]
    scale = splat(table[0])
    if grows:  # f(r) / r, interpolated
        at = smaller(root(fma(x, x, y * y)) * per_m, np.float32(STEPS - 1))
        k = whole(at)
        low = gather(table, k)
        scale = fma(at - real(k), gather(table, k + 1) - low, low)
    half, last = np.int32(side // 2), np.int32(side - 1)
    row, column = whole(floor(y * scale)) + half, whole(floor(x * scale)) + half
    return smaller(larger(row, 0), last), smaller(larger(column, 0), last)


@inner
def _scale_table(cell_m, growth_m, side):  # type: ignore[no-untyped-def]
    """f(r) / r at STEPS + 1 ranges, to be interpolated: a logarithm per point takes longer than all the rest.

    Also the number of steps per metre. The grid that comes out is a little other than f says (a hundredth of a cell).
    """
    scales = np.full(STEPS + 1, np.float32(1.0) / cell_m, np.float32)
    if growth_m <= 0:
        return scales, np.float32(0.0)
    reach = growth_m * (np.exp(side // 2 * cell_m / growth_m) - 1.0)
    for k in range(1, STEPS + 1):
        r = reach * k / (STEPS - 1)
        scales[k] = growth_m / cell_m * np.log1p(r / growth_m) / r
    return scales, np.float32((STEPS - 1) / reach)


@kernel
def lie_within(drawn, row, column, z, offsets, ground_z, body_m, min_share, within):  # type: ignore[no-untyped-def]
    """within (K,) bool: clusters of which ``min_share`` of the points or more are on the map drawn (2, side, side)
    bool, below and above ``body_m`` over the road, ground_z (K,). Their cells row, column (M,) and z (M,) lie together.
    """
    low, high = drawn[0], drawn[1]
    for k in range(within.shape[0]):
        hits, top = 0, ground_z[k] + body_m
        for i in range(offsets[k], offsets[k + 1]):
            layer = high if z[i] >= top else low
            hits += layer[row[i], column[i]]
        within[k] = hits >= min_share * (offsets[k + 1] - offsets[k])
