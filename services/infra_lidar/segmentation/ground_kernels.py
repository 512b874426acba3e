"""Compiled passes over the points of a frame: level, low height of each polar cell, ground label."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.infra_lidar.jit import kernel
from services.infra_lidar.segmentation.azimuth import azimuth_of

CLIPPED = -1  # cell of a point outside the range or height limits
MIN_RANGE_M, MAX_RANGE_M = np.float32(0.5), np.float32(1e4)  # nearer is the housing, or (0, 0, 0) for no return
FINE_M = 0.64  # heights up to this far from the calibration plane are counted in fine bins
FINE_PER_M, COARSE_PER_M = 200.0, 50.0  # bins of 5 mm and of 2 cm
BLOCK = 16  # bins that are added at once


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
    n, returns, near, near_m2 = len(points), np.int32(0), np.int32(0), np.float32(near_m**2)
    x, y, z = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    for i in range(n):  # columns first: the compiler vectorises the loop below only over arrays in one piece
        x[i], y[i], z[i] = points[i, 0], points[i, 1], points[i, 2]
    xx, xy, xz, x0 = T_level_sensor[0]
    yx, yy, yz, y0 = T_level_sensor[1]
    zx, zy, zz, z0 = T_level_sensor[2]
    for i in range(n):
        a, b, c = x[i], y[i], z[i]
        squared = a * a + b * b + c * c
        is_return = (squared > MIN_RANGE_M**2) & (squared < MAX_RANGE_M**2)
        returns += np.int32(is_return)
        near += np.int32(is_return & (squared < near_m2))
        x[i] = xx * a + xy * b + xz * c + x0
        y[i] = yx * a + yy * b + yz * c + y0
        z[i] = zx * a + zy * b + zz * c + z0 if is_return else np.float32(np.nan)
    return x, y, z, int(returns), int(near)


@kernel
def polar_cells(x: np.ndarray, y: np.ndarray, z: np.ndarray, s: GroundSettings) -> np.ndarray:
    """cell of ``Levelled``, of its x, y and z."""
    azimuth, cell, sectors = azimuth_of(x, y), np.empty(len(x), np.int32), np.int32(s.sectors)
    range_max_m, low_m, high_m = np.float32(s.range_max_m), np.float32(s.height_min_m), np.float32(s.height_max_m)
    per_m, per_rad = np.float32(1.0 / s.ring_m), np.float32(s.sectors / (2.0 * np.pi))
    for i in range(len(x)):
        radius = np.sqrt(x[i] * x[i] + y[i] * y[i])
        sector = min(np.int32((azimuth[i] + np.float32(np.pi)) * per_rad), sectors - np.int32(1))
        inside = (radius <= range_max_m) & (z[i] >= low_m) & (z[i] <= high_m)
        cell[i] = np.int32(radius * per_m) * sectors + sector if inside else np.int32(CLIPPED)
    return cell


@kernel
def cell_heights(levelled: Levelled, s: GroundSettings, histogram: np.ndarray) -> np.ndarray:
    """(rings, sectors) float32 low percentile of the heights in each cell, NaN where there are too few points.

    It is the point of rank max(1, int(percentile * n)) from below. histogram: (rings * sectors, bins) int32 scratch,
    zero before and after.
    """
    cells, flat = s.rings * s.sectors, histogram.reshape(-1)
    place = _histogram_places(levelled.z, levelled.cell, s)
    for i in range(len(place)):
        if place[i] >= 0:
            flat[place[i]] += 1
    height = np.full(cells, np.nan, np.float32)
    for c in range(cells):
        count = histogram[c].sum()
        if count >= s.min_points:
            rank = max(1, int(s.percentile * count))
            height[c] = height_of(s.first_bin + _place_of_rank(histogram[c], rank))
        if count > 0:
            histogram[c, :] = 0
    return height.reshape(s.rings, s.sectors)


@kernel
def _histogram_places(z: np.ndarray, cell: np.ndarray, s: GroundSettings) -> np.ndarray:
    """(N,) int32: cell * bins + bin of each point, negative where the point is clipped."""
    place, bins = np.empty(len(z), np.int32), np.int32(s.bins)
    for i in range(len(z)):
        b = np.int32(bin_of(z[i]) - s.first_bin)
        place[i] = cell[i] * bins + min(max(b, np.int32(0)), bins - np.int32(1))
    return place


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
    """Bin, and place within it, of the point of a rank; the points of a bin are taken as evenly spread.

    Blocks of bins are added first: most of them are empty.
    """
    below, b, block = 0, 0, 0
    while b + BLOCK < len(histogram):
        block = 0
        for k in range(b, b + BLOCK):
            block += histogram[k]
        if below + block > rank:
            break
        below, b = below + block, b + BLOCK
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
    x, y, z, cell = levelled.x, levelled.y, levelled.z, levelled.cell
    n, planes = len(cell), surface.reshape(-1, 3)
    above = np.empty(n, np.float32)
    for i in range(n):
        c = max(cell[i], 0)
        road_z = planes[c, 0] + planes[c, 1] * x[i] + planes[c, 2] * y[i]
        above[i] = z[i] - road_z if cell[i] != CLIPPED else np.float32(np.nan)
    index, is_ground = _split(above, s)
    points = np.empty((len(index), 4), np.float32)
    for m in range(len(index)):
        i = index[m]
        points[m, 0], points[m, 1], points[m, 2], points[m, 3] = x[i], y[i], z[i], above[i]
    return points, index, is_ground


@kernel
def _split(above_m: np.ndarray, s: GroundSettings) -> tuple[np.ndarray, np.ndarray]:
    """Index (M,) int32 of the obstacles and is_ground (N,) bool, of heights above the road (N,) float32.

    NaN is neither. No branch depends on a point, so that the processor need not guess.
    """
    n, m = len(above_m), np.uint32(0)
    index, is_ground, is_obstacle = np.empty(n, np.int32), np.empty(n, np.bool_), np.empty(n, np.uint8)
    low, high, hole = np.float32(-s.below_m), np.float32(s.above_m), np.float32(s.hole_m)
    for i in range(n):
        is_ground[i] = (above_m[i] >= low) & (above_m[i] <= high)
        is_obstacle[i] = (above_m[i] > high) | (above_m[i] < hole)
    for i in range(n):
        index[m] = i
        m += np.uint32(is_obstacle[i])
    return index[:m], is_ground


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
    x, y, z, _, _ = level(foreground, T_level_sensor, 0.0)
    place, flat, above = _places_on_map(x, y, road), road.height_m.reshape(-1), np.empty(len(z), np.float32)
    low_m, high_m = np.float32(s.height_min_m), np.float32(s.height_max_m)
    for i in range(len(z)):
        above[i] = flat[np.uint32(place[i])]
    for i in range(len(z)):
        above[i] = z[i] - above[i] if (z[i] >= low_m) & (z[i] <= high_m) else np.float32(np.nan)
    chosen, is_ground = _split(above, s)
    points, index = np.empty((len(chosen), 4), np.float32), np.empty(len(chosen), np.int32)
    for m in range(len(chosen)):
        i = chosen[m]
        points[m, 0], points[m, 1], points[m, 2], points[m, 3] = x[i], y[i], z[i], above[i]
        index[m] = frame_index[i]
    return points, index, is_ground


@kernel
def _places_on_map(x: np.ndarray, y: np.ndarray, road: RoadMap) -> np.ndarray:
    """(N,) int32: row * side + column of x and y (N,) float32 (m); positions outside count to the outermost squares."""
    place, side, per_m = np.empty(len(x), np.int32), np.int32(len(road.height_m)), np.float32(1.0 / road.cell_m)
    half, last = np.float32(side // 2), side - np.int32(1)
    for i in range(len(x)):  # apart from the look-up, so that the compiler vectorises it
        row = min(max(np.int32(y[i] * per_m + half), np.int32(0)), last)
        place[i] = row * side + min(max(np.int32(x[i] * per_m + half), np.int32(0)), last)
    return place
