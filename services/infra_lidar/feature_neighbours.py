"""How evenly the points of a cluster are spaced: exact nearest neighbours, 16 at a time.

A cluster is sorted into the cells of a grid over its two longest axes, about four points a cell. Up to 16 consecutive
points of a row of cells then search together, one per SIMD lane, in a window of cells that is widened until no point
outside can be nearer than the fifth found. The window's points are first copied side by side, relative to the first of
the 16: there |p|^2 - 2 q p orders them as their distance from q does, which is three multiplications a pair.

The small functions are compiled into ``_all_clusters`` (``inline``): as calls they would cost more than what they do,
and the lists of the lanes would not stay in registers.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from services.infra_lidar.buffers import aligned
from services.infra_lidar.extremes import low_high

NEIGHBOURS = 5
_LANES = 16
_SLOTS = NEIGHBOURS + 1  # the point itself comes first
_QUERY = _SLOTS * _LANES  # where -2 q and |q|^2 begin in the buffer of the lanes
_SQUARE = _QUERY + 3 * _LANES
_PER_CELL = 4.0
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
    room = (largest // _LANES + 3) * _LANES
    scratch, stage = aligned(5 * room, np.float32).reshape(5, room), aligned(4 * room, np.float32).reshape(4, room)
    lanes, start = aligned((_SLOTS + 4) * _LANES, np.float32), np.empty(3 * largest + 64, np.int32)
    _all_clusters(planar, offsets, scratch, stage, start, lanes, with_median, out)
    return out[0], out[1]


@_inline
def _begin(a, b, c, first, last, lanes):  # type: ignore[no-untyped-def]
    """Begin a search for the points first..last: empty lists, places relative to the first; spare lanes repeat the
    last point."""
    for i in range(_QUERY):
        lanes[i] = _FAR
    x0, y0, z0, two = a[first], b[first], c[first], np.float32(-2.0)
    for lane in range(_LANES):
        i = np.uint64(min(first + lane, last))
        x, y, z = a[i] - x0, b[i] - y0, c[i] - z0
        lanes[_QUERY + lane], lanes[_QUERY + _LANES + lane], lanes[_QUERY + 2 * _LANES + lane] = (
            two * x,
            two * y,
            two * z,
        )
        lanes[_SQUARE + lane] = x * x + y * y + z * z


@_inline
def _stage(a, b, c, begin, stop, first, stage, staged):  # type: ignore[no-untyped-def]
    """Copy the points begin..stop - 1 behind the ``staged`` ones, relative to point ``first``; returns how many there
    are now. Whole lanes are copied: what is too much is overwritten by the next."""
    x0, y0, z0 = a[first], b[first], c[first]
    for j in range(begin, stop, _LANES):
        for lane in range(_LANES):
            i, k = np.uint64(j + lane), np.uint64(staged + j - begin + lane)
            x, y, z = a[i] - x0, b[i] - y0, c[i] - z0
            stage[0, k], stage[1, k], stage[2, k] = x, y, z
            stage[3, k] = x * x + y * y + z * z
    return staged + stop - begin


@_inline
def _offer(stage, staged, lanes):  # type: ignore[no-untyped-def]
    """Insert the staged points into every lane's list, four at a time, without branches.

    Sort the four, keep the six smallest of ten, sort those (Batcher 1968): the list is rising and the four are falling
    beside it, so the pairwise minima form a bitonic sequence, and three rounds of exchanges put it in order.
    """
    for k in range(staged, staged + 3):  # the last four may be fewer
        stage[0, k] = stage[1, k] = stage[2, k] = np.float32(0.0)
        stage[3, k] = _FAR
    for j in range(0, staged, 4):
        k0 = np.uint64(j)
        k1, k2, k3 = k0 + np.uint64(1), k0 + np.uint64(2), k0 + np.uint64(3)
        a0, a1, a2, a3 = stage[0, k0], stage[0, k1], stage[0, k2], stage[0, k3]  # before the loop: so they stay
        b0, b1, b2, b3 = stage[1, k0], stage[1, k1], stage[1, k2], stage[1, k3]
        c0, c1, c2, c3 = stage[2, k0], stage[2, k1], stage[2, k2], stage[2, k3]
        w0, w1, w2, w3 = stage[3, k0], stage[3, k1], stage[3, k2], stage[3, k3]
        for lane in range(_LANES):
            x, y, z = lanes[_QUERY + lane], lanes[_QUERY + _LANES + lane], lanes[_QUERY + 2 * _LANES + lane]
            d0, d1 = w0 + x * a0 + y * b0 + z * c0, w1 + x * a1 + y * b1 + z * c1
            d2, d3 = w2 + x * a2 + y * b2 + z * c2, w3 + x * a3 + y * b3 + z * c3
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
        squared = max(lanes[5 * _LANES + lane] + lanes[_SQUARE + lane], np.float32(0.0))
        worst = np.int32(max(worst, np.float32(squared).view(np.int32)))
    return np.int32(worst).view(np.float32)


@_inline
def _search(a, b, c, first, left, right, row, rows, columns, cell_m, start, stage, lanes):  # type: ignore[no-untyped-def]
    """Fill the lists of points that begin with ``first`` and lie in the cells left..right of ``row``."""
    ring, complete = 0, False
    while not complete:
        ring += 1
        low, high, staged = max(left - ring, 0), min(right + ring, columns - 1), 0
        for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            at = r * columns
            if ring == 1 or abs(r - row) == ring:  # a row that is new; of the others only the two ends are
                staged = _stage(a, b, c, start[at + low], start[at + high + 1], first, stage, staged)
                continue
            if low == left - ring:
                staged = _stage(a, b, c, start[at + low], start[at + low + 1], first, stage, staged)
            if high == right + ring:
                staged = _stage(a, b, c, start[at + high], start[at + high + 1], first, stage, staged)
        _offer(stage, staged, lanes)
        everything = low == 0 and high == columns - 1 and row - ring <= 0 and row + ring >= rows - 1
        complete = everything or _reach(lanes) <= (0.999 * ring * cell_m) ** 2


@_inline
def _distance(lanes, slot, lane):  # type: ignore[no-untyped-def]
    return np.sqrt(max(lanes[slot * _LANES + lane] + lanes[_SQUARE + lane], np.float32(0.0)))


@_inline
def _collect(lanes, first, n, mean, nearest):  # type: ignore[no-untyped-def]
    """Mean distance to the five nearest, or to all others if there are fewer.

    All lanes are written: what the spare ones say is overwritten by the next batch, or lies behind the last point.
    """
    if n <= NEIGHBOURS:  # the spare places of the lists hold nothing
        for slot in range(n, _SLOTS):
            for lane in range(_LANES):
                lanes[slot * _LANES + lane] = -lanes[_SQUARE + lane]
    share = np.float32(1.0 / min(NEIGHBOURS, n - 1))
    for lane in range(_LANES):
        one = _distance(lanes, 1, lane)
        lanes[lane] = one
        lanes[_QUERY + lane] = share * (
            one + _distance(lanes, 2, lane) + _distance(lanes, 3, lane) + _distance(lanes, 4, lane)
            + _distance(lanes, 5, lane)
        )  # fmt: skip
    for lane in range(_LANES):
        mean[first + lane] = lanes[_QUERY + lane]
    for lane in range(_LANES):
        nearest[first + lane] = lanes[lane]


@_fast
def _all_clusters(planar, offsets, scratch, stage, start, lanes, with_median, out):  # type: ignore[no-untyped-def]
    a, b, c, mean, nearest = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
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
                _begin(a, b, c, first, last, lanes)
                _search(a, b, c, first, left, right, row, rows, columns, cell_m, start, stage, lanes)
                _collect(lanes, first, n, mean, nearest)
        if n > NEIGHBOURS + 1:
            out[0, k] = _deviation(mean[:n])
        if with_median:
            out[1, k] = np.median(nearest[:n])


@_inline
def _turn(i, quarter):  # type: ignore[no-untyped-def]
    """The i-th of all points when the four quarters take turns."""
    return np.uint32(i) if i >= 4 * quarter else np.uint32((i & 3) * quarter + (i >> 2))


@_jit
def _axes(chunk, low, size):  # type: ignore[no-untyped-def]
    """Longest, second and shortest axis of a cluster; its lower corner and size are written."""
    for j in range(3):
        low[j], most = low_high(chunk[j])
        size[j] = most - low[j]
    first, third = np.argmax(size), np.argmin(size)
    if third == first:  # a cube, or all points in one place
        third = (first + 1) % 3
    return first, 3 - first - third, third


@_jit
def _fill_grid(chunk, start, a, b, c):  # type: ignore[no-untyped-def]
    """Counting sort of ``chunk`` (3, n) into cells, row by row along the longest axis; ``b`` is the second longest.

    Afterwards cell i holds the points start[i]:start[i + 1], relative to the corner of the grid.
    """
    n, low, size = chunk.shape[1], np.empty(3, np.float32), np.empty(3, np.float32)
    first, second, third = _axes(chunk, low, size)
    cell_m = max(math.sqrt(_PER_CELL * size[first] * size[second] / n), _PER_CELL * size[first] / n, 1e-4)
    rows, columns = int(size[first] / cell_m) + 1, int(size[second] / cell_m) + 1
    u, v, w, u0, v0, w0 = chunk[first], chunk[second], chunk[third], low[first], low[second], low[third]
    scale, last_row, last_column = np.float32(1.0 / cell_m), np.int32(rows - 1), np.int32(columns - 1)
    cell = np.empty(n, np.uint32)
    for i in range(n):
        row = min(np.int32((u[i] - u0) * scale), last_row)
        cell[i] = row * np.int32(columns) + min(np.int32((v[i] - v0) * scale), last_column)
    start[: rows * columns + 2] = 0
    quarter = n // 4
    for i in range(n):  # from far apart in turn: neighbours would wait for each other's counter
        start[cell[_turn(i, quarter)] + np.uint32(2)] += 1
    for i in range(rows * columns):
        start[i + 2] += start[i + 1]
    for i in range(n):
        j = _turn(i, quarter)
        at = np.uint32(start[cell[j] + np.uint32(1)])
        a[at], b[at], c[at] = u[j] - u0, v[j] - v0, w[j] - w0
        start[cell[j] + np.uint32(1)] = at + 1
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
