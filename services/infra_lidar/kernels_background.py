"""Compiled passes of the background model: one look-up per return in (azimuth, ring) order, the order of firing."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner, kernel
from services.infra_lidar.kernels_returns import BLOCK, PI, angle, columns_of, fetch_ahead, whole_block
from services.infra_lidar.vectors import (
    LANES,
    bits,
    fma,
    gather_listed,
    lane_count,
    lane_sum,
    lanes,
    larger,
    load,
    ones,
    prefetch,
    root,
    select,
    smaller,
    splat,
    store,
    store_chosen,
    whole,
)

MODES = 3
FLICKER_SHARE = 0.2  # two ranges that take turns this often are both background; a queue takes turns far less often
USER_SHARE = 0.3  # of its returns that were those of a road user, and what was always there is none of the scene
ROWS_WITHOUT_RINGS, ROWS_PER_RAD = 256, np.float32(256.0)  # 0.22 degrees, for clouds without a ring column
NO_RETURN_M2, FAR_M2 = np.float32(0.25), np.float32(1e8)
LEAST_BITS, LAST_STEP = np.int32(NO_RETURN_M2.view(np.int32)), np.int32(32767)
NO_STEP = np.int32(-1)
STEP_BITS = 15  # two steps, and a flag, fit into a word
ROAD = np.int32(1 << 30)


@inline
def column_of(x, y, columns):  # type: ignore[no-untyped-def]
    """Column of directions (x, y) in the grid."""
    column = smaller(whole((angle(y, x) + PI) * np.float32(columns / (2.0 * np.pi))), np.int32(columns - 1))
    return larger(column, 0)


@inline
def _cell(x, y, z, ring, has_ring, squared, columns, rows):  # type: ignore[no-untyped-def]
    """Cell of returns in (azimuth, ring), or in (azimuth, elevation) where the cloud has no rings."""
    row = whole(ring)
    if not has_ring:
        row = whole(z / root(larger(squared, NO_RETURN_M2)) * ROWS_PER_RAD) + np.int32(rows // 2)
    return column_of(x, y, columns) * np.int32(rows) + smaller(larger(row, 0), np.int32(rows - 1))


@kernel
def locate(points, columns, rows, cell, squared):  # type: ignore[no-untyped-def]
    """cell (N,) int32, -1 = no return, and squared (N,) float32 distance of points (N, 3+) float32; both have room for
    a vector more."""
    n, width = points.shape
    flat = points.reshape(points.size)
    for start in range(0, n, BLOCK):
        source, begin = whole_block(flat, width, start, n)
        for i in range(0, min(BLOCK, n - start), LANES):
            x, y, z, ring = columns_of(source, begin + i * width, width)
            s = fma(x, x, fma(y, y, z * z))
            there = (s > NO_RETURN_M2) & (s < FAR_M2)
            store(cell, start + i, select(there, _cell(x, y, z, ring, width > 4, s, columns, rows), np.int32(-1)))
            store(squared, start + i, s)


@kernel
def learn(cell, squared, user, tolerance, slope, low, high, count, used, newest, switches):  # type: ignore[no-untyped-def]
    """Add a frame, as ``locate`` says it, to the ranges seen per cell. low, high (cells, MODES) float32 m, count and
    used (cells, MODES) uint16: how often, and how often by a road user, as ``user`` (N,) bool says.

    A range within tolerance + slope * range of a mode widens it; otherwise it takes the rarest mode's place.
    newest (cells,) uint8 is the mode last seen, switches (cells,) uint16 counts how often that changed.
    """
    for i in range(cell.shape[0]):
        c = cell[i]
        if c < 0:
            continue
        r = np.sqrt(squared[i])
        margin = tolerance + slope * r
        rarest, taken = 0, -1
        for m in range(MODES):
            if count[c, m] > 0 and low[c, m] - margin <= r <= high[c, m] + margin:
                taken = m
                break
            if count[c, m] < count[c, rarest]:
                rarest = m
        if taken >= 0:
            low[c, taken], high[c, taken] = min(low[c, taken], r), max(high[c, taken], r)
            count[c, taken] = min(count[c, taken] + 1, 65535)
        else:
            low[c, rarest], high[c, rarest], count[c, rarest], used[c, rarest] = r, r, 1, 0
            taken = rarest
        used[c, taken] = min(used[c, taken] + user[i], 65535)
        switches[c] += newest[c] != taken
        newest[c] = taken


@kernel
def settle(  # type: ignore[no-untyped-def]
    low, high, count, used, switches, frames, columns, rows, min_share, tolerance, slope, bounds, users
):
    """What was always there, as two squared intervals of range per cell: bounds (cells, 4) float32.

    A range is background if nearly all returns of the cell came from it and none from behind it: what was sometimes
    seen through, as a car at a red light, is not. Where two ranges take turns from frame to frame (an edge, leaves),
    both are. A second interval left free is that of a neighbour in azimuth. users (cells,) bool: what was always there
    was often a road user, which may have parked there.
    """
    cells = columns * rows
    chosen = np.full((cells, 2), -1, np.int8)
    for c in range(cells):
        _choose(low[c], high[c], count[c], switches[c], frames, min_share, chosen[c])
        users[c] = False
        for k in range(2):
            m = chosen[c, k]
            users[c] |= m >= 0 and used[c, m] > USER_SHARE * count[c, m]
    for c in range(cells):
        bounds[c, 0], bounds[c, 1], bounds[c, 2], bounds[c, 3] = 1.0, 0.0, 1.0, 0.0  # empty intervals
        for k in range(2):
            if chosen[c, k] >= 0:
                _set(bounds, c, 2 * k, low[c, chosen[c, k]], high[c, chosen[c, k]], tolerance, slope)
        if chosen[c, 1] >= 0:
            continue
        for side in (-1, 1):
            n = (c // rows + side) % columns * rows + c % rows
            if chosen[n, 0] < 0:
                continue
            near, far = low[n, chosen[n, 0]], high[n, chosen[n, 0]]
            own = chosen[c, 0]
            if own < 0 or far > high[c, own] + tolerance or near < low[c, own] - tolerance:
                _set(bounds, c, 2, near, far, tolerance, slope)


@inner
def _choose(low, high, count, switches, frames, min_share, chosen):  # type: ignore[no-untyped-def]
    """The one or two modes of a cell that are background, -1 = none."""
    total, best, second, behind = 0, 0, -1, 0
    for m in range(MODES):
        total += count[m]
        best = m if count[m] > count[best] else best
    for m in range(MODES):
        behind += count[m] if low[m] > high[best] else 0
        if m != best and (second < 0 or count[m] > count[second]):
            second = m
    if total < 0.2 * frames:
        return
    if switches >= FLICKER_SHARE * total and count[best] + count[second] >= min_share * total:
        chosen[0] = best
        chosen[1] = second if count[second] >= 0.1 * total else -1
    elif count[best] >= min_share * total and behind <= 0.1 * total:
        chosen[0] = best


@inline
def _set(bounds, c, at, near, far, tolerance, slope):  # type: ignore[no-untyped-def]
    a, b = max(near - tolerance - slope * near, np.float32(0.0)), far + tolerance + slope * far
    bounds[c, at], bounds[c, at + 1] = a * a, b * b


@kernel
def pack(bounds, road, packed):  # type: ignore[no-untyped-def]
    """packed (2, cells) int32 of bounds (cells, 4) float32, two squared intervals, and road (cells,) bool, the
    background there is road: a word for each interval, the flag is in that of the first."""
    for c in range(packed.shape[1]):
        for k in range(2):
            first, last = _step(bounds[c, 2 * k]), _step(bounds[c, 2 * k + 1])
            if bounds[c, 2 * k] > bounds[c, 2 * k + 1]:
                first, last = np.int32(1), np.int32(0)  # nothing lies between one and nought
            packed[k, c] = first | (last << np.int32(STEP_BITS))
        packed[0, c] |= ROAD if road[c] else np.int32(0)


@inner
def _step(squared):  # type: ignore[no-untyped-def]
    """A squared range as one of 32768 steps, each 0.05 % of the range: exponent and ten bits of the float, which are in
    the order of the numbers. What is no number is the last step."""
    step = (np.int32(np.float32(squared).view(np.int32)) - LEAST_BITS) >> np.int32(13)
    return np.int32(min(max(step, 0), LAST_STEP))


@inline
def between(step, word):  # type: ignore[no-untyped-def]
    """Whether steps lie in the interval of a word."""
    return (step >= (word & LAST_STEP)) & (step <= ((word >> STEP_BITS) & LAST_STEP))


@kernel
def sift(points, columns, rows, packed, near_m, source, fresh):  # type: ignore[no-untyped-def]
    """Part returns that were always there from the rest.

    points (N, C) float32 sensor frame; packed (2, cells) int32. Writes of the M others the index to source (N,) and
    x, y, z to fresh (3, N or more); outputs have room for a vector more. Returns (M, returns, returns nearer than
    near_m).
    """
    n, width = points.shape
    flat, near_m2, m = points.reshape(points.size), near_m * near_m, 0
    returns, near = splat(np.int32(0)), splat(np.int32(0))
    fresh_x, fresh_y, fresh_z, one, other = fresh[0], fresh[1], fresh[2], packed[0], packed[1]
    at, step = np.empty(BLOCK + LANES, np.int32), np.empty(BLOCK + LANES, np.int32)
    for start in range(0, n, BLOCK):
        rows_from, begin = whole_block(flat, width, start, n)
        size = min(BLOCK, n - start)
        for i in range(0, size, LANES):
            fetch_ahead(flat, (start + i) * width, width)
            x, y, z, ring = columns_of(rows_from, begin + i * width, width)
            squared = fma(x, x, fma(y, y, z * z))
            there = (squared > NO_RETURN_M2) & (squared < FAR_M2)
            returns += ones(there)
            near += ones(there & (squared < near_m2))
            store(at, i, _cell(x, y, z, ring, width > 4, squared, columns, rows))
            for k in range(0, LANES, 4):  # bring the cells nearer: since the last frame all memory was used for else
                prefetch(one, np.int64(at[np.uint32(i + k)]))
                prefetch(other, np.int64(at[np.uint32(i + k)]))
            store(step, i, select(there, smaller((bits(squared) - LEAST_BITS) >> 13, LAST_STEP), NO_STEP))
        for i in range(0, size, LANES):  # a loop of its own: shorter ones overlap better
            own = load(step, i)
            usual = between(own, gather_listed(one, at, i)) | between(own, gather_listed(other, at, i))
            unusual = (own >= np.int32(0)) & ~usual
            found = lane_count(unusual)
            if found > 0:
                x, y, z, _ = columns_of(rows_from, begin + i * width, width)
                store_chosen(fresh_x, m, x, unusual)
                store_chosen(fresh_y, m, y, unusual)
                store_chosen(fresh_z, m, z, unusual)
                store_chosen(source, m, lanes() + np.int32(start + i), unusual)
                m += found
    return m, lane_sum(returns), lane_sum(near)
