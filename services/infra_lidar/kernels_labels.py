"""Compiled connected components of occupied bird's-eye-view cells, by rows of bits and runs of set bits.

A row of cells is a row of 64-bit words. Runs of occupied cells are nodes of a union-find over neighbouring rows
(run-based labelling after He, Chao, Suzuki, 2008); a point finds its run by counting the run starts before its cell.
Time is linear in the points plus the words of the grid.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner
from services.infra_lidar.kernels_cells import cell_keys
from services.infra_lidar.kernels_runs import find_runs
from services.infra_lidar.vectors import bit_count, first_bit

ONE = np.uint64(1)
ONCE, TWICE, STARTS, RANK = 0, 1, 2, 3  # what a word of 64 cells has: layers of the grid, side by side


@inline
def _find(parent, i):  # type: ignore[no-untyped-def]
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@inner
def label_points(  # type: ignore[no-untyped-def]
    points, n, body_m, per_m, growth, two_points, eight, grid, touched, row_start, scratch, begin, label, across
):
    """Components of n points, as runs of points of one cell: begin (n + 1,) int32, where each run begins, and label
    (n,) int32, its component, -1 = none; both have room for so many and a vector more. Returns the numbers of runs and
    components.

    across (n or more,) int32 is written, too: how many cells of each component lie for certain between two of its
    points, along the axis along which they are more.

    points (4, n or more) float32: x, y, z, height above the road; those lower than ``body_m`` fill the cells.
    per_m, growth: as in ``kernels_cells``. two_points: a cell needs two to be occupied; eight: cells that touch at a
    corner are neighbours. grid (side, words, 4) uint64 and touched (side, words of bits of words) uint64 are as this
    function left them, or 0. row_start (side + 1,) int32 and scratch (4, n + 1 or more) int32 are overwritten, scratch
    with room for a vector more in every row.
    """
    key, parent, first, last = scratch[0, :n], scratch[1], scratch[2], scratch[3]
    cell_keys(points, n, body_m, per_m, growth, grid.shape[0], grid.shape[1], key)
    runs = find_runs(key, begin)
    _clear(grid, touched)
    occupy(key, begin, runs, grid, touched, two_points)
    rows = find_rows(grid, touched, TWICE if two_points else ONCE, parent, first, last, row_start)
    join_rows(parent, first, last, row_start, eight)
    components = number_components(parent, rows)
    _measure_across(parent, first, last, row_start, components, across)
    label_runs(key, begin, runs, grid, TWICE if two_points else ONCE, parent, label)
    return runs, components


@inner
def _clear(grid, touched):  # type: ignore[no-untyped-def]
    """Take back what the last frame left."""
    for r in range(touched.shape[0]):
        for t in range(touched.shape[1]):
            while touched[r, t] != 0:
                w = 64 * t + first_bit(touched[r, t])
                grid[r, w, ONCE] = grid[r, w, TWICE] = 0
                touched[r, t] &= touched[r, t] - ONE


@inner
def occupy(key, begin, runs, grid, touched, two_points):  # type: ignore[no-untyped-def]
    """Set the bits of cells that one point fills or more, and of the words that hold any; with ``two_points`` also of
    those that two fill or more.

    key (N,) int32 by ``cell_keys``, equal ones in ``runs`` that begin at ``begin``.
    """
    words, flat = grid.shape[1], grid.reshape(grid.size)
    for r in range(runs):
        k = np.uint32(key[begin[r]])
        at = k >> np.uint32(7)
        bit = np.uint64(k & np.uint32(1)) << np.uint64((k >> np.uint32(1)) & np.uint32(63))
        seen = flat[np.uint32(4) * at + np.uint32(ONCE)]
        if seen == 0:
            row, word = np.uint32(at) // np.uint32(words), np.uint32(at) % np.uint32(words)
            touched[row, word >> np.uint32(6)] |= ONE << np.uint64(word & np.uint32(63))
        if two_points:
            flat[np.uint32(4) * at + np.uint32(TWICE)] |= bit if begin[r + 1] - begin[r] > 1 else seen & bit
        flat[np.uint32(4) * at + np.uint32(ONCE)] = seen | bit


@inner
def find_rows(grid, touched, occupied, parent, first, last, row_start):  # type: ignore[no-untyped-def]
    """Runs of set bits, row by row, of the layer ``occupied`` of the grid.

    Writes per word the bits where runs start and the number of runs before it (layers STARTS and RANK), per run its
    first and last column and itself as parent, per row its first run. Returns the number of runs.
    """
    rows, words = grid.shape[0], grid.shape[1]
    runs, ends = 0, 0
    for r in range(rows):
        row_start[r] = runs
        for t in range(touched.shape[1]):
            left = touched[r, t]
            while left != 0:
                w = 64 * t + first_bit(left)
                left &= left - ONE
                word = grid[r, w, occupied]
                before = grid[r, w - 1, occupied] >> np.uint64(63) if w > 0 else np.uint64(0)
                behind = grid[r, w + 1, occupied] & ONE if w + 1 < words else np.uint64(0)
                s = word & ~((word << ONE) | before)
                e = word & ~((word >> ONE) | (behind << np.uint64(63)))
                grid[r, w, STARTS], grid[r, w, RANK] = s, np.uint64(runs)
                while s != 0:
                    first[runs] = 64 * w + first_bit(s)
                    parent[runs] = runs
                    s &= s - ONE
                    runs += 1
                while e != 0:  # ends come in the order of the starts, some of them a word later
                    last[ends] = 64 * w + first_bit(e)
                    e &= e - ONE
                    ends += 1
    row_start[rows] = runs
    return runs


@inner
def join_rows(parent, first, last, row_start, eight):  # type: ignore[no-untyped-def]
    """Unite runs of neighbouring rows that overlap; with ``eight`` = 1 also those that touch at a corner."""
    for r in range(1, row_start.shape[0] - 1):
        a, b = row_start[r - 1], row_start[r]
        while a < row_start[r] and b < row_start[r + 1]:
            if first[a] <= last[b] + eight and first[b] <= last[a] + eight:
                ra, rb = _find(parent, a), _find(parent, b)
                parent[max(ra, rb)] = min(ra, rb)
            if last[a] < last[b]:
                a += 1
            else:
                b += 1


@inner
def number_components(parent, runs):  # type: ignore[no-untyped-def]
    """Replace each run's parent by its component's number 0..K-1; returns K.

    A root is the smallest run of its component, so its number is known when its other runs come.
    """
    components = 0
    for i in range(runs):
        if parent[i] == i:
            parent[i] = -1 - components  # numbers are stored as negatives until all are known
            components += 1
        else:
            parent[i] = parent[parent[i]]
    for i in range(runs):
        parent[i] = -1 - parent[i]
    return components


@inner
def _measure_across(parent, first, last, row_start, components, across):  # type: ignore[no-untyped-def]
    top, left, right = np.full(components, -1, np.int32), np.empty(components, np.int32), np.empty(components, np.int32)
    for r in range(row_start.shape[0] - 1):
        for i in range(row_start[r], row_start[r + 1]):
            k = parent[i]
            if top[k] < 0:
                top[k], left[k], right[k] = r, first[i], last[i]
            left[k], right[k] = min(left[k], first[i]), max(right[k], last[i])
            across[k] = max(r - top[k], right[k] - left[k]) - 1


@inner
def label_runs(key, begin, runs, grid, occupied, parent, label):  # type: ignore[no-untyped-def]
    """Component of the cell of each run of points, -1 where the cell is not occupied enough."""
    flat = grid.reshape(grid.size)
    for r in range(runs):
        k = np.uint32(key[begin[r]])
        at = np.uint32(4) * (k >> np.uint32(7))
        bit = ONE << np.uint64((k >> np.uint32(1)) & np.uint32(63))
        there = (flat[at + np.uint32(occupied)] & bit) != 0
        upto = bit_count(flat[at + np.uint32(STARTS)] & ((bit - ONE) | bit))
        run = np.int32(flat[at + np.uint32(RANK)]) + upto - np.int32(1)
        found = parent[np.uint32(run if there else np.int32(0))]  # without a branch: half of them are not, in turns
        label[r] = found if there else np.int32(-1)
