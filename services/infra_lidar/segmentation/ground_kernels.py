"""Compiled passes over the points of a frame: level, low height of each polar cell, ground label."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.infra_lidar.jit import kernel

CLIPPED = -1  # cell of a point outside the range or height limits
MIN_RANGE_M, MAX_RANGE_M = np.float32(0.5), np.float32(1e4)  # nearer is the housing, or (0, 0, 0) for no return
FINE_M = 0.64  # heights up to this far from the calibration plane are counted in fine bins
FINE_PER_M, COARSE_PER_M = 200.0, 50.0  # bins of 5 mm and of 2 cm


class GroundSettings(NamedTuple):
    """``GroundConfig`` with what follows from it: polar grid of rings x sectors, and bins for heights."""

    range_max_m: float
    height_min_m: float
    height_max_m: float
    near_m: float
    ring_m: float
    rings: int
    sectors: int
    bins: int
    first_bin: float  # ``bin_of`` the lowest height
    percentile: float
    min_points: int
    limit_base_m: float
    limit_slope: float
    limit_max_m: float
    max_step: float
    step_up_m: float
    step_down_m: float
    below_m: float
    above_m: float
    hole_m: float  # points below this height above the road are obstacles, too; -inf = none are


class Levelled(NamedTuple):
    """N points of a frame in the level frame.

    x, y, z: (N,) float32 m, z is NaN where there is no return. cell: (N,) int32, ring * sectors + sector, or
    ``CLIPPED``. returns: number of returns. near: number of those closer than ``near_m``.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    cell: np.ndarray
    returns: int
    near: int


@kernel
def level(
    points: np.ndarray, T_level_sensor: np.ndarray, near_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """x, y, z, returns and near of ``Levelled`` for (N, 3+) float32 points (m, sensor frame) and (4, 4) float32."""
    n, T = len(points), T_level_sensor
    x, y, z = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    returns, near, near_m2 = 0, 0, np.float32(near_m**2)
    for i in range(n):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        squared = a * a + b * b + c * c
        is_return = (squared > MIN_RANGE_M**2) & (squared < MAX_RANGE_M**2)
        returns += is_return
        near += is_return & (squared < near_m2)
        x[i] = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
        y[i] = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
        z[i] = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3] if is_return else np.float32(np.nan)
    return x, y, z, returns, near


@kernel
def polar_cells(x: np.ndarray, y: np.ndarray, z: np.ndarray, azimuth: np.ndarray, s: GroundSettings) -> np.ndarray:
    """cell of ``Levelled``; azimuth: (N,) float32 rad, arctan2(y, x)."""
    cell = np.full(len(x), CLIPPED, np.int32)
    for i in range(len(x)):
        radius = np.sqrt(x[i] * x[i] + y[i] * y[i])
        if radius <= s.range_max_m and s.height_min_m <= z[i] <= s.height_max_m:
            sector = int((azimuth[i] + np.pi) / (2.0 * np.pi) * s.sectors)
            cell[i] = int(radius / s.ring_m) * s.sectors + min(sector, s.sectors - 1)
    return cell


@kernel
def cell_heights(levelled: Levelled, s: GroundSettings, histogram: np.ndarray) -> np.ndarray:
    """(rings, sectors) float32 low percentile of the heights in each cell, NaN where there are too few points.

    It is the point of rank max(1, int(percentile * n)) from below. histogram: (rings * sectors, bins) int32 scratch,
    zero before and after.
    """
    cells = s.rings * s.sectors
    count, height = np.zeros(cells, np.int32), np.full(cells, np.nan, np.float32)
    for i in range(len(levelled.cell)):
        c = levelled.cell[i]
        if c != CLIPPED:
            b = int(bin_of(levelled.z[i]) - s.first_bin)
            histogram[c, min(max(b, 0), s.bins - 1)] += 1
            count[c] += 1
    for c in range(cells):
        if count[c] >= s.min_points:
            rank = max(1, int(s.percentile * count[c]))
            height[c] = height_of(s.first_bin + _place_of_rank(histogram[c], rank))
        if count[c] > 0:
            histogram[c, :] = 0
    return height.reshape(s.rings, s.sectors)


@kernel
def bin_of(height_m: float) -> float:
    """Position of a height on the scale of the bins; 0 is height 0."""
    fine = min(max(height_m, -FINE_M), FINE_M)
    return fine * FINE_PER_M + (height_m - fine) * COARSE_PER_M


@kernel
def height_of(place: float) -> float:
    """Height (m) at a position on the scale of the bins."""
    fine = min(max(place, -FINE_M * FINE_PER_M), FINE_M * FINE_PER_M)
    return fine / FINE_PER_M + (place - fine) / COARSE_PER_M


@kernel
def _place_of_rank(histogram: np.ndarray, rank: int) -> float:
    """Bin, and place within it, of the point of a rank; the points of a bin are taken as evenly spread."""
    below, b = 0, 0
    while below + histogram[b] <= rank and b < len(histogram) - 1:
        below += histogram[b]
        b += 1
    return b + (rank - below + 0.5) / max(histogram[b], 1)


@kernel
def label_ground(
    levelled: Levelled, surface: np.ndarray, s: GroundSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compare each point with the road plane of its cell.

    surface: (rings, sectors, 3) float32, road height is s0 + s1 x + s2 y. Returns points, index and is_ground of
    ``ground.Obstacles``.
    """
    n, m = len(levelled.cell), 0
    points, index, is_ground = np.empty((n, 4), np.float32), np.empty(n, np.int32), np.zeros(n, np.bool_)
    planes = surface.reshape(-1, 3)
    for i in range(n):
        c = levelled.cell[i]
        if c == CLIPPED:
            continue
        x, y, z = levelled.x[i], levelled.y[i], levelled.z[i]
        above = z - (planes[c, 0] + planes[c, 1] * x + planes[c, 2] * y)
        is_ground[i] = -s.below_m <= above <= s.above_m
        if above > s.above_m or above < s.hole_m:
            points[m, 0], points[m, 1], points[m, 2], points[m, 3] = x, y, z, above
            index[m] = i
            m += 1
    return points[:m], index[:m], is_ground


class RoadMap(NamedTuple):
    """Road height on a square grid about the origin: (side, side) float32 m, NaN beyond the range; cell size m."""

    height_m: np.ndarray
    cell_m: float


@kernel
def label_with_map(
    foreground: np.ndarray, frame_index: np.ndarray, T_level_sensor: np.ndarray, road: RoadMap, s: GroundSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Level the foreground and compare it with a known road: one look-up per point, no angle and no surface fit.

    foreground: (n, 3) float32 m, sensor frame, all of them returns. frame_index: (n,) int32 index in the frame.
    Returns points, index and is_ground (n,) of ``ground.Obstacles``.
    """
    n, m, T = len(foreground), 0, T_level_sensor
    points, index, is_ground = np.empty((n, 4), np.float32), np.empty(n, np.int32), np.zeros(n, np.bool_)
    side, per_m = len(road.height_m), np.float32(1.0 / road.cell_m)
    for i in range(n):
        a, b, c = foreground[i, 0], foreground[i, 1], foreground[i, 2]
        x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
        y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
        z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
        row = min(max(int(y * per_m + side // 2), 0), side - 1)
        column = min(max(int(x * per_m + side // 2), 0), side - 1)
        above = z - road.height_m[row, column]
        if not s.height_min_m <= z <= s.height_max_m:
            continue
        is_ground[i] = -s.below_m <= above <= s.above_m
        if above > s.above_m or above < s.hole_m:
            points[m, 0], points[m, 1], points[m, 2], points[m, 3] = x, y, z, above
            index[m] = frame_index[i]
            m += 1
    return points[:m], index[:m], is_ground
