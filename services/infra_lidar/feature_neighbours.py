"""How evenly the points of a cluster are spaced: exact nearest neighbours, ``LANES`` points at a time.

A cluster is sorted into cubic cells of about seven points, in rows along its longest axis. Consecutive points of a row
search together, one a lane, in the cells around theirs; the window is widened until for none of them a point outside of
it can be nearer than the fifth found. At the end of every row lie points that are nowhere, so that candidates can be
taken four at a time without asking where the row ends; those taken beyond the window are points like any others.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.extremes import in_turn, low_high
from services.infra_lidar.jit import inline, inner
from services.infra_lidar.vectors import (
    LANES,
    bits,
    fma,
    lane_count,
    lane_sum,
    lanes,
    larger,
    load,
    root,
    smaller,
    splat,
    store,
    unbits,
    whole,
)

NEIGHBOURS = 5
_PER_CELL = 7.0
_TOO_MANY = 3.0 * _PER_CELL  # in an occupied cell: then a finer grid pays
_SHARE_SEEN = 0.55  # of the faces of a cluster's box, by what its points occupy of a grid
_CELLS_PER_POINT = 4
_STEP = 4  # candidates at a time
_NOWHERE_M = np.float32(1e6)
_FAR_M2 = np.float32(1e12)
_NOWHERE_DEPTH_M = np.float32(2e6)  # its square is more than _FAR_M2


def room_for(largest: int) -> tuple[int, int]:
    """Floats of each row of ``work``, and ints of ``start``, for clusters of up to ``largest`` points."""
    return 2 * largest + 64 + 4 * LANES, _CELLS_PER_POINT * largest + 256


@inner
def spacing(cluster, n, work, start, with_median):  # type: ignore[no-untyped-def]
    """Deviation of the mean distance to the five nearest, 0 for up to six points; median distance to the nearest, 0 for
    a single point and where it is not asked for.

    cluster (3, n or more) float32, with room for whole vectors. work (6, room) float32 and start (room,) int32 are
    scratch, as large as ``room_for`` says.
    """
    if n <= 1:
        return 0.0, 0.0
    grid = _sort_into_cells(cluster, n, work[:3], work[3].view(np.int32), start)
    _search_all(work[:3], start, grid, n, work[4], work[5])
    deviation = _deviation(work[4], n) if n > NEIGHBOURS + 1 else 0.0
    return deviation, (np.median(work[5, :n]) if with_median else 0.0)


@inner
def _sort_into_cells(cluster, n, placed, cell, start):  # type: ignore[no-untyped-def]
    """Counting sort into cells, row by row; returns (layers, rows a layer, columns, cell size).

    Afterwards cell i holds placed[:, start[i]:start[i + 1]], relative to the corner of the grid, the longest axis last.
    The last column is none: it holds the points that are nowhere.
    """
    low, size = np.empty(3, np.float32), np.empty(3, np.float32)
    for axis in range(3):
        low[axis], high = low_high(cluster[axis, :n])
        size[axis] = high - low[axis]
    third = np.argmax(size)
    first = np.argmin(size)
    if first == third:  # a cube, or all points in one place
        first = (third + 1) % 3
    second = 3 - first - third
    a, b, c = cluster[first], cluster[second], cluster[third]
    extent = (size[first], size[second], size[third])
    corner = (low[first], low[second], low[third])
    faces = extent[0] * extent[1] + extent[0] * extent[2] + extent[1] * extent[2]
    wanted_m = max(math.sqrt(_PER_CELL * _SHARE_SEEN * faces / n), 1.5 * extent[2] / n, 1e-4)
    grid = _possible_grid(extent, wanted_m, n)
    occupied = _count(a, b, c, n, corner, grid, cell, start)
    if n > _TOO_MANY * occupied:
        grid = _possible_grid(extent, grid[3] * math.sqrt(_PER_CELL * occupied / n), n)
        _count(a, b, c, n, corner, grid, cell, start)
    _place(a, b, c, n, corner, cell, placed, start)
    _end_rows(placed, start, grid)
    return grid


@inner
def _possible_grid(extent, cell_m, n):  # type: ignore[no-untyped-def]
    """Layers, rows, columns and cell size of a grid with cells of ``cell_m``, larger where there is no room for so
    many."""
    while True:
        layers, rows = int(extent[0] / cell_m) + 1, int(extent[1] / cell_m) + 1
        columns = int(extent[2] / cell_m) + 2
        excess = max(
            layers * rows * columns / (_CELLS_PER_POINT * n + 64.0), layers * rows * (_STEP - 1) / (n + 64.0)
        )  # fmt: skip
        if excess <= 1.0:
            return layers, rows, columns, cell_m
        cell_m *= max(excess ** (1.0 / 3.0), 1.03)


@inner
def _count(a, b, c, n, corner, grid, cell, start):  # type: ignore[no-untyped-def]
    """cell (n,) of each point, and where cells begin: that of cell i stands in start[i + 1]. Returns how many cells are
    occupied."""
    layers, rows, columns, cell_m = grid
    per_m, cells = splat(np.float32(1.0 / cell_m)), layers * rows * columns
    for i in range(0, n, LANES):
        layer = smaller(whole((load(a, i) - corner[0]) * per_m), np.int32(layers - 1))
        row = smaller(whole((load(b, i) - corner[1]) * per_m), np.int32(rows - 1))
        column = smaller(whole((load(c, i) - corner[2]) * per_m), np.int32(columns - 2))
        store(cell, i, (layer * np.int32(rows) + row) * np.int32(columns) + column)
    start[: cells + 2] = 0
    quarter = n // 4
    for i in range(n):
        start[np.uint32(cell[in_turn(i, quarter)]) + np.uint32(2)] += 1
    occupied, at, k = 0, np.int32(0), np.uint32(2)
    for _ in range(layers * rows):
        for _ in range(columns - 1):
            occupied += start[k] > 0
            at += start[k]
            start[k] = at
            k += np.uint32(1)
        at += np.int32(_STEP - 1)
        start[k] = at
        k += np.uint32(1)
    return occupied


@inner
def _place(a, b, c, n, corner, cell, placed, start):  # type: ignore[no-untyped-def]
    to_a, to_b, to_c, quarter = placed[0], placed[1], placed[2], n // 4
    for i in range(n):
        j = in_turn(i, quarter)
        k = np.uint32(cell[j]) + np.uint32(1)
        at = np.uint32(start[k])
        to_a[at], to_b[at], to_c[at] = a[j] - corner[0], b[j] - corner[1], c[j] - corner[2]
        start[k] = np.int32(at) + np.int32(1)


@inner
def _end_rows(placed, start, grid):  # type: ignore[no-untyped-def]
    layers, rows, columns, _ = grid
    for row in range(1, layers * rows + 1):
        end = start[row * columns]
        for i in range(end, end + _STEP - 1):
            placed[0, i] = placed[1, i] = placed[2, i] = _NOWHERE_M
        start[row * columns] = end + _STEP - 1


@inner
def _search_all(placed, start, grid, n, mean, nearest):  # type: ignore[no-untyped-def]
    """mean, nearest (n,) float32: distance to the five nearest, and to the nearest, of the points as they are placed.

    All lanes are written: what the spare ones say is overwritten by the next batch, or lies behind the last point.
    """
    a, b, c, done = placed[0], placed[1], placed[2], 0
    layers, rows, columns, cell_m = grid
    per_m = np.float32(1.0 / cell_m)
    for layer in range(layers):
        for row in range(rows):
            at = (layer * rows + row) * columns
            begin, end = start[at], start[at + columns - 1]
            for first in range(begin, end, LANES):
                last = min(first + LANES, end) - 1
                left, right = min(int(c[first] * per_m), columns - 2), min(int(c[last] * per_m), columns - 2)
                x, y, z, used = load(a, first), load(b, first), load(c, first), lanes() <= np.int32(last - first)
                ring, complete = 0, False
                while not complete:
                    ring += 1
                    s1, s2, s3, s4, s5 = _nearest(
                        a, b, c, start, layer, row, left, right, ring, layers, rows, columns, x, y, z
                    )
                    depth = _depth(x, layer - ring, layer + ring, layers, cell_m)
                    depth = smaller(depth, _depth(y, row - ring, row + ring, rows, cell_m))
                    depth = smaller(depth, _depth(z, left - ring, right + ring, columns - 1, cell_m))
                    complete = lane_count(used & (s5 > bits(depth * depth))) == 0
                d1 = root(unbits(s1))
                store(nearest, done, d1)
                store(
                    mean, done,
                    (d1 + root(unbits(s2)) + root(unbits(s3)) + root(unbits(s4)) + root(unbits(s5)))
                    * np.float32(1.0 / NEIGHBOURS),
                )  # fmt: skip
                done += last - first + 1


@inline
def _depth(x, first, last, cells, cell_m):  # type: ignore[no-untyped-def]
    """How far inside of the cells ``first`` to ``last`` of an axis places are; beyond the grid's end is nothing."""
    low, high = splat(-_NOWHERE_DEPTH_M), splat(_NOWHERE_DEPTH_M)
    if first > 0:
        low = splat(np.float32(first * cell_m))
    if last < cells - 1:
        high = splat(np.float32((last + 1) * cell_m))
    return smaller(x - low, high - x) * np.float32(0.999)


@inline
def _nearest(a, b, c, start, layer, row, left, right, ring, layers, rows, columns, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distances of the points x, y, z to the nearest five others, as bits, among those in the cells ``left`` to
    ``right`` of their row and ``ring`` cells around."""
    far = bits(splat(_FAR_M2))
    s0, s1, s2, s3, s4, s5 = far, far, far, far, far, far
    low, high = max(left - ring, 0), min(right + ring, columns - 2) + 1
    for other in range(max(layer - ring, 0), min(layer + ring, layers - 1) + 1):
        for at in range(
            (other * rows + max(row - ring, 0)) * columns, (other * rows + min(row + ring, rows - 1) + 1) * columns,
            columns,
        ):  # fmt: skip
            for j in range(np.uint32(start[at + low]), np.uint32(start[at + high]), np.uint32(_STEP)):
                s0, s1, s2, s3, s4, s5 = _offer(a, b, c, j, x, y, z, s0, s1, s2, s3, s4, s5)
    return s1, s2, s3, s4, s5


@inline
def _squared(a, b, c, j, x, y, z):  # type: ignore[no-untyped-def]
    dx, dy, dz = a[j] - x, b[j] - y, c[j] - z
    return bits(fma(dx, dx, fma(dy, dy, dz * dz)))


@inline
def _offer(a, b, c, j, x, y, z, s0, s1, s2, s3, s4, s5):  # type: ignore[no-untyped-def]
    """Insert the points j to j + 3 into every lane's list, without branches.

    Sort the four, keep the six smallest of ten, sort those (Batcher 1968): the list is rising and the four are falling
    beside it, so the pairwise minima form a bitonic sequence, and three rounds of exchanges put it in order.
    """
    d0, d1 = _squared(a, b, c, j, x, y, z), _squared(a, b, c, j + np.uint32(1), x, y, z)
    d2, d3 = _squared(a, b, c, j + np.uint32(2), x, y, z), _squared(a, b, c, j + np.uint32(3), x, y, z)
    d0, d1 = smaller(d0, d1), larger(d0, d1)
    d2, d3 = smaller(d2, d3), larger(d2, d3)
    d0, d2 = smaller(d0, d2), larger(d0, d2)
    d1, d3 = smaller(d1, d3), larger(d1, d3)
    d1, d2 = smaller(d1, d2), larger(d1, d2)
    s2, s3, s4, s5 = smaller(s2, d3), smaller(s3, d2), smaller(s4, d1), smaller(s5, d0)
    s0, s4 = smaller(s0, s4), larger(s0, s4)
    s1, s5 = smaller(s1, s5), larger(s1, s5)
    s2, s4 = smaller(s2, s4), larger(s2, s4)
    s3, s5 = smaller(s3, s5), larger(s3, s5)
    s0, s1 = smaller(s0, s1), larger(s0, s1)
    s2, s3 = smaller(s2, s3), larger(s2, s3)
    s4, s5 = smaller(s4, s5), larger(s4, s5)
    return s0, s1, s2, s3, s4, s5


@inner
def _deviation(values, n):  # type: ignore[no-untyped-def]
    """Standard deviation of the first n of ``values``, which has room for whole vectors."""
    values[n : n + LANES] = np.float32(0.0)
    added = splat(np.float32(0.0))
    for i in range(0, n, LANES):
        added += load(values, i)
    centre, added = lane_sum(added) / n, splat(np.float32(0.0))
    values[n : n + LANES] = np.float32(centre)
    for i in range(0, n, LANES):
        off = load(values, i) - np.float32(centre)
        added = fma(off, off, added)
    return math.sqrt(lane_sum(added) / n)
