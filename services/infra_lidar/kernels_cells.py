"""Compiled mapping of points to bird's-eye cells that may grow with range."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import kernel

BLOCK = 1024
STEPS = 1024  # of the table of scales


@kernel
def grid_cells(x, y, cell_m, growth_m, side, row, column):  # type: ignore[no-untyped-def]
    """Cell of each point (N,) float32 on a side x side grid centred on the origin; row, column (N,) int32 written.

    growth_m > 0: radii are compressed by f(r) = g / c * ln(1 + r / g), so that a cell measures c near the sensor and
    c (1 + r / g) along the ray at range r. growth_m = 0: plain squares of cell_m.
    """
    half, last = np.int32(side // 2), np.int32(side - 1)
    table, per_m = _scale_table(cell_m, growth_m, side)
    scale = np.full(BLOCK, np.float32(1.0) / cell_m, np.float32)
    for start in range(0, x.shape[0], BLOCK):
        stop = min(start + BLOCK, x.shape[0])
        here = scale[: stop - start]
        if growth_m > 0:
            _scales(x[start:stop], y[start:stop], table, per_m, here)
        _cells_along(x[start:stop], here, half, last, column[start:stop])
        _cells_along(y[start:stop], here, half, last, row[start:stop])


@kernel
def _cells_along(values, scale, half, last, cell):  # type: ignore[no-untyped-def]
    for i in range(values.shape[0]):
        cell[i] = min(max(np.int32(np.floor(values[i] * scale[i])) + half, np.int32(0)), last)


@kernel
def _scales(x, y, table, per_m, scale):  # type: ignore[no-untyped-def]
    """f(r) / r of each point, interpolated."""
    top = np.float32(STEPS - 1)
    for i in range(x.shape[0]):
        at = min(np.sqrt(x[i] * x[i] + y[i] * y[i]) * per_m, top)
        k = np.int32(at)
        low = table[np.uint32(k)]
        scale[i] = low + (at - np.float32(k)) * (table[np.uint32(k) + np.uint32(1)] - low)


@kernel
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
