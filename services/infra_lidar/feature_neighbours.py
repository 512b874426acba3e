"""How evenly the points of a cluster are spaced: exact nearest neighbours, 16 at a time.

A cluster is sorted into the cells of a grid over its two longest axes, about three points a cell. Up to 16 consecutive
points of a row of cells then search together, one per SIMD lane, in a window of cells that is widened until no point
outside can be nearer than the fifth found.

The small functions are compiled into ``_all_clusters`` (``inline``): as calls they would cost more than what they do,
and the lists of the lanes would not stay in registers.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from services.infra_lidar.extremes import low_high

NEIGHBOURS = 5
_LANES = 16
_SLOTS = NEIGHBOURS + 1  # the point itself comes first
_QUERY = _SLOTS * _LANES  # where the coordinates begin in the buffer of the lanes
_PER_CELL = 3.0
_FAR = np.float32(1e12)
_jit = njit(nogil=True, cache=True, error_model="numpy")
_inline = njit(nogil=True, cache=True, error_model="numpy", inline="always")
_fast = njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "nnan"})


def neighbour_features(
    planar: np.ndarray, offsets: np.ndarray, with_median: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Spacing inside K clusters of the points ``planar`` (3, M) float32.

    Returns:
        nn_dist_std (K,) float32: deviation of the mean distance to the five nearest, 0 for up to six points;
        nn_median (K,) float32: median distance to the nearest, 0 for a single point
        and where it is not asked for.
    """
    out = np.zeros((2, len(offsets) - 1), np.float32)
    largest = int(np.diff(offsets).max(initial=1))
    scratch = np.empty((5, largest + _LANES), np.float32)
    _all_clusters(planar, offsets, scratch, np.empty(3 * largest + 64, np.int32), with_median, out)
    return out[0], out[1]


@_inline
def _load(a, b, c, first, last, lanes):  # type: ignore[no-untyped-def]
    """Begin a search for the points first..last: empty lists, their coordinates; spare lanes repeat the last point."""
    for lane in range(_QUERY):
        lanes[lane] = _FAR
    for lane in range(_LANES):
        i = min(first + lane, last)
        lanes[_QUERY + lane], lanes[_QUERY + _LANES + lane], lanes[_QUERY + 2 * _LANES + lane] = a[i], b[i], c[i]


@_inline
def _offer_one(pa, pb, pc, lanes):  # type: ignore[no-untyped-def]
    """Insert a point into every lane's sorted list of squared distances, without branches."""
    for lane in range(_LANES):
        da = lanes[_QUERY + lane] - pa
        db = lanes[_QUERY + _LANES + lane] - pb
        dc = lanes[_QUERY + 2 * _LANES + lane] - pc
        d = da * da + db * db + dc * dc
        for slot in range(_SLOTS):
            held = lanes[slot * _LANES + lane]
            lanes[slot * _LANES + lane] = min(d, held)
            d = max(d, held)


@_inline
def _square(x, y, z, pa, pb, pc):  # type: ignore[no-untyped-def]
    return (x - pa) * (x - pa) + (y - pb) * (y - pb) + (z - pc) * (z - pc)


@_inline
def _offer_four(a, b, c, j, lanes):  # type: ignore[no-untyped-def]
    """Insert the points j..j + 3: sort the four distances, keep the six smallest of ten, sort those (Batcher 1968).

    The list is rising and the four are falling beside it, so the pairwise minima form a bitonic sequence, and three
    rounds of exchanges put it in order.
    """
    a0, a1, a2, a3 = a[j], a[j + 1], a[j + 2], a[j + 3]  # before the loop, so that the compiler knows they stay
    b0, b1, b2, b3 = b[j], b[j + 1], b[j + 2], b[j + 3]
    c0, c1, c2, c3 = c[j], c[j + 1], c[j + 2], c[j + 3]
    for lane in range(_LANES):
        x, y, z = lanes[_QUERY + lane], lanes[_QUERY + _LANES + lane], lanes[_QUERY + 2 * _LANES + lane]
        d0, d1 = _square(x, y, z, a0, b0, c0), _square(x, y, z, a1, b1, c1)
        d2, d3 = _square(x, y, z, a2, b2, c2), _square(x, y, z, a3, b3, c3)
        d0, d1 = min(d0, d1), max(d0, d1)
        d2, d3 = min(d2, d3), max(d2, d3)
        d0, d2 = min(d0, d2), max(d0, d2)
        d1, d3 = min(d1, d3), max(d1, d3)
        d1, d2 = min(d1, d2), max(d1, d2)
        s0, s1, s2 = lanes[lane], lanes[_LANES + lane], min(lanes[2 * _LANES + lane], d3)
        s3, s4 = min(lanes[3 * _LANES + lane], d2), min(lanes[4 * _LANES + lane], d1)
        s5 = min(lanes[5 * _LANES + lane], d0)
        s0, s4 = min(s0, s4), max(s0, s4)
        s1, s5 = min(s1, s5), max(s1, s5)
        s2, s4 = min(s2, s4), max(s2, s4)
        s3, s5 = min(s3, s5), max(s3, s5)
        lanes[lane], lanes[_LANES + lane] = min(s0, s1), max(s0, s1)
        lanes[2 * _LANES + lane], lanes[3 * _LANES + lane] = min(s2, s3), max(s2, s3)
        lanes[4 * _LANES + lane], lanes[5 * _LANES + lane] = min(s4, s5), max(s4, s5)


@_inline
def _reach(lanes):  # type: ignore[no-untyped-def]
    """The largest sixth distance of all lanes, squared: as integers, which are ordered alike and vectorise."""
    worst = np.int32(0)
    for lane in range(_LANES):
        worst = np.int32(max(worst, np.float32(lanes[(_SLOTS - 1) * _LANES + lane]).view(np.int32)))
    return np.int32(worst).view(np.float32)


@_inline
def _search(a, b, c, left, right, row, rows, columns, cell_m, start, lanes):  # type: ignore[no-untyped-def]
    """Fill the lists of points that lie in the cells left..right of ``row``."""
    ring, complete = 0, False
    while not complete:
        ring += 1
        low, high = max(left - ring, 0), min(right + ring, columns - 1)
        for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            whole = ring == 1 or abs(r - row) == ring  # a row that is new; of the others only the two ends are
            for end in range(1 if whole else 2):
                begin = low if end == 0 else right + ring
                stop = high if whole or end == 1 else left - ring
                if begin <= stop and stop < columns:
                    j, last = start[r * columns + begin], start[r * columns + stop + 1]
                    while j + 4 <= last:
                        _offer_four(a, b, c, j, lanes)
                        j += 4
                    while j < last:
                        _offer_one(a[j], b[j], c[j], lanes)
                        j += 1
        everything = low == 0 and high == columns - 1 and row - ring <= 0 and row + ring >= rows - 1
        complete = everything or _reach(lanes) <= (0.999 * ring * cell_m) ** 2


@_inline
def _collect(lanes, first, last, n, mean, nearest):  # type: ignore[no-untyped-def]
    """Mean distance to the five nearest, or to all others if there are fewer. The arrays have room for all lanes."""
    if n <= NEIGHBOURS:  # the spare places of the lists hold nothing
        for lane in range(n * _LANES, _QUERY):
            lanes[lane] = np.float32(0.0)
    share = np.float32(1.0 / min(NEIGHBOURS, n - 1))
    for lane in range(_LANES):
        lanes[lane] = np.sqrt(lanes[_LANES + lane])
        lanes[_QUERY + lane] = share * (
            lanes[lane] + np.sqrt(lanes[2 * _LANES + lane]) + np.sqrt(lanes[3 * _LANES + lane])
            + np.sqrt(lanes[4 * _LANES + lane]) + np.sqrt(lanes[5 * _LANES + lane])
        )  # fmt: skip
    for lane in range(last - first + 1):
        mean[first + lane] = lanes[_QUERY + lane]
    for lane in range(last - first + 1):
        nearest[first + lane] = lanes[lane]


@_fast
def _all_clusters(planar, offsets, scratch, start, with_median, out):  # type: ignore[no-untyped-def]
    a, b, c, mean, nearest = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    lanes = np.empty((_SLOTS + 3) * _LANES, np.float32)
    for k in range(len(offsets) - 1):
        n = offsets[k + 1] - offsets[k]
        if n <= 1:
            continue
        rows, columns, cell_m = _fill_grid(planar[:, offsets[k] : offsets[k + 1]], start, a, b, c)
        scale = np.float32(1.0 / cell_m)
        for row in range(rows):
            begin, end = start[row * columns], start[(row + 1) * columns]
            for first in range(begin, end, _LANES):
                last = min(first + _LANES, end) - 1
                left, right = min(int(b[first] * scale), columns - 1), min(int(b[last] * scale), columns - 1)
                _load(a, b, c, first, last, lanes)
                _search(a, b, c, left, right, row, rows, columns, cell_m, start, lanes)
                _collect(lanes, first, last, n, mean, nearest)
        if n > NEIGHBOURS + 1:
            out[0, k] = _deviation(mean[:n])
        if with_median:
            out[1, k] = np.median(nearest[:n])


@_jit
def _fill_grid(chunk, start, a, b, c):  # type: ignore[no-untyped-def]
    """Counting sort of ``chunk`` (3, n) into cells, row by row along the longest axis; ``b`` is the second longest.

    Afterwards cell i holds the points start[i]:start[i + 1], relative to the corner of the grid.
    """
    n = chunk.shape[1]
    low, size = np.empty(3, np.float32), np.empty(3, np.float32)
    for j in range(3):
        low[j], most = low_high(chunk[j])
        size[j] = most - low[j]
    first = np.argmax(size)
    third = np.argmin(size)
    if third == first:  # a cube, or all points in one place
        third = (first + 1) % 3
    second = 3 - first - third
    cell_m = max(math.sqrt(_PER_CELL * size[first] * size[second] / n), _PER_CELL * size[first] / n, 1e-4)
    rows, columns = int(size[first] / cell_m) + 1, int(size[second] / cell_m) + 1
    u, v, w, u0, v0, w0 = chunk[first], chunk[second], chunk[third], low[first], low[second], low[third]
    scale, last_row, last_column = np.float32(1.0 / cell_m), np.int32(rows - 1), np.int32(columns - 1)
    cell = np.empty(n, np.uint32)
    for i in range(n):
        row = min(np.int32((u[i] - u0) * scale), last_row)
        cell[i] = row * np.int32(columns) + min(np.int32((v[i] - v0) * scale), last_column)
    for i in range(rows * columns + 2):
        start[i] = 0
    for i in range(n):
        start[cell[i] + np.uint32(2)] += 1
    for i in range(rows * columns):
        start[i + 2] += start[i + 1]
    for i in range(n):
        at = start[cell[i] + np.uint32(1)]
        a[at], b[at], c[at] = u[i] - u0, v[i] - v0, w[i] - w0
        start[cell[i] + np.uint32(1)] = at + 1
    return rows, columns, cell_m


@_fast
def _deviation(values):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(len(values)):
        total += values[i]
    centre = total / len(values)
    total = 0.0
    for i in range(len(values)):
        total += (values[i] - centre) ** 2
    return math.sqrt(total / len(values))
