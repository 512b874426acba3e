"""Compiled connected components of occupied bird's-eye-view cells, by rows of bits and runs of set bits.

A row of cells is a row of 64-bit words. Runs of occupied cells are nodes of a union-find over neighbouring rows
(run-based labelling after He, Chao, Suzuki, 2008); a point finds its run by counting the run starts before its cell.
Time is linear in the points plus the words of the grid.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, kernel
from services.infra_lidar.kernels_cells import grid_cells
from services.infra_lidar.kernels_runs import find_runs
from services.infra_lidar.vectors import LANES, bit_count, first_bit, splat, store

ONE = np.uint64(1)


@inline
def _find(parent, i):  # type: ignore[no-untyped-def]
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def label_points(points, body_m, cell_m, growth_m, two_points, eight, bits, rank, row_start, scratch, label, across):  # type: ignore[no-untyped-def]
    """Component of every point, -1 = none; label (N,) int32 is written. Returns the number of components.

    across (N or more,) int32 is written, too: how many cells of each component lie for certain between two of its
    points, along the axis along which they are more.

    points (4, N or more) float32: x, y, z, height above the road; those lower than ``body_m`` fill the cells.
    two_points: a cell needs two to be occupied; eight: cells that touch at a corner are neighbours. bits (3, side,
    words) uint64, rank (side, words) int32, row_start (side + 1,) int32 and scratch (6, N + 1 or more) int32 are
    overwritten. label and the rows of scratch have room for a vector more.
    """
    n, once, twice, starts = label.shape[0], bits[0], bits[1], bits[2]
    key, begin, parent, first, last = scratch[0, :n], scratch[1], scratch[2], scratch[3], scratch[4]
    grid_cells(points[0, :n], points[1, :n], cell_m, growth_m, once.shape[0], key, scratch[5, :n])
    for i in range(n):
        key[i] = cell_key(key[i], scratch[5, i], once.shape[1], points[3, i] < body_m)
    keys = find_runs(key, begin)
    occupy(key, begin, keys, once, twice)
    occupied = twice if two_points else once
    runs = find_rows(occupied, starts, rank, parent, first, last, row_start)
    join_rows(parent, first, last, row_start, eight)
    components = number_components(parent, runs)
    _measure_across(parent, first, last, row_start, components, across)
    point_labels(key, begin, keys, occupied, starts, rank, parent, label)
    return components


@inline
def cell_key(row, column, words, fills):  # type: ignore[no-untyped-def]
    """Number of a cell's bit among all, rows of ``words`` one after the other, and whether a point fills it."""
    return np.int32(2) * (np.int32(row) * np.int32(64 * words) + np.int32(column)) + np.int32(fills)


@kernel
def occupy(key, begin, keys, once, twice):  # type: ignore[no-untyped-def]
    """Set the bits of cells that one point fills or more, and of those that two fill or more.

    key (N,) int32 by ``cell_key``, equal ones in ``keys`` runs that begin at ``begin``.
    """
    once[:] = 0
    twice[:] = 0
    ones, twos = once.reshape(once.size), twice.reshape(twice.size)
    for r in range(keys):
        k = np.uint32(key[begin[r]])
        at = k >> np.uint32(7)
        bit = np.uint64(k & np.uint32(1)) << np.uint64((k >> np.uint32(1)) & np.uint32(63))
        seen = ones[at]
        more = bit if begin[r + 1] - begin[r] > 1 else seen & bit
        twos[at] |= more  # without branches: nobody can guess which cell comes next
        ones[at] = seen | bit


@kernel
def find_rows(bits, starts, rank, parent, first, last, row_start):  # type: ignore[no-untyped-def]
    """Runs of set bits, row by row. bits (R, W) uint64.

    Writes per word the bits where runs start (``starts``) and the number of runs before it (``rank``), per run its
    first and last column and itself as parent, per row its first run. Returns the number of runs.
    """
    rows, words = bits.shape
    runs, ends = 0, 0
    for r in range(rows):
        row_start[r] = runs
        carry = np.uint64(0)
        for w in range(words):
            word = bits[r, w]
            if word == 0:  # nobody asks for starts and rank there
                carry = word
                continue
            rank[r, w] = runs
            s = word & ~((word << ONE) | carry)
            starts[r, w] = s
            following = bits[r, w + 1] & ONE if w + 1 < words else np.uint64(0)
            e = word & ~((word >> ONE) | (following << np.uint64(63)))
            carry = word >> np.uint64(63)
            while s != 0:
                first[runs] = w * 64 + first_bit(s)
                parent[runs] = runs
                s &= s - ONE
                runs += 1
            while e != 0:  # ends come in the order of the starts, some of them a word later
                last[ends] = w * 64 + first_bit(e)
                e &= e - ONE
                ends += 1
    row_start[rows] = runs
    return runs


@kernel
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


@kernel
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


@kernel
def _measure_across(parent, first, last, row_start, components, across):  # type: ignore[no-untyped-def]
    top, left, right = np.full(components, -1, np.int32), np.empty(components, np.int32), np.empty(components, np.int32)
    for r in range(row_start.shape[0] - 1):
        for i in range(row_start[r], row_start[r + 1]):
            k = parent[i]
            if top[k] < 0:
                top[k], left[k], right[k] = r, first[i], last[i]
            left[k], right[k] = min(left[k], first[i]), max(right[k], last[i])
            across[k] = max(r - top[k], right[k] - left[k]) - 1


@kernel
def point_labels(key, begin, keys, bits, starts, rank, parent, label):  # type: ignore[no-untyped-def]
    """Component of each point's cell, -1 where the cell is not occupied enough; label has room for a vector more."""
    all_bits, all_starts, all_ranks = bits.reshape(bits.size), starts.reshape(starts.size), rank.reshape(rank.size)
    for r in range(keys):
        k = np.uint32(key[begin[r]])
        at = k >> np.uint32(7)
        bit = ONE << np.uint64((k >> np.uint32(1)) & np.uint32(63))
        occupied = (all_bits[at] & bit) != 0
        run = all_ranks[at] + bit_count(all_starts[at] & ((bit - ONE) | bit)) - np.int32(1)
        found = parent[np.uint32(run if occupied else np.int32(0))]  # without a branch: half of them are not, in turns
        found = found if occupied else np.int32(-1)
        for i in range(begin[r], begin[r + 1], LANES):
            store(label, i, splat(found))  # the next run overwrites what is too much
