"""How evenly the points of a cluster are spaced: exact nearest neighbours, 16 at a time.

A cluster is sorted into the cells of a grid over its two longest axes, about eight points a cell. Up to 16 consecutive
points of a row of cells then search together, one per SIMD lane, in a window of cells that is widened until no point
outside can be nearer than the fifth found.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NEIGHBOURS = 5
_LANES = 16
_SLOTS = NEIGHBOURS + 1  # the point itself comes first
_QUERY = _SLOTS * _LANES  # where the coordinates begin in the buffer of the lanes
_PER_CELL = 8.0
_FAR = np.float32(1e12)
_jit = njit(nogil=True, cache=True, error_model="numpy")


def neighbour_features(points: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Spacing inside K clusters.

    Returns:
        nn_dist_std (K,) float32: deviation of the mean distance to the five nearest, 0 for up to six points;
        nn_median (K,) float32: median distance to the nearest, 0 for a single point.
    """
    out = np.zeros((2, len(offsets) - 1), np.float32)
    largest = int(np.diff(offsets).max(initial=1))
    _all_clusters(points, offsets, np.empty((5, largest), np.float32), out)
    return out[0], out[1]


@_jit
def _all_clusters(points: np.ndarray, offsets: np.ndarray, scratch: np.ndarray, out: np.ndarray) -> None:
    a, b, c, mean, nearest = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    start = np.empty(3 * len(a) + 64, np.int32)
    lanes = np.empty((_SLOTS + 3) * _LANES, np.float32)
    for k in range(len(offsets) - 1):
        chunk = points[offsets[k] : offsets[k + 1]]
        n = len(chunk)
        if n <= 1:
            continue
        rows, columns, cell_m = _fill_grid(chunk, start, a, b, c)
        for row in range(rows):
            begin, end = start[row * columns], start[(row + 1) * columns]
            for first in range(begin, end, _LANES):
                last = min(first + _LANES, end) - 1
                _search(a, b, c, first, last, row, rows, columns, cell_m, start, lanes)
                _collect(lanes, first, last, n, mean, nearest)
        if n > NEIGHBOURS + 1:
            out[0, k] = _deviation(mean[:n])
        out[1, k] = np.median(nearest[:n])


@_jit
def _fill_grid(
    chunk: np.ndarray, start: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> tuple[int, int, float]:
    """Counting sort into cells, row by row along the longest axis; ``b`` is the second longest, ``c`` the third.

    Afterwards cell i holds the points start[i]:start[i + 1], relative to the corner of the grid.
    """
    n = len(chunk)
    low, size = np.empty(3, np.float32), np.empty(3, np.float32)
    for j in range(3):
        least = most = chunk[0, j]
        for i in range(n):
            least, most = min(least, chunk[i, j]), max(most, chunk[i, j])
        low[j], size[j] = least, most - least
    first = np.argmax(size)
    third = np.argmin(size)
    if third == first:  # a cube, or all points in one place
        third = (first + 1) % 3
    second = 3 - first - third
    cell_m = max(math.sqrt(_PER_CELL * size[first] * size[second] / n), _PER_CELL * size[first] / n, 1e-4)
    rows, columns = int(size[first] / cell_m) + 1, int(size[second] / cell_m) + 1
    scale = np.float32(1.0 / cell_m)
    start[: rows * columns + 2] = 0
    for i in range(n):
        row = min(int((chunk[i, first] - low[first]) * scale), rows - 1)
        start[row * columns + min(int((chunk[i, second] - low[second]) * scale), columns - 1) + 2] += 1
    for i in range(rows * columns):
        start[i + 2] += start[i + 1]
    for i in range(n):
        u, v, w = chunk[i, first] - low[first], chunk[i, second] - low[second], chunk[i, third] - low[third]
        cell = min(int(u * scale), rows - 1) * columns + min(int(v * scale), columns - 1)
        at = start[cell + 1]
        a[at], b[at], c[at] = u, v, w
        start[cell + 1] += 1
    return rows, columns, cell_m


@_jit
def _search(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, first: int, last: int, row: int, rows: int, columns: int,
    cell_m: float, start: np.ndarray, lanes: np.ndarray,
) -> None:  # fmt: skip
    """Fill ``lanes`` for the points first..last, all of one row.

    ``lanes`` holds the six best squared distances and the three coordinates of 16 points, row by row in one buffer:
    with one array the compiler knows that nothing overlaps, and the lanes become one vector.
    """
    lanes[:_QUERY] = _FAR
    for lane in range(_LANES):  # lanes beyond the end repeat the last point
        i = min(first + lane, last)
        lanes[_QUERY + lane], lanes[_QUERY + _LANES + lane], lanes[_QUERY + 2 * _LANES + lane] = a[i], b[i], c[i]
    scale = np.float32(1.0 / cell_m)
    left, right = min(int(b[first] * scale), columns - 1), min(int(b[last] * scale), columns - 1)
    ring = 0
    while True:
        ring += 1
        low, high = max(left - ring, 0), min(right + ring, columns - 1)
        for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            base = r * columns
            if ring == 1 or abs(r - row) == ring:  # a row that is new: all of it
                _offer(a, b, c, start[base + low], start[base + high + 1], lanes)
                continue
            if left - ring >= 0:
                _offer(a, b, c, start[base + low], start[base + low + 1], lanes)
            if right + ring < columns:
                _offer(a, b, c, start[base + high], start[base + high + 1], lanes)
        everything = low == 0 and high == columns - 1 and row - ring <= 0 and row + ring >= rows - 1
        if everything or _reach(lanes) <= (0.999 * ring * cell_m) ** 2:
            return


@_jit
def _offer(a: np.ndarray, b: np.ndarray, c: np.ndarray, begin: int, end: int, lanes: np.ndarray) -> None:
    """Insert the points begin..end into every lane's sorted list of squared distances, without branches."""
    for j in range(begin, end):
        pa, pb, pc = a[j], b[j], c[j]
        for lane in range(_LANES):
            da = lanes[_QUERY + lane] - pa
            db = lanes[_QUERY + _LANES + lane] - pb
            dc = lanes[_QUERY + 2 * _LANES + lane] - pc
            d = da * da + db * db + dc * dc
            for slot in range(_SLOTS):
                held = lanes[slot * _LANES + lane]
                lanes[slot * _LANES + lane] = d if d < held else held
                d = held if d < held else d


@_jit
def _reach(lanes: np.ndarray) -> float:
    """The largest sixth distance of all lanes, squared."""
    worst = lanes[(_SLOTS - 1) * _LANES]
    for lane in range(1, _LANES):
        worst = max(worst, lanes[(_SLOTS - 1) * _LANES + lane])
    return float(worst)


@_jit
def _collect(lanes: np.ndarray, start: int, last: int, n: int, mean: np.ndarray, nearest: np.ndarray) -> None:
    found = min(NEIGHBOURS, n - 1)
    for lane in range(last - start + 1):
        total = 0.0
        for slot in range(1, found + 1):
            total += math.sqrt(lanes[slot * _LANES + lane])
        mean[start + lane] = total / found
        nearest[start + lane] = math.sqrt(lanes[_LANES + lane])


@_jit
def _deviation(values: np.ndarray) -> float:
    centre = 0.0
    for value in values:
        centre += value / len(values)
    total = 0.0
    for value in values:
        total += (value - centre) ** 2
    return math.sqrt(total / len(values))
