"""Compiled passes over all points: level, clip, polar cell, count heights, ground label, compaction.

Points become planar (one float32 array per axis). A block of them goes through a pass before the next one is read.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner, kernel
from services.infra_lidar.kernels_heights import bin_places, cell_heights
from services.infra_lidar.kernels_returns import BLOCK, PI, angle, columns_of, fetch_ahead, whole_block
from services.infra_lidar.kernels_surface import flat_surface, sloped_surface
from services.infra_lidar.vectors import (
    LANES,
    fma,
    gather,
    gather_listed,
    lane_count,
    lane_sum,
    lanes,
    larger,
    load,
    ones,
    root,
    select,
    smaller,
    splat,
    store,
    store_chosen,
    whole,
)

CLIPPED = np.int32(-1)  # outside the range or height limits
NO_RETURN_M2 = np.float32(0.25)  # the housing; drivers also write (0, 0, 0) where nothing came back
FAR_M, FAR_M2 = np.float32(1e4), np.float32(1e8)
NOT_A_NUMBER = np.float32(np.nan)
ROAD_CELL_M = np.float32(0.5)


SETTINGS = np.dtype(
    [(name, np.float32) for name in (
        "range_max_m", "height_min_m", "height_max_m", "ring_m", "limit_base_m", "limit_slope",
        "limit_max_m", "below_m", "above_m", "max_step", "step_up_m", "step_down_m", "first_place",
    )]
    + [("percentile", np.float64), ("sectors", np.int64), ("min_points", np.int64)]
    + [("keep_below", np.bool_), ("flat", np.bool_)]
)  # fmt: skip


@kernel
def find_ground(  # type: ignore[no-untyped-def]
    points,
    T,
    settings,
    near_m,
    histogram,
    fours,
    number,
    height,
    surface,
    accepted,
    x,
    y,
    z,
    cell,
    ground,
    others,
    rest,
):
    """Level (N, 3+) float32 points, find the road in them, label it, and gather the rest: see the steps.

    settings: (1,) ``SETTINGS``. surface (rings, sectors, 3), accepted (rings, sectors). Returns (M, returns, those of
    them closer than near_m).
    """
    s = settings[0]
    returns, near = level(points, T, s, near_m, histogram, x, y, z, cell)
    cell_heights(histogram, fours, s, number, height)
    fit = height.reshape(accepted.shape)
    if s.flat:
        flat_surface(fit, s, surface, accepted)
    else:
        sloped_surface(fit, s, surface, accepted)
    planes = surface.reshape(number.shape[0], 3)
    return label_ground(x, y, z, cell, planes, s, ground, others, rest), returns, near


@kernel
def find_known(sensor, source, T, settings, road, ground, others, rest):  # type: ignore[no-untyped-def]
    """The same with a road that is known already, for n returns that are planar already, sensor (3, n or more) float32,
    and not counted; their index in the whole frame, source (n,), goes to rest. Returns M.

    road (side, side) float32: its height on squares of ``ROAD_CELL_M`` about the origin, NaN outside the limits. That
    is one look-up a point, where the polar grid takes three, and an angle.
    """
    s = settings[0]
    a, b, c, n, m, flat = sensor[0], sensor[1], sensor[2], len(source), 0, road.reshape(road.size)
    to_x, to_y, to_z, to_height = others[0], others[1], others[2], others[3]
    low, above, lowest = splat(-s.below_m), splat(s.above_m), splat(-s.below_m if s.keep_below else -FAR_M)
    z_min, z_max, side, per_m = splat(s.height_min_m), splat(s.height_max_m), len(road), splat(1 / ROAD_CELL_M)
    half, last = splat(np.float32(side // 2)), splat(np.int32(side - 1))
    for i in range(0, n, LANES):
        x, y, z = _turned(load(a, i), load(b, i), load(c, i), T)
        row, column = whole(fma(y, per_m, half)), whole(fma(x, per_m, half))
        row, column = smaller(larger(row, 0), last), smaller(larger(column, 0), last)
        height = z - gather(flat, row * np.int32(side) + column)
        there = (z >= z_min) & (z <= z_max) & (lanes() < np.int32(n - i))
        store(ground, i, there & (height >= low) & (height <= above))
        other = there & ((height > above) | (height < lowest))
        found = lane_count(other)
        if found > 0:
            store_chosen(to_x, m, x, other)
            store_chosen(to_y, m, y, other)
            store_chosen(to_z, m, z, other)
            store_chosen(to_height, m, height, other)
            store_chosen(rest, m, load(source, i), other)
            m += found
    return m


@inner
def level(points, T, s, near_m, histogram, x, y, z, cell):  # type: ignore[no-untyped-def]
    """Rotate and shift (N, 3+) float32 sensor-frame points into planar level-frame x, y, z (N,) float32.

    cell (N,) int16 is the polar cell, ring * sectors + sector, or CLIPPED. Points closer than half a metre or not
    finite get z = NaN and are clipped. histogram (cells, bins) uint16, cleared, counts heights, the first bin beginning
    at ``s.first_place``; those outside go to the end bins. All outputs have room for a vector more. Returns (returns,
    those of them closer than near_m).
    """
    n, width = points.shape
    flat, counts = points.reshape(points.size), histogram.reshape(histogram.size)
    at, returns, near = np.empty(BLOCK + LANES, np.int32), splat(np.int32(0)), splat(np.int32(0))
    grid, first_place = _polar_grid(s), splat(s.first_place)
    bins, near_m2 = histogram.shape[1], near_m * near_m
    for start in range(0, n, BLOCK):
        source, begin = whole_block(flat, width, start, n)
        size, m = min(BLOCK, n - start), 0
        for i in range(0, size, LANES):
            fetch_ahead(flat, (start + i) * width, width)
            a, b, c, _ = columns_of(source, begin + i * width, width)
            squared = fma(a, a, fma(b, b, c * c))
            there = (squared > NO_RETURN_M2) & (squared < FAR_M2)
            returns += ones(there)
            near += ones(there & (squared < near_m2))
            lx, ly, height = _turned(a, b, c, T)
            height = select(there, height, NOT_A_NUMBER)
            store(x, start + i, lx)
            store(y, start + i, ly)
            store(z, start + i, height)
            k, inside = _polar_cell(lx, ly, height, grid)
            store(cell, start + i, select(inside, k, CLIPPED))
            bin_ = smaller(larger(whole(bin_places(height) - first_place), 0), np.int32(bins - 1))
            store_chosen(at, m, k * np.int32(bins) + bin_, inside)
            m += lane_count(inside)
        for i in range(m):
            counts[np.uint32(at[i])] += np.uint16(1)
    return lane_sum(returns), lane_sum(near)


@kernel
def look(points, T, settings, x, y, z, cell, number):  # type: ignore[no-untyped-def]
    """Rotate and shift points as ``level`` does, but count no heights: number (cells,) is 1 where there is a point."""
    n, width = points.shape
    flat, grid = points.reshape(points.size), _polar_grid(settings[0])
    for start in range(0, n, BLOCK):
        source, begin = whole_block(flat, width, start, n)
        for i in range(0, min(BLOCK, n - start), LANES):
            a, b, c, _ = columns_of(source, begin + i * width, width)
            squared = fma(a, a, fma(b, b, c * c))
            lx, ly, height = _turned(a, b, c, T)
            height = select((squared > NO_RETURN_M2) & (squared < FAR_M2), height, NOT_A_NUMBER)
            store(x, start + i, lx)
            store(y, start + i, ly)
            store(z, start + i, height)
            k, inside = _polar_cell(lx, ly, height, grid)
            store(cell, start + i, select(inside, k, CLIPPED))
    for k in range(len(number)):
        number[k] = 0
    for i in range(n):
        if cell[i] >= 0:
            number[np.uint32(cell[i])] = 1


@inline
def _turned(a, b, c, T):  # type: ignore[no-untyped-def]
    """T (a, b, c), T (4, 4) float32."""
    x = fma(a, T[0, 0], fma(b, T[0, 1], fma(c, T[0, 2], T[0, 3])))
    y = fma(a, T[1, 0], fma(b, T[1, 1], fma(c, T[1, 2], T[1, 3])))
    return x, y, fma(a, T[2, 0], fma(b, T[2, 1], fma(c, T[2, 2], T[2, 3])))


@inline
def _polar_grid(s):  # type: ignore[no-untyped-def]
    """What ``_polar_cell`` needs, once for all points: nothing could tell the compiler that it does not change."""
    limits = splat(s.range_max_m), splat(s.height_min_m), splat(s.height_max_m)
    return limits, splat(np.float32(1.0) / s.ring_m), splat(np.float32(s.sectors / (2.0 * np.pi))), splat(s.sectors)


@inline
def _polar_cell(x, y, z, grid):  # type: ignore[no-untyped-def]
    """Polar cell of points, and whether they are inside the limits; if not, the cell means nothing."""
    (range_max_m, z_min_m, z_max_m), per_ring, per_sector, sectors = grid
    radius = root(fma(x, x, y * y))
    inside = (radius <= range_max_m) & (z >= z_min_m) & (z <= z_max_m)
    sector = smaller(whole((angle(y, x) + PI) * per_sector), sectors - 1)
    return whole(radius * per_ring) * sectors + sector, inside


@inner
def label_ground(x, y, z, cell, surface, s, ground, points, rest):  # type: ignore[no-untyped-def]
    """Label ground and gather the rest.

    surface (cells, 3) float32: z of the road at (x, y) is s0 + s1 x + s2 y. Writes ground (N,) bool, and for the
    M other points inside the limits x, y, z and height above the road to points (4, N) float32 and their index to rest;
    returns M. Points below the band are no obstacle (mirror images in
    puddles, ditches) unless ``s.keep_below``. Outputs have room for a vector more, and so have x, y, z and cell.
    """
    n, m = ground.shape[0], 0
    planes, flat = _planes(surface)
    s0, s1, s2 = planes[0][1:], planes[1][1:], planes[2][1:]
    to_x, to_y, to_z, to_height = points[0], points[1], points[2], points[3]
    low, above, lowest = -s.below_m, s.above_m, -s.below_m if s.keep_below else -FAR_M
    for i in range(0, n, LANES):
        height = load(z, i) - gather_listed(s0, cell, i)
        if not flat:
            height -= fma(load(x, i), gather_listed(s1, cell, i), load(y, i) * gather_listed(s2, cell, i))
        store(ground, i, (height >= low) & (height <= above))
        other = (height > above) | (height < lowest)
        found = lane_count(other)
        if found > 0:
            store_chosen(to_x, m, load(x, i), other)
            store_chosen(to_y, m, load(y, i), other)
            store_chosen(to_z, m, load(z, i), other)
            store_chosen(to_height, m, height, other)
            store_chosen(rest, m, lanes() + np.int32(i), other)
            m += found
    return m


@inner
def _planes(surface):  # type: ignore[no-untyped-def]
    """(3, cells + 1) of the planes, the first for clipped points: no height compares with NaN. And: are all level?"""
    planes, flat = np.full((3, surface.shape[0] + 1), NOT_A_NUMBER), True
    for c in range(surface.shape[0]):
        for k in range(3):
            planes[k, c + 1] = surface[c, k]
        flat &= (surface[c, 1] == 0.0) & (surface[c, 2] == 0.0)
    return planes, flat
