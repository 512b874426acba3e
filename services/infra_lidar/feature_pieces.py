"""Pieces inside a cluster and the vertices of its hull: the costly features of the article's larger sets."""

from __future__ import annotations

import numpy as np
from numba import njit

_jit = njit(nogil=True, cache=True, error_model="numpy")


def piece_features(points: np.ndarray, offsets: np.ndarray, spacing_m: np.ndarray) -> np.ndarray:
    """(K, 2) float32: n_components, largest_component_ratio by DBSCAN with eps = 2.5 x ``spacing_m`` (K,)."""
    out = np.zeros((len(offsets) - 1, 2), np.float32)
    _all_clusters(points, offsets, spacing_m, out)
    return out


@_jit
def _all_clusters(points: np.ndarray, offsets: np.ndarray, spacing_m: np.ndarray, out: np.ndarray) -> None:
    largest = 1
    for k in range(len(offsets) - 1):
        largest = max(largest, offsets[k + 1] - offsets[k])
    a, b, c = np.empty(largest, np.float32), np.empty(largest, np.float32), np.empty(largest, np.float32)
    order, start = np.empty(largest, np.int32), np.empty(largest + 2, np.int32)
    for k in range(len(offsets) - 1):
        chunk = points[offsets[k] : offsets[k + 1]]
        n = len(chunk)
        if n <= 1:
            out[k, 0], out[k, 1] = n, 1.0
            continue
        _sort_along_longest(chunk, order, start, a, b, c)
        out[k, 0], out[k, 1] = _components(a[:n], b[:n], c[:n], 2.5 * spacing_m[k])


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
    from scipy.spatial import ConvexHull, QhullError  # here: it takes a third of a second, and our own set is without

    out = np.ones(len(offsets) - 1, np.float32)
    for k in range(len(out)):
        cluster = points[offsets[k] : offsets[k + 1]].astype(np.float64)
        if len(cluster) > 10:
            try:
                out[k] = len(ConvexHull(cluster).vertices) / len(cluster)
            except QhullError:
                out[k] = 1.0  # all points in one plane
    return out
