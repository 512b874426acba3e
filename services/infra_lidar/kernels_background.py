"""Compiled passes of the background model: one look-up per return in (azimuth, ring) order, the order of firing."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, kernel
from services.infra_lidar.kernels_ground import count_returns
from services.infra_lidar.kernels_rows import copy_picked, pick_flagged, planar, shift_picked

BLOCK = 1024
MODES = 3
FLICKER_SHARE = 0.2  # two ranges that take turns this often are both background; a queue takes turns far less often
ROWS_WITHOUT_RINGS, ROWS_PER_RAD = 256, np.float32(256.0)  # 0.22 degrees, for clouds without a ring column
NO_RETURN_M2 = np.float32(0.25)
LEAST_BITS, LAST_STEP = np.int32(NO_RETURN_M2.view(np.int32)), 32767
PI, HALF_PI = np.float32(np.pi), np.float32(np.pi / 2)


@inline
def _angle(y, x):  # type: ignore[no-untyped-def]
    """As in ``kernels_ground``: kept here because the cache on disk does not notice changes in other modules."""
    ax, ay = abs(x), abs(y)
    high, low = max(ax, ay), min(ax, ay)
    a = low / max(high, np.float32(1e-20))
    s = a * a
    p = np.float32(-0.0117212) * s + np.float32(0.05265332)
    p = p * s - np.float32(0.11643287)
    p = p * s + np.float32(0.19354346)
    p = p * s - np.float32(0.33262347)
    p = (p * s + np.float32(0.99997726)) * a
    p = HALF_PI - p if ay > ax else p
    p = PI - p if x < np.float32(0.0) else p
    return -p if y < np.float32(0.0) else p


@inline
def _row(points, i, rows, squared):  # type: ignore[no-untyped-def]
    """Ring of a point, or its elevation in steps where the cloud has no rings."""
    if points.shape[1] > 4:
        return min(max(np.int32(points[i, 4]), 0), rows - 1)
    sine = points[i, 2] / np.sqrt(max(squared, NO_RETURN_M2))
    return min(max(np.int32(sine * ROWS_PER_RAD) + rows // 2, 0), rows - 1)


@kernel
def learn(points, columns, rows, tolerance, slope, low, high, count, newest, switches):  # type: ignore[no-untyped-def]
    """Add a frame to the ranges seen per cell. low, high (cells, MODES) float32 m and count (cells, MODES) uint16.

    A range within tolerance + slope * range of a mode widens it; otherwise it takes the rarest mode's place.
    newest (cells,) uint8 is the mode last seen, switches (cells,) uint16 counts how often that changed.
    """
    per_column = np.float32(columns / (2.0 * np.pi))
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        squared = x * x + y * y + z * z
        if not squared > NO_RETURN_M2:
            continue
        column = min(np.int32((_angle(y, x) + PI) * per_column), columns - 1)
        c = column * rows + _row(points, i, rows, squared)
        r = np.sqrt(squared)
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
            low[c, rarest], high[c, rarest], count[c, rarest] = r, r, 1
            taken = rarest
        switches[c] += newest[c] != taken
        newest[c] = taken


@kernel
def settle(low, high, count, switches, frames, columns, rows, min_share, tolerance, slope, bounds):  # type: ignore[no-untyped-def]
    """What was always there, as two squared intervals of range per cell: bounds (cells, 4) float32.

    A range is background if nearly all returns of the cell came from it and none from behind it: what was sometimes
    seen through, as a car at a red light, is not. Where two ranges take turns from frame to frame (an edge, leaves),
    both are. A second interval left free is that of a neighbour in azimuth. Returns the number of known cells.
    """
    cells = columns * rows
    chosen = np.full((cells, 2), -1, np.int8)
    known = 0
    for c in range(cells):
        _choose(low[c], high[c], count[c], switches[c], frames, min_share, chosen[c])
        known += chosen[c, 0] >= 0
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
    return known


@kernel
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
def mark_cells(points, columns, rows, chosen, value, table):  # type: ignore[no-untyped-def]
    """table[cell of point i] = value for the chosen points. chosen (N,) bool, table (cells,) uint8."""
    per_column = np.float32(columns / (2.0 * np.pi))
    for i in range(points.shape[0]):
        if chosen[i]:
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            column = min(np.int32((_angle(y, x) + PI) * per_column), columns - 1)
            table[column * rows + _row(points, i, rows, x * x + y * y + z * z)] = value


@inline
def _step(squared):  # type: ignore[no-untyped-def]
    """A squared range as one of 32768 steps, each 0.05 % of the range: exponent and ten bits of the float, which are in
    the order of the numbers. What is no number is the last step."""
    bits = np.int32(np.float32(squared).view(np.int32))
    return min(max((bits - LEAST_BITS) >> np.int32(13), np.int32(0)), np.int32(LAST_STEP))


@kernel
def pack(bounds, road, packed):  # type: ignore[no-untyped-def]
    """packed (cells,) uint64 of bounds (cells, 4) float32, two squared intervals, and road (cells,) uint8, 1 = the
    background there is road: one look-up of eight bytes per return instead of five."""
    for c in range(packed.shape[0]):
        word = np.uint64(road[c]) << np.uint64(60)
        for k in range(4):
            step = np.uint64(_step(bounds[c, k]))
            if bounds[c, k - k % 2] > bounds[c, k - k % 2 + 1]:
                step = np.uint64(1 - k % 2)  # nothing lies between one and nought
            word |= step << np.uint64(15 * k)
        packed[c] = word


@kernel
def sift(points, columns, rows, packed, near_m, scratch, cell, word, keep, pick, known, ground, source, fresh):  # type: ignore[no-untyped-def]
    """Part returns that were always there from the rest.

    points (N, C) float32 sensor frame; packed (cells,) uint64. Writes known and ground (N,) bool, and of the M others
    the index to source (N,) and x, y, z to fresh (3, N or more). Returns (M, returns, returns nearer than near_m).
    scratch (5, BLOCK) float32, cell (BLOCK,) uint32, word (BLOCK,) uint64, keep (BLOCK,) uint8 and pick (BLOCK + 8,)
    int32 are overwritten.
    """
    n, words, sensor = points.shape[0], keep.view(np.uint64), scratch[:4]
    m, returns, near, near2 = 0, 0, 0, near_m * near_m
    for start in range(0, n, BLOCK):
        stop = min(start + BLOCK, n)
        size = stop - start
        planar(points, start, size, sensor)
        x, y, z, squared, at = sensor[0, :size], sensor[1, :size], sensor[2, :size], scratch[4, :size], cell[:size]
        _cells(x, y, z, sensor[3, :size], points.shape[1] > 4, columns, rows, squared, at)
        block_returns, block_near = count_returns(squared, near2)
        returns += block_returns
        near += block_near
        keep[size:] = 0
        _recognise(squared, at, packed, word, known[start:stop], ground[start:stop], keep)
        picked = pick[: pick_flagged(keep, words, size, pick)]
        last = m + len(picked)
        shift_picked(picked, start, source[m:last])
        for k, values in enumerate((x, y, z)):
            copy_picked(values, picked, fresh[k, m:last])
        m = last
    return m, returns, near


@kernel
def _cells(x, y, z, ring, has_ring, columns, rows, squared, cell):  # type: ignore[no-untyped-def]
    """Squared distance and cell of the points of a block."""
    per_column, last, many = np.float32(columns / (2.0 * np.pi)), np.int32(columns - 1), np.int32(rows)
    for i in range(len(x)):
        squared[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i]
    for i in range(len(x)):
        column = min(np.int32((_angle(y[i], x[i]) + PI) * per_column), last)
        cell[i] = np.uint32(max(column, np.int32(0)) * many)
    if has_ring:
        for i in range(len(x)):
            cell[i] += np.uint32(min(max(np.int32(ring[i]), np.int32(0)), many - np.int32(1)))
    else:
        for i in range(len(x)):
            step = np.int32(z[i] / np.sqrt(max(squared[i], NO_RETURN_M2)) * ROWS_PER_RAD) + many // np.int32(2)
            cell[i] += np.uint32(min(max(step, np.int32(0)), many - np.int32(1)))


@kernel
def _recognise(squared, cell, packed, word, known, ground, keep):  # type: ignore[no-untyped-def]
    """known: the range lies in one of the two intervals of its cell, or nothing came back; ground: of the road; keep:
    not known. ``cell`` becomes the step of the range."""
    n, mask = len(squared), np.uint64(LAST_STEP)
    for i in range(n):
        word[i] = packed[cell[i]]
    for i in range(n):
        cell[i] = np.uint32(_step(squared[i]))
    for i in range(n):
        step = np.uint64(cell[i])
        first = (step >= (word[i] & mask)) & (step <= ((word[i] >> np.uint64(15)) & mask))
        second = (step >= ((word[i] >> np.uint64(30)) & mask)) & (step <= ((word[i] >> np.uint64(45)) & mask))
        keep[i] = np.uint8(first | second) | np.uint8(((word[i] >> np.uint64(60)) & np.uint64(1)) << np.uint64(1))
    for i in range(n):
        ground[i] = (keep[i] == 3) & (squared[i] > NO_RETURN_M2)
    for i in range(n):
        known[i] = ((keep[i] & 1) == 1) | (not squared[i] > NO_RETURN_M2)
    for i in range(n):
        keep[i] = not known[i]
