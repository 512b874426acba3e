"""The compiled loops behind ``features.py``: moments, extents, height percentiles, slices and the hull from above.

One cluster at a time is copied about its mean, so that float32 stays exact to micrometres. Each function fills a run of
neighbouring columns; the tuples of names below say which.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.classification.band_kernels import BAND_NAMES, band_columns
from services.infra_lidar.jit import kernel

SLICES = 5
DIRECTIONS = 8  # of the supporting lines around the hull; each is used to both sides
MOST_POINTS = 1024  # of a cluster, fewer are looked at: more hardly change its features
RANKS = (0.05, 0.10, 0.25, 0.50, 0.75, 0.95)

EXTENT_NAMES = (
    "num_points", "x_range", "y_range", "xy_spread", "xy_area", "z_range", "height_to_footprint", "density",
    "bbox_volume", "z_bottom", "z_top", "range_m", "points_by_range",
)  # fmt: skip
EIGEN_NAMES = ("z_std", "scattering", "linearity", "planarity", "ev_norm_0", "ev_norm_1", "ev_norm_2")
HEIGHT_NAMES = ("z_25", "z_median", "z_75", "z_range_cleaned", "ground_gap_ratio")
SLICE_NAMES = (
    *(f"layer_frac_{s}" for s in range(SLICES)),
    *(f"slice_length_{s}" for s in range(SLICES)),
    *(f"slice_width_{s}" for s in range(SLICES)),
    "cross_section_mean", "cross_section_var", "vertical_uniformity", "bottom_to_top_ratio",
)  # fmt: skip
FEATURE_NAMES: tuple[str, ...] = (
    *EXTENT_NAMES, *EIGEN_NAMES, *HEIGHT_NAMES, *SLICE_NAMES, "xy_aspect_ratio", "hull_fill", *BAND_NAMES,
)  # fmt: skip
_EIGEN = len(EXTENT_NAMES)
_HEIGHT = _EIGEN + len(EIGEN_NAMES)
_SLICE = _HEIGHT + len(HEIGHT_NAMES)
_ASPECT = _SLICE + len(SLICE_NAMES)
_HULL = _ASPECT + 1
_BAND = _HULL + 1
_BINS = 256
_EPS = 1e-9
_MILLIONTHS = np.float32(1e6)
_STEP_RAD = math.pi / DIRECTIONS


@kernel
def cluster_features(
    points: np.ndarray, offsets: np.ndarray, ground_z_m: np.ndarray, hull: bool, bands: bool, out: np.ndarray
) -> None:
    """Fill out (K, F) float32, columns as in ``FEATURE_NAMES``.

    points (M, 3+) float32 grouped by offsets (K + 1,), none of the clusters empty; ground_z_m (K,) float32.
    ``hull_fill`` is 0 without ``hull``, ``BAND_NAMES`` are without ``bands``. Of a cluster with
    ``MOST_POINTS`` points or more every second, third ... point is looked at.
    """
    for k in range(len(offsets) - 1):
        number = offsets[k + 1] - offsets[k]
        cluster = points[offsets[k] : offsets[k + 1] : number // MOST_POINTS + 1]
        local = np.empty((5, len(cluster)), np.float32)  # each row in one piece
        mean = _centre(cluster, local)
        _fill_row(local, mean, ground_z_m[k], hull, bands, out[k])
        _count_columns(number, out[k])


@kernel
def _centre(cluster: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Write x, y, z about the mean into local[0:3]; returns the mean (3,) float32."""
    n, mean = len(cluster), np.empty(3, np.float32)
    x0, y0, z0 = cluster[0, 0], cluster[0, 1], cluster[0, 2]
    x = y = z = np.float32(0.0)
    for i in range(n):  # about the first point: sums of large coordinates would lose digits
        x, y, z = x + (cluster[i, 0] - x0), y + (cluster[i, 1] - y0), z + (cluster[i, 2] - z0)
    mean[0], mean[1], mean[2] = x0 + x / np.float32(n), y0 + y / np.float32(n), z0 + z / np.float32(n)
    for i in range(n):
        for axis in range(3):
            local[axis, i] = cluster[i, axis] - mean[axis]
    return mean


@kernel
def _fill_row(local: np.ndarray, mean: np.ndarray, ground_z_m: float, hull: bool, bands: bool, row: np.ndarray) -> None:
    """local (5, n): x, y, z about the mean, and room for the place along and across the main axis."""
    z, u, v = local[2], local[3], local[4]
    base = mean[2] - ground_z_m
    row[:] = 0.0
    cos, sin = _moment_columns(local, row)
    length, width = _turn(local, cos, sin)
    low, high = _minmax(z)
    tall, area = high - low, length * width
    spread = math.sqrt(length * length + width * width)
    row[1], row[2], row[3], row[4], row[5] = length, width, spread, area, tall
    row[6] = tall / spread if spread > _EPS else 0.0
    row[8], row[9], row[10] = area * tall, base + low, base + high
    row[11] = math.hypot(mean[0], mean[1])
    _height_columns(z, low, high, base, row)
    _slice_columns(local, low, high, row)
    if bands:
        band_columns(local, mean, base, row[_BAND:])
    if hull and area > 1e-6:
        row[_HULL] = _hull_fill(u, v, length, width)


@kernel
def _count_columns(number: int, row: np.ndarray) -> None:
    """Number of points, density, and points by range: what does not follow from the shape."""
    solid = row[4] * math.sqrt(row[5])
    row[0], row[7] = number, number / solid if solid > 1e-6 else 0.0
    row[12] = math.log(number) + 2.0 * math.log(max(row[11], 1.0))


@kernel
def _minmax(values: np.ndarray) -> tuple[float, float]:
    low = high = values[0]
    for value in values:
        low, high = min(low, value), max(high, value)
    return low, high


@kernel
def _moment_columns(local: np.ndarray, row: np.ndarray) -> tuple[float, float]:
    """What follows from the covariance; returns cosine and sine of the main axis seen from above."""
    x, y, z = local[0], local[1], local[2]
    n = x.size
    xx = yy = zz = xy = xz = yz = np.float32(0.0)
    for i in range(n):
        xx, yy, zz = xx + x[i] * x[i], yy + y[i] * y[i], zz + z[i] * z[i]
        xy, xz, yz = xy + x[i] * y[i], xz + x[i] * z[i], yz + y[i] * z[i]
    xx, yy, zz, xy, xz, yz = xx / n, yy / n, zz / n, xy / n, xz / n, yz / n
    small, middle, large = _eigenvalues(xx, yy, zz, xy, xz, yz)
    total = small + middle + large
    row[_EIGEN] = math.sqrt(zz)
    row[_EIGEN + 1], row[_EIGEN + 2] = small / large, (large - middle) / large
    row[_EIGEN + 3] = (middle - small) / large
    row[_EIGEN + 4], row[_EIGEN + 5], row[_EIGEN + 6] = small / total, middle / total, large / total
    half, root = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy)
    row[_ASPECT] = (half + root) / max(half - root, 1e-6)
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    return math.cos(angle), math.sin(angle)


@kernel
def _eigenvalues(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> tuple[float, float, float]:
    """Rising eigenvalues of a symmetric 3x3 matrix in closed form (Smith, CACM 1961), none below 1e-9."""
    mean = (xx + yy + zz) / 3.0
    dx, dy, dz = xx - mean, yy - mean, zz - mean
    spread = math.sqrt((dx * dx + dy * dy + dz * dz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
    if spread <= 1e-12:
        return max(mean, _EPS), max(mean, _EPS), max(mean, _EPS)
    a, b, c, d, e, f = dx / spread, dy / spread, dz / spread, xy / spread, xz / spread, yz / spread
    half_det = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e))
    phi = math.acos(min(1.0, max(-1.0, half_det))) / 3.0
    large = mean + 2.0 * spread * math.cos(phi)
    small = mean + 2.0 * spread * math.cos(phi + 2.0 * math.pi / 3.0)
    return max(small, _EPS), max(3.0 * mean - large - small, _EPS), max(large, _EPS)


@kernel
def _turn(local: np.ndarray, cos: float, sin: float) -> tuple[float, float]:
    """Write the places along (local[3]) and across (local[4]) the main axis; returns length and width."""
    x, y, u, v = local[0], local[1], local[3], local[4]
    c, s = np.float32(cos), np.float32(sin)
    for i in range(x.size):
        u[i] = c * x[i] + s * y[i]
        v[i] = c * y[i] - s * x[i]
    u_low, u_high = _minmax(u)
    v_low, v_high = _minmax(v)
    return u_high - u_low, v_high - v_low


@kernel
def _height_columns(z: np.ndarray, low: float, high: float, base: float, row: np.ndarray) -> None:
    """Height percentiles above the ground, counted in 256 bins: exact to a 255th of the cluster's height."""
    n, tall = len(z), high - low
    per_m = np.float32((_BINS - 1) / tall if tall > 1e-6 else 0.0)
    count, ranks = np.zeros(_BINS, np.int32), np.empty(6, np.float32)
    for i in range(n):
        count[min(int((z[i] - low) * per_m), _BINS - 1)] += 1
    b, before, bin_m = 0, 0, tall / (_BINS - 1)
    for j in range(6):
        k = int(RANKS[j] * (n - 1))
        while k >= before + count[b]:
            before += count[b]
            b += 1
        ranks[j] = low + min((b + (k - before + 0.5) / count[b]) * bin_m, tall)
    row[_HEIGHT], row[_HEIGHT + 1], row[_HEIGHT + 2] = base + ranks[2], base + ranks[3], base + ranks[4]
    row[_HEIGHT + 3] = ranks[5] - ranks[0]
    row[_HEIGHT + 4] = (ranks[1] - ranks[0]) / tall if tall > 1e-6 else 0.0


@kernel
def _slice_columns(local: np.ndarray, low: float, high: float, row: np.ndarray) -> None:
    """Five equal height slices: share of points, extent along both axes, spread of the diagonals."""
    n, tall = local.shape[1], high - low
    count, extent = _slice_extents(local, low, high)
    mean = square = share_square = 0.0
    for s in range(SLICES):
        share = count[s] / n
        length = extent[s, 1] - extent[s, 0] if count[s] > 2 else 0.0
        width = extent[s, 3] - extent[s, 2] if count[s] > 2 else 0.0
        row[_SLICE + s], row[_SLICE + SLICES + s], row[_SLICE + 2 * SLICES + s] = share, length, width
        mean += math.hypot(length, width) / SLICES
        square += (length * length + width * width) / SLICES
        share_square += share * share / SLICES
    share_mean = np.sum(count) / n / SLICES
    if n > 20 and tall > 0.1:
        row[_SLICE + 15], row[_SLICE + 16] = mean, math.sqrt(max(square - mean * mean, 0.0))
    row[_SLICE + 17] = math.sqrt(max(share_square - share_mean * share_mean, 0.0))
    row[_SLICE + 18] = min(row[_SLICE] / max(row[_SLICE + 4], 1e-6), 1e3)


@kernel
def _slice_extents(local: np.ndarray, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Count (5,) and extent (5, 4) along and across of each slice. The topmost point is in none, as in the article."""
    z, u, v = local[2], local[3], local[4]
    per_m = np.float32(SLICES / (high - low) if high - low > 1e-6 else 0.0)
    count, extent = np.zeros(SLICES, np.int64), np.empty((SLICES, 4), np.float32)
    extent[:, 0] = extent[:, 2] = np.inf
    extent[:, 1] = extent[:, 3] = -np.inf
    for i in range(z.size):
        if z[i] < high:
            s = min(int((z[i] - low) * per_m), SLICES - 1)
            count[s] += 1
            extent[s, 0], extent[s, 1] = min(extent[s, 0], u[i]), max(extent[s, 1], u[i])
            extent[s, 2], extent[s, 3] = min(extent[s, 2], v[i]), max(extent[s, 3], v[i])
    return count, extent


@kernel
def _hull_fill(u: np.ndarray, v: np.ndarray, length: float, width: float) -> float:
    """Area of the tightest polygon with 16 given directions around the points, in areas of their box, length x width.

    Supporting lines enclose the hull and not much more (of a disc 1.3 %, of a triangle up to a fifth). For directions
    that are evenly spread, an edge is (before + after - 2 cos(step) own) / sin(step) of the distances of the lines from
    the mean. A forest that was trained with the hull itself is not better by more than its seed makes.
    """
    support = np.empty(2 * DIRECTIONS)
    for k in range(DIRECTIONS):
        a = np.float32(math.cos(k * _STEP_RAD) / length) * _MILLIONTHS
        b = np.float32(math.sin(k * _STEP_RAD) / width) * _MILLIONTHS
        low = high = np.int32(0)
        for i in range(u.size):  # in millionths: the compiler vectorises minima of whole numbers, not of floats
            reach = np.int32(a * u[i] + b * v[i])
            low, high = min(low, reach), max(high, reach)
        support[k], support[k + DIRECTIONS] = high / _MILLIONTHS, -low / _MILLIONTHS
    area, cos, sin = 0.0, math.cos(_STEP_RAD), math.sin(_STEP_RAD)
    for k in range(2 * DIRECTIONS):
        edge = (support[k - 1] + support[(k + 1) % (2 * DIRECTIONS)] - 2.0 * cos * support[k]) / sin
        area += 0.5 * edge * support[k]
    return area
