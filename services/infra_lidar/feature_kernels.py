"""The compiled pass behind ``features.py``: moments, extents, height ranks, slices and the bird's-eye hull.

One cluster at a time is copied into planar scratch arrays about its mean (float32 stays exact to micrometres inside a
cluster), with places for whole vectors: those behind the last point hold 0, the mean, which changes no sum of squares
and no extent.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from services.infra_lidar.extremes import in_turn
from services.infra_lidar.feature_hull import hull_fill
from services.infra_lidar.jit import inline, inner, kernel
from services.infra_lidar.vectors import (
    LANES,
    fma,
    lane_max,
    lane_min,
    lane_sum,
    lanes,
    larger,
    load,
    ones,
    select,
    smaller,
    splat,
    store,
    whole,
)

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
_LARGE_M = np.float32(1e9)


@kernel
def cluster_features(
    planar: np.ndarray, offsets: np.ndarray, counts: np.ndarray, ground_z_m: np.ndarray, hull: bool,
    columns: np.ndarray, out: np.ndarray,
) -> bool:  # fmt: skip
    """out (K, F) float32: the ``columns`` (F,) of ``ALL_NAMES``, of the points ``planar`` (3, M) float32, which stand
    for ``counts`` (K,) ones. False where a cluster is empty.

    ``nn_dist_std`` (see ``feature_spacing.py``) and the last three are filled elsewhere (1 for the hull ratio, else 0);
    ``hull_fill`` is 0 without ``hull``.
    """
    largest = 1
    for k in range(len(offsets) - 1):
        if offsets[k + 1] <= offsets[k]:
            return False
        largest = max(largest, offsets[k + 1] - offsets[k])
    size = (largest // LANES + 2) * LANES
    scratch, bins, row = np.empty((5, size), np.float32), np.empty(size, np.uint8), np.empty(_WIDTH, np.float32)
    for k in range(len(offsets) - 1):
        first, last = offsets[k], offsets[k + 1]
        mx, my = centred(planar[0, first:last], scratch[0]), centred(planar[1, first:last], scratch[1])
        base = centred(planar[2, first:last], scratch[2]) - ground_z_m[k]
        for column in range(_WIDTH):
            row[column] = 0.0
        _one_cluster(scratch, bins, last - first, counts[k], mx, my, base, hull, row)
        for j in range(len(columns)):
            out[k, j] = row[columns[j]]
    return True


@inner
def centred(values: np.ndarray, out: np.ndarray) -> float:
    """Copy about the mean, zeros behind the last one; returns the mean."""
    n, origin = len(values), values[0]
    rest = n - n % LANES
    added = splat(np.float32(0.0))
    for i in range(0, rest, LANES):
        x = load(values, i) - origin
        store(out, i, x)
        added += x
    mean = lane_sum(added)
    store(out, rest, splat(np.float32(0.0)))
    for i in range(rest, n):
        out[i] = values[i] - origin
        mean += out[i]
    mean /= np.float32(n)
    for i in range(0, rest, LANES):
        store(out, i, load(out, i) - mean)
    for i in range(rest, n):
        out[i] -= mean
    return origin + mean


@inner
def _one_cluster(
    scratch: np.ndarray, bins: np.ndarray, n: int, count: int, mx: float, my: float, base: float, hull: bool,
    row: np.ndarray,
) -> None:  # fmt: skip
    """scratch (5, n or more): x, y, z about the mean, and room for two more; ``count`` points the n stand for;
    ``base`` is the mean's height."""
    z, u, v = scratch[2], scratch[3], scratch[4]
    cxx, cyy, czz, cxy, cxz, cyz, z_low, z_high = _moments(scratch[0], scratch[1], z, n)
    cos, sin, ratio = _axes(cxx, cxy, cyy)
    length, width = _turned(scratch[0], scratch[1], n, cos, sin, u, v)
    tall = z_high - z_low
    spread, area = math.sqrt(length * length + width * width), length * width
    row[0], row[1], row[2], row[3] = count, spread, area, tall
    row[4] = tall / spread if spread > _EPS else 0.0
    solid = area * math.sqrt(tall)
    row[5] = count / solid if solid > 1e-6 else 0.0
    row[8], row[9] = math.sqrt(czz), ratio
    _eigen_columns(cxx, cyy, czz, cxy, cxz, cyz, row)
    _rank_columns(z, n, z_low, tall, base, bins, row)
    _slice_columns(u, v, z, n, z_low, z_high, row)
    row[21], row[22], row[23] = length, width, area * tall
    row[31], row[32] = base + z_low, base + z_high
    if hull and area > 1e-6:
        row[33] = hull_fill(u, v, n, length, width)
    row[34] = math.hypot(mx, my)
    row[35] = math.log(count) + 2.0 * math.log(max(row[34], 1.0))
    row[_WIDTH - 1] = 1.0


@inner
def _moments(x: np.ndarray, y: np.ndarray, z: np.ndarray, n: int) -> tuple[Any, ...]:
    """Covariances xx, yy, zz, xy, xz, yz about 0, and the smallest and largest z."""
    none = splat(np.float32(0.0))
    xx, yy, zz, xy, xz, yz, low, high = none, none, none, none, none, none, none, none
    for i in range(0, n, LANES):
        a, b, c = load(x, i), load(y, i), load(z, i)
        xx, yy, zz = fma(a, a, xx), fma(b, b, yy), fma(c, c, zz)
        xy, xz, yz = fma(a, b, xy), fma(a, c, xz), fma(b, c, yz)
        low, high = smaller(low, c), larger(high, c)
    return (
        lane_sum(xx) / n, lane_sum(yy) / n, lane_sum(zz) / n, lane_sum(xy) / n, lane_sum(xz) / n, lane_sum(yz) / n,
        lane_min(low), lane_max(high),
    )  # fmt: skip


@inner
def _turned(
    x: np.ndarray, y: np.ndarray, n: int, cos: float, sin: float, u: np.ndarray, v: np.ndarray
) -> tuple[float, float]:
    """Places along and across the main axis; returns length and width."""
    c, s, none = splat(np.float32(cos)), splat(np.float32(sin)), splat(np.float32(0.0))
    u_low, u_high, v_low, v_high = none, none, none, none
    for i in range(0, n, LANES):
        a, b = load(x, i), load(y, i)
        along, across = fma(c, a, s * b), c * b - s * a
        store(u, i, along)
        store(v, i, across)
        u_low, u_high = smaller(u_low, along), larger(u_high, along)
        v_low, v_high = smaller(v_low, across), larger(v_high, across)
    return lane_max(u_high) - lane_min(u_low), lane_max(v_high) - lane_min(v_low)


@inner
def _axes(cxx: float, cxy: float, cyy: float) -> tuple[float, float, float]:
    """Cosine and sine of the main axis of a 2x2 covariance, and the ratio of its eigenvalues."""
    half, root = 0.5 * (cxx + cyy), math.sqrt(0.25 * (cxx - cyy) * (cxx - cyy) + cxy * cxy)
    angle = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
    return math.cos(angle), math.sin(angle), (half + root) / max(half - root, 1e-6)


@inner
def _eigen_columns(cxx: float, cyy: float, czz: float, cxy: float, cxz: float, cyz: float, row: np.ndarray) -> None:
    """Eigenvalues of the symmetric 3x3 covariance in closed form (Smith, CACM 1961), and what follows from them."""
    off = cxy * cxy + cxz * cxz + cyz * cyz
    mean = (cxx + cyy + czz) / 3.0
    dx, dy, dz = cxx - mean, cyy - mean, czz - mean
    spread = math.sqrt((dx * dx + dy * dy + dz * dz + 2.0 * off) / 6.0)
    large = middle = small = mean
    if spread > 1e-12:
        a, b, c = dx / spread, dy / spread, dz / spread
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


@inner
def _rank_columns(
    z: np.ndarray, n: int, low: float, tall: float, base: float, bins: np.ndarray, row: np.ndarray
) -> None:
    """Height percentiles, relative to the ground, from the counts of 256 bins, in which heights count as evenly spread:
    to a 256th of the cluster's height, millimetres where a return is known to centimetres."""
    lowest, per_m = splat(np.float32(low)), splat(np.float32((_BINS - 1) / tall if tall > 1e-6 else 0.0))
    for i in range(0, n, LANES):
        store(bins, i, smaller(whole((load(z, i) - lowest) * per_m), np.int32(_BINS - 1)))
    count, quarter = np.zeros(_BINS, np.int32), n // 4
    for i in range(n):
        count[np.uint32(bins[in_turn(i, quarter)])] += 1
    ranks, b, held, before, bin_m = np.empty(6, np.float32), -1, 0, 0, tall / (_BINS - 1)
    for j in range(6):
        k = int(RANKS[j] * (n - 1))
        while k >= before + held:
            b, before = b + 1, before + held
            held = count[b]
        ranks[j] = low + min((b + (k - before + 0.5) / held) * bin_m, tall)
    row[6], row[24], row[7] = base + ranks[2], base + ranks[3], base + ranks[4]
    row[20] = ranks[5] - ranks[0]
    row[30] = (ranks[1] - ranks[0]) / tall if tall > 1e-6 else 0.0


@inner
def _slice_columns(
    u: np.ndarray, v: np.ndarray, z: np.ndarray, n: int, low: float, high: float, row: np.ndarray
) -> None:
    """Five equal height slices: share of points, extent along both axes, spread of the diagonals."""
    tall = high - low
    mean = square = share_mean = share_square = 0.0
    for s in range(SLICES):
        count, length, width = _slice(u, v, z, n, low, high, s)
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


@inline
def _slice(u, v, z, n, low, high, s):  # type: ignore[no-untyped-def]
    """How many points slice ``s`` has, and their extents. The topmost point is in none, as in the article."""
    lowest, per_m = splat(low), splat(np.float32(SLICES / (high - low) if high - low > 1e-6 else 0.0))
    top, none, number = splat(high), splat(np.float32(_LARGE_M)), splat(np.int32(0))
    u_low, v_low, u_high, v_high = none, none, none * np.float32(-1.0), none * np.float32(-1.0)
    for i in range(0, n, LANES):
        height, along, across = load(z, i), load(u, i), load(v, i)
        layer = smaller(whole((height - lowest) * per_m), np.int32(SLICES - 1))
        here = (layer == np.int32(s)) & (height < top) & (lanes() < np.int32(n - i))
        number += ones(here)
        u_low, u_high = select(here, smaller(u_low, along), u_low), select(here, larger(u_high, along), u_high)
        v_low, v_high = select(here, smaller(v_low, across), v_low), select(here, larger(v_high, across), v_high)
    return lane_sum(number), lane_max(u_high) - lane_min(u_low), lane_max(v_high) - lane_min(v_low)
