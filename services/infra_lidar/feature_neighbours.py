"""Features that look at neighbours: spread of the spacing, pieces inside a cluster, hull vertices.

Neighbours are exact. A cluster is sorted along its longest axis; 16 consecutive points then search together, one per
SIMD lane, in a window along that axis that is widened until no point outside can be nearer than the fifth found.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.spatial import ConvexHull, QhullError

NEIGHBOURS = 5
_LANES = 16
_SLOTS = NEIGHBOURS + 1  # the point itself comes first
_QUERY = _SLOTS * _LANES  # where the coordinates begin in the buffer of the lanes
_FAR = np.float32(1e12)
_jit = njit(nogil=True, cache=True, error_model="numpy")


def neighbour_features(points: np.ndarray, offsets: np.ndarray, with_components: bool) -> np.ndarray:
    """(K, 3) float32: nn_dist_std, n_components, largest_component_ratio (the last two 0 if not asked for)."""
    out = np.zeros((len(offsets) - 1, 3), np.float32)
    largest = int(np.diff(offsets).max(initial=1)) + _LANES
    _all_clusters(points, offsets, with_components, np.empty((5, largest), np.float32), out)
    return out


@_jit
def _all_clusters(
    points: np.ndarray, offsets: np.ndarray, with_components: bool, scratch: np.ndarray, out: np.ndarray
) -> None:
    a, b, c, mean, nearest = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    order, start = np.empty(len(a), np.int32), np.empty(len(a) + 2, np.int32)
    lanes = np.empty((_SLOTS + 3) * _LANES, np.float32)
    for k in range(len(offsets) - 1):
        chunk = points[offsets[k] : offsets[k + 1]]
        n = len(chunk)
        if n <= 1:
            out[k, 1], out[k, 2] = n, 1.0
            continue
        _sort_along_longest(chunk, order, start, a, b, c)
        for i in range(n, n + _LANES):  # lanes beyond the end repeat the last point
            a[i], b[i], c[i] = a[n - 1], b[n - 1], c[n - 1]
        _search(a, b, c, n, lanes, mean, nearest)
        if n > NEIGHBOURS + 1:
            out[k, 0] = _deviation(mean[:n])
        if with_components:
            out[k, 1], out[k, 2] = _components(a[:n], b[:n], c[:n], 2.5 * np.median(nearest[:n]))


@_jit
def _sort_along_longest(
    chunk: np.ndarray, order: np.ndarray, start: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> None:
    """Columns sorted along the longest axis: counting sort into n bins, then insertion sort of the nearly sorted."""
    n, widest, axis = len(chunk), np.float32(-1.0), 0
    first = np.float32(0.0)
    for j in range(3):
        low = high = chunk[0, j]
        for i in range(n):
            low, high = min(low, chunk[i, j]), max(high, chunk[i, j])
        if high - low > widest:
            widest, first, axis = high - low, low, j
    scale = np.float32((n - 1) / widest) if widest > 1e-6 else np.float32(0.0)
    start[: n + 1] = 0
    for i in range(n):
        start[int((chunk[i, axis] - first) * scale) + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    for i in range(n):
        cell = int((chunk[i, axis] - first) * scale)
        order[start[cell]] = i
        start[cell] += 1
    for i in range(1, n):
        moved, j = order[i], i
        while j > 0 and chunk[order[j - 1], axis] > chunk[moved, axis]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = moved
    second, third = (axis + 1) % 3, (axis + 2) % 3
    for i in range(n):
        p = chunk[order[i]]
        a[i], b[i], c[i] = p[axis] - first, p[second] - chunk[0, second], p[third] - chunk[0, third]


@_jit
def _search(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, n: int, lanes: np.ndarray, mean: np.ndarray, nearest: np.ndarray
) -> None:
    """Mean distance to the five nearest (fewer in a tiny cluster) and to the nearest, for each of n sorted points.

    ``lanes`` holds the six best squared distances and the three coordinates of 16 points, row by row in one buffer:
    with one array the compiler knows that nothing overlaps, and the lanes become one vector.
    """
    for start in range(0, n, _LANES):
        lanes[: _SLOTS * _LANES] = _FAR
        for lane in range(_LANES):
            lanes[_QUERY + lane] = a[start + lane]
            lanes[_QUERY + _LANES + lane] = b[start + lane]
            lanes[_QUERY + 2 * _LANES + lane] = c[start + lane]
        last = min(start + _LANES, n) - 1
        low, high = start, last + 1
        _offer(a, b, c, low, high, lanes)
        while True:
            reach = _reach(lanes)
            left, right = low, high
            while left > 0 and (a[start] - a[left - 1]) ** 2 < reach and low - left < _LANES:
                left -= 1
            while right < n and (a[right] - a[last]) ** 2 < reach and right - high < _LANES:
                right += 1
            if left == low and right == high:
                break
            _offer(a, b, c, left, low, lanes)
            _offer(a, b, c, high, right, lanes)
            low, high = left, right
        _collect(lanes, start, last, n, mean, nearest)


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


@_jit
def _components(a: np.ndarray, b: np.ndarray, c: np.ndarray, eps: float) -> tuple[float, float]:
    """Pieces by DBSCAN (Ester et al. 1996), three points within eps make a core; and the share of the largest.

    Points are sorted by ``a``, so a sweep meets every pair within eps. A border point joins the first core that the
    sweep finds for it. No core at all counts as no piece.
    """
    n, limit = len(a), eps * eps
    near = np.ones(n, np.int32)
    for i in range(n):
        j = i + 1
        while j < n and a[j] - a[i] <= eps:
            if (a[j] - a[i]) ** 2 + (b[j] - b[i]) ** 2 + (c[j] - c[i]) ** 2 <= limit:
                near[i], near[j] = near[i] + 1, near[j] + 1
            j += 1
    root = np.arange(n)
    for i in range(n):
        j = i + 1
        while j < n and a[j] - a[i] <= eps:
            if (a[j] - a[i]) ** 2 + (b[j] - b[i]) ** 2 + (c[j] - c[i]) ** 2 <= limit:
                both, one = near[i] >= 3 and near[j] >= 3, near[i] >= 3 or near[j] >= 3
                border = i if near[i] < 3 else j
                if both or (one and root[border] == border):
                    _join(root, i, j, near)
            j += 1
    return _count_pieces(root, near)


@_jit
def _join(root: np.ndarray, i: int, j: int, near: np.ndarray) -> None:
    """Union with path halving; a border point hangs below the core and never becomes a root of others."""
    if near[i] < 3:
        root[i] = j
        return
    if near[j] < 3:
        root[j] = i
        return
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    while root[j] != j:
        root[j] = root[root[j]]
        j = root[j]
    root[j] = i


@_jit
def _count_pieces(root: np.ndarray, near: np.ndarray) -> tuple[float, float]:
    n, pieces, largest = len(root), 0, 0
    size = np.zeros(n, np.int32)
    for i in range(n):
        r = i
        while root[r] != r:
            r = root[r]
        size[r] += 1
    for i in range(n):
        if root[i] == i and near[i] >= 3:
            pieces, largest = pieces + 1, max(largest, size[i])
    return float(pieces), largest / n


def hull_point_ratio(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(K,) vertices of the 3-D convex hull / points; 1 for up to 10 points or a flat cluster (qhull: 0.1 ms each)."""
    out = np.ones(len(offsets) - 1, np.float32)
    for k in range(len(out)):
        cluster = points[offsets[k] : offsets[k + 1]].astype(np.float64)
        if len(cluster) > 10:
            try:
                out[k] = len(ConvexHull(cluster).vertices) / len(cluster)
            except QhullError:
                out[k] = 1.0  # all points in one plane
    return out
