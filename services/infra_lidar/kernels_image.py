"""Compiled passes over range images; see ``range_image.py`` for what they hold."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import kernel
from services.infra_lidar.kernels_background import (
    FAR_M2,
    LAST_STEP,
    LEAST_BITS,
    NO_RETURN_M2,
    between,
    column_of,
)
from services.infra_lidar.vectors import (
    LANES,
    bits,
    fma,
    lane_count,
    lane_sum,
    lanes,
    load,
    ones,
    prefetch,
    smaller,
    splat,
    store,
    store_chosen,
)

AHEAD, LINE = 8, 16  # rows that are fetched before they are read, and numbers that come at once
BEAMS = 128  # at most: so many cells of the background lie side by side for a direction


@kernel
def project(range_m, intensity, cos, sin, bank, beams, points):  # type: ignore[no-untyped-def]
    """Points (R W, 5) of an image."""
    rows, width = range_m.shape
    for row in range(rows):
        c, s = cos[row], sin[row]
        for i in range(width):
            r, k, at = range_m[row, i], bank[row] * width + i, row * width + i
            if r <= 0:
                points[at, 0] = points[at, 1] = points[at, 2] = points[at, 3] = points[at, 4] = 0
                continue
            x, y = r * beams[0, k] + beams[3, k], r * beams[1, k] + beams[4, k]
            points[at, 0], points[at, 1] = c * x - s * y, s * x + c * y
            points[at, 2] = r * beams[2, k] + beams[5, k]
            points[at, 3], points[at, 4] = intensity[row, i], beams[6, k]


@kernel
def project_returns(range_m, intensity, cos, sin, bank, beams, every, points):  # type: ignore[no-untyped-def]
    """The same for the returns of every so many rows alone, one behind the other; returns how many they are."""
    m = 0
    for row in range(0, len(range_m), every):
        project(
            range_m[row : row + 1], intensity[row : row + 1], cos[row : row + 1], sin[row : row + 1],
            bank[row : row + 1], beams, points[m:],
        )  # fmt: skip
        to = m
        for i in range(range_m.shape[1]):
            for column in range(5):
                points[to, column] = points[m + i, column]
            to += range_m[row, i] > 0
        m = to
    return m


@kernel
def locate_rows(cos, sin, bank, width, columns, first):  # type: ignore[no-untyped-def]
    """first (R,) int32, with room for a vector more: the cell of the background of the first range of each row; those
    of the others of the row follow it."""
    n = len(cos)
    for row in range(0, n - n % LANES, LANES):
        beam = load(bank, row) * np.int32(width)
        store(first, row, column_of(load(cos, row), load(sin, row), columns) * np.int32(BEAMS) + beam)
    if n % LANES:
        c, s, k = np.zeros(LANES, np.float32), np.zeros(LANES, np.float32), np.zeros(LANES, np.uint8)
        for row in range(n - n % LANES, n):
            c[row % LANES], s[row % LANES], k[row % LANES] = cos[row], sin[row], bank[row]
        beam = load(k, 0) * np.int32(width)
        store(first, n - n % LANES, column_of(load(c, 0), load(s, 0), columns) * np.int32(BEAMS) + beam)


@kernel
def locate_image(range_m, first, cell, squared):  # type: ignore[no-untyped-def]
    """cell (R W,) int32, -1 = no return, and squared (R W,) float32 range, of all places."""
    rows, width = range_m.shape
    for row in range(rows):
        for i in range(width):
            at, s = row * width + i, range_m[row, i] * range_m[row, i]
            squared[at] = s
            cell[at] = first[row] + i if NO_RETURN_M2 < s < FAR_M2 else -1


@kernel
def sift_image(range_m, cos, sin, bank, beams, columns, packed, near_m, source, fresh):  # type: ignore[no-untyped-def]
    """Part returns that were always there from the rest, as ``kernels_background.sift`` does; a row has a multiple of
    LANES ranges. Returns (M, returns, returns nearer than near_m)."""
    rows, width = range_m.shape
    first = np.empty(rows + LANES, np.int32)
    locate_rows(cos, sin, bank, width, columns, first)
    flat, one, other, near_m2, m = range_m.reshape(range_m.size), packed[0], packed[1], near_m * near_m, 0
    returns, near = splat(np.int32(0)), splat(np.int32(0))
    fresh_x, fresh_y, fresh_z = fresh[0], fresh[1], fresh[2]
    for row in range(rows):
        ahead = np.int64(first[min(row + AHEAD, rows - 1)])
        for i in range(0, width, LINE):  # bring them nearer: since the last frame all memory was used for else
            prefetch(flat, (row + AHEAD) * width + i)
        for i in range(0, width, LANES):
            at, cell = row * width + i, np.int64(first[row]) + i
            r = load(flat, at)
            squared = r * r
            there = (squared > NO_RETURN_M2) & (squared < FAR_M2)
            if lane_count(there) == 0:  # the sky: nothing to compare, and most likely nothing ahead
                continue
            prefetch(one, ahead + i)
            returns += ones(there)
            near += ones(there & (squared < near_m2))
            step = smaller((bits(squared) - LEAST_BITS) >> 13, LAST_STEP)
            unusual = there & ~between(step, load(one, cell))
            if lane_count(unusual) == 0:
                continue
            prefetch(other, ahead + i)
            unusual = unusual & ~between(step, load(other, cell))
            found = lane_count(unusual)
            if found > 0:
                k = np.int64(bank[row]) * width + i
                x, y = fma(r, load(beams[0], k), load(beams[3], k)), fma(r, load(beams[1], k), load(beams[4], k))
                store_chosen(fresh_x, m, x * cos[row] - y * sin[row], unusual)
                store_chosen(fresh_y, m, x * sin[row] + y * cos[row], unusual)
                store_chosen(fresh_z, m, fma(r, load(beams[2], k), load(beams[5], k)), unusual)
                store_chosen(source, m, lanes() + np.int32(at), unusual)
                m += found
    return m, lane_sum(returns), lane_sum(near)
