"""The compiled pass behind ``features.py``: moments, extents, height ranks, slices and the bird's-eye hull.

One cluster at a time is copied into planar scratch arrays relative to its first point (float32 stays exact to
micrometres inside a cluster), then a handful of short loops run over it, most of them vectorised. Ranks come from the
counts of 256 height bins, followed by a selection inside the one bin that holds the rank: exact, and linear in the
points.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from services.infra_lidar.buffers import aligned
from services.infra_lidar.extremes import chosen_extent, low_high
from services.infra_lidar.ordering import sort_rising

SLICES = 5
RANKS = (0.05, 0.10, 0.25, 0.50, 0.75, 0.95)
ALL_NAMES: tuple[str, ...] = (
    "num_points", "xy_spread", "xy_area", "z_range", "height_to_footprint", "density", "z_25", "z_75", "z_std",
    "xy_aspect_ratio", "scattering", "linearity", "planarity",
    "layer_frac_0", "layer_frac_1", "layer_frac_2", "layer_frac_3", "layer_frac_4",
    "cross_section_var", "cross_section_mean", "z_range_cleaned",
    "x_range", "y_range", "bbox_volume", "z_median", "ev_norm_0", "ev_norm_1", "ev_norm_2",
    "vertical_uniformity", "bottom_to_top_ratio", "ground_gap_ratio",
    "z_bottom", "z_top", "hull_fill", "range_m", "points_by_range",
    "slice_length_0", "slice_length_1", "slice_length_2", "slice_length_3", "slice_length_4",
    "slice_width_0", "slice_width_1", "slice_width_2", "slice_width_3", "slice_width_4",
    "nn_dist_std", "n_components", "largest_component_ratio", "hull_point_ratio",
)  # fmt: skip
_WIDTH = len(ALL_NAMES)
_BINS = 256
_EPS = 1e-9

_jit = njit(nogil=True, cache=True, error_model="numpy")
_fast = njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "nnan"})


def geometry_features(
    planar: np.ndarray, offsets: np.ndarray, ground_z_m: np.ndarray, with_hull: bool = True
) -> np.ndarray:
    """(K, len(ALL_NAMES)) float32 of the points ``planar`` (3, M) float32.

    The last four columns are filled elsewhere (1 for the hull ratio, else 0); ``hull_fill`` is 0 without ``with_hull``.
    """
    out = np.zeros((len(offsets) - 1, _WIDTH), np.float32)
    room = (int(np.diff(offsets).max(initial=1)) // 64 + 1) * 64
    scratch, bins = aligned(6 * room, np.float32).reshape(6, room), aligned(room, np.uint8)
    _all_clusters(planar, offsets, ground_z_m, scratch, bins, with_hull, out)
    return out


@_jit
def _all_clusters(
    planar: np.ndarray, offsets: np.ndarray, ground: np.ndarray, scratch: np.ndarray, bins: np.ndarray,
    with_hull: bool, out: np.ndarray,
) -> None:  # fmt: skip
    for k in range(len(offsets) - 1):
        first, last = offsets[k], offsets[k + 1]
        n = last - first
        x0, y0, z0 = planar[0, first], planar[1, first], planar[2, first]
        x, y, z = scratch[0, :n], scratch[1, :n], scratch[2, :n]
        for axis in range(3):
            _shifted(planar[axis, first:last], planar[axis, first], scratch[axis, :n])
        u, v, work = scratch[3, :n], scratch[4, :n], scratch[5, :n]
        _one_cluster(x, y, z, u, v, work, bins[:n], x0, y0, z0 - ground[k], with_hull, out[k])


@_fast
def _shifted(a: np.ndarray, origin: float, out: np.ndarray) -> None:
    for i in range(len(a)):
        out[i] = a[i] - origin


@_jit
def _one_cluster(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, u: np.ndarray, v: np.ndarray, work: np.ndarray, bins: np.ndarray,
    x0: float, y0: float, base: float, with_hull: bool, row: np.ndarray,
) -> None:  # fmt: skip
    n = len(x)
    mx, my, mz = _mean(x), _mean(y), _mean(z)
    cxx, cyy, czz = _moment(x, x, mx, mx), _moment(y, y, my, my), _moment(z, z, mz, mz)
    cxy, cxz, cyz = _moment(x, y, mx, my), _moment(x, z, mx, mz), _moment(y, z, my, mz)
    cos, sin, ratio = _axes(cxx, cxy, cyy)
    _rotate(x, y, cos, sin, u, v)
    z_low, z_high = low_high(z)
    u_low, u_high = low_high(u)
    v_low, v_high = low_high(v)
    length, width, tall = u_high - u_low, v_high - v_low, z_high - z_low
    spread, area = math.sqrt(length * length + width * width), length * width
    row[0], row[1], row[2], row[3] = n, spread, area, tall
    row[4] = tall / spread if spread > _EPS else 0.0
    solid = area * math.sqrt(tall)
    row[5] = n / solid if solid > 1e-6 else 0.0
    row[8], row[9] = math.sqrt(czz), ratio
    _eigen_columns(cxx, cyy, czz, cxy, cxz, cyz, row)
    _rank_columns(z, z_low, tall, base, work, bins, row)
    _slice_columns(u, v, z, z_low, tall, bins, row)
    row[21], row[22], row[23] = length, width, area * tall
    row[31], row[32] = base + z_low, base + z_high
    if with_hull and area > 1e-6:
        row[33] = _hull_area(u, v, u_low, length) / area
    row[34] = math.hypot(x0 + mx, y0 + my)
    row[35] = math.log(n) + 2.0 * math.log(max(row[34], 1.0))
    row[_WIDTH - 1] = 1.0


@_fast
def _mean(a: np.ndarray) -> float:
    total = np.float32(0.0)
    for i in range(len(a)):
        total += a[i]
    return float(total / len(a))


@_fast
def _moment(a: np.ndarray, b: np.ndarray, mean_a: float, mean_b: float) -> float:
    total, ma, mb = np.float32(0.0), np.float32(mean_a), np.float32(mean_b)
    for i in range(len(a)):
        total += (a[i] - ma) * (b[i] - mb)
    return float(total / len(a))


@_fast
def _rotate(x: np.ndarray, y: np.ndarray, cos: float, sin: float, u: np.ndarray, v: np.ndarray) -> None:
    c, s = np.float32(cos), np.float32(sin)
    for i in range(len(x)):
        u[i] = c * x[i] + s * y[i]
    for i in range(len(x)):
        v[i] = c * y[i] - s * x[i]


@_jit
def _axes(cxx: float, cxy: float, cyy: float) -> tuple[float, float, float]:
    """Cosine and sine of the main axis of a 2x2 covariance, and the ratio of its eigenvalues."""
    half, root = 0.5 * (cxx + cyy), math.sqrt(0.25 * (cxx - cyy) ** 2 + cxy * cxy)
    angle = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
    return math.cos(angle), math.sin(angle), (half + root) / max(half - root, 1e-6)


@_jit
def _eigen_columns(cxx: float, cyy: float, czz: float, cxy: float, cxz: float, cyz: float, row: np.ndarray) -> None:
    """Eigenvalues of the symmetric 3x3 covariance in closed form (Smith, CACM 1961), and what follows from them."""
    off = cxy * cxy + cxz * cxz + cyz * cyz
    mean = (cxx + cyy + czz) / 3.0
    spread = math.sqrt(((cxx - mean) ** 2 + (cyy - mean) ** 2 + (czz - mean) ** 2 + 2.0 * off) / 6.0)
    large = middle = small = mean
    if spread > 1e-12:
        a, b, c = (cxx - mean) / spread, (cyy - mean) / spread, (czz - mean) / spread
        d, e, f = cxy / spread, cxz / spread, cyz / spread
        half_det = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e))
        phi = math.acos(min(1.0, max(-1.0, half_det))) / 3.0
        large = mean + 2.0 * spread * math.cos(phi)
        small = mean + 2.0 * spread * math.cos(phi + 2.0 * math.pi / 3.0)
        middle = 3.0 * mean - large - small
    large, middle, small = max(large, _EPS), max(middle, _EPS), max(small, _EPS)
    row[10], row[11], row[12] = small / large, (large - middle) / large, (middle - small) / large
    total = large + middle + small
    row[25], row[26], row[27] = small / total, middle / total, large / total


@_fast
def _binned(z: np.ndarray, low: float, scale: float, last: int, bins: np.ndarray) -> None:
    """bins (n,) uint8: (z - low) * scale, at most ``last``."""
    low32, scale32, top = np.float32(low), np.float32(scale), np.int32(last)
    for i in range(len(z)):
        bins[i] = np.uint8(min(np.int32((z[i] - low32) * scale32), top))


@_jit
def _rank_columns(
    z: np.ndarray, low: float, tall: float, base: float, work: np.ndarray, bins: np.ndarray, row: np.ndarray
) -> None:
    """Height percentiles, the rank below (no interpolation), relative to the ground."""
    n = len(z)
    _binned(z, low, (_BINS - 1) / tall if tall > 1e-6 else 0.0, _BINS - 1, bins)
    start = np.zeros(_BINS + 1, np.int32)
    for i in range(n):
        start[np.uint32(bins[i]) + np.uint32(1)] += 1
    for b in range(_BINS):
        start[b + 1] += start[b]
    slot = np.full(_BINS, -1, np.int32)  # where the next height of a bin goes, -1: holds no rank
    b = 0
    for j in range(6):
        while start[b + 1] <= int(RANKS[j] * (n - 1)):
            b += 1
        slot[b] = start[b]
    for i in range(n):
        at = slot[bins[i]]
        if at >= 0:  # a few in a hundred
            work[at] = z[i]
            slot[bins[i]] = at + 1
    ranks = np.empty(6, np.float32)
    b = 0
    for j in range(6):
        k = int(RANKS[j] * (n - 1))
        while start[b + 1] <= k:
            b += 1
        segment = work[start[b] : start[b + 1]]
        sort_rising(segment)
        ranks[j] = segment[k - start[b]]
    row[6], row[24], row[7] = base + ranks[2], base + ranks[3], base + ranks[4]
    row[20] = ranks[5] - ranks[0]
    row[30] = (ranks[1] - ranks[0]) / tall if tall > 1e-6 else 0.0


@_jit
def _slice_columns(
    u: np.ndarray, v: np.ndarray, z: np.ndarray, low: float, tall: float, slices: np.ndarray, row: np.ndarray
) -> None:
    """Five equal height slices: share of points, extent along both axes, spread of the diagonals."""
    n, high = len(z), np.float32(low + tall)
    _binned(z, low, SLICES / tall if tall > 1e-6 else 0.0, SLICES - 1, slices)
    for i in range(n):  # the topmost point goes into a slice of its own, which is left out, as in the article
        slices[i] = np.uint8(SLICES) if z[i] >= high else slices[i]
    mean = square = share_mean = share_square = 0.0
    for s in range(SLICES):
        count, length = chosen_extent(u, slices, s)
        _, width = chosen_extent(v, slices, s)
        row[13 + s] = count / n
        if count > 2:
            row[36 + s], row[41 + s] = length, width
        diagonal = math.hypot(row[36 + s], row[41 + s])
        mean, square = mean + diagonal / SLICES, square + diagonal * diagonal / SLICES
        share_mean += row[13 + s] / SLICES
        share_square += row[13 + s] * row[13 + s] / SLICES
    if n > 20 and tall > 0.1:
        row[18], row[19] = math.sqrt(max(square - mean * mean, 0.0)), mean
    row[28] = math.sqrt(max(share_square - share_mean * share_mean, 0.0))
    row[29] = min(row[13] / max(row[17], 1e-6), 1e3)


@_jit
def _hull_area(u: np.ndarray, v: np.ndarray, u_low: float, length: float) -> float:
    """Area of the bird's-eye convex hull, from the lowest and highest v in 64 columns along the length.

    A hull needs only the extreme points of every column (Bentley, Faust, Preparata 1982): one linear pass, then a
    chain over at most 64 points below and above. Inside a column the extremes keep their own u, so the area is
    exact up to points that a column hides behind its extremes (measured: below 1 %).
    """
    columns = 64
    low, high = np.full((2, columns), 0.0, np.float32), np.full((2, columns), 0.0, np.float32)
    seen = np.zeros(columns, np.bool_)
    scale, u0 = np.float32((columns - 1) / length) if length > 1e-6 else np.float32(0.0), np.float32(u_low)
    for i in range(len(u)):
        c = int((u[i] - u0) * scale)
        if not seen[c]:
            seen[c] = True
            low[0, c], low[1, c], high[0, c], high[1, c] = u[i], v[i], u[i], v[i]
        elif v[i] < low[1, c]:
            low[0, c], low[1, c] = u[i], v[i]
        elif v[i] > high[1, c]:
            high[0, c], high[1, c] = u[i], v[i]
    return 0.5 * (_chain(low, seen, 1.0) + _chain(high, seen, -1.0) + _closing(low, high, seen))


@_jit
def _chain(side: np.ndarray, seen: np.ndarray, sign: float) -> float:
    """Twice the signed area under a monotone hull chain (Andrew 1979); sign +1 lower, -1 upper."""
    stack = np.empty(len(seen), np.int64)
    top = 0
    for c in range(len(seen)):
        if not seen[c]:
            continue
        while top >= 2:
            a, b = stack[top - 2], stack[top - 1]
            turn = (side[0, b] - side[0, a]) * (side[1, c] - side[1, a]) - (side[1, b] - side[1, a]) * (
                side[0, c] - side[0, a]
            )
            if turn * sign > 0.0:
                break
            top -= 1
        stack[top] = c
        top += 1
    total = 0.0
    for i in range(top - 1):
        a, b = stack[i], stack[i + 1]
        total += side[0, a] * side[1, b] - side[0, b] * side[1, a]
    return total * sign


@_jit
def _closing(low: np.ndarray, high: np.ndarray, seen: np.ndarray) -> float:
    """The two edges that join the lower to the upper chain."""
    first, last = 0, len(seen) - 1
    while not seen[first]:
        first += 1
    while not seen[last]:
        last -= 1
    right = low[0, last] * high[1, last] - high[0, last] * low[1, last]
    left = high[0, first] * low[1, first] - low[0, first] * high[1, first]
    return float(right + left)
