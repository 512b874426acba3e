"""Compiled passes over all points: level, clip, polar cell, height histogram, ground label, compaction.

Points are kept planar (one float32 array per axis) and are handled in blocks that stay in the first-level cache, one
output per inner loop, so that each of them vectorises.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, kernel
from services.infra_lidar.kernels_rows import copy_picked, pick_flagged, planar, shift_picked

BLOCK = 2048
BIN_M = 0.01  # resolution of the height histograms
CLIPPED = np.int16(-1)  # outside the range or height limits
NO_RETURN_M = np.float32(0.5)  # the housing; drivers also write (0, 0, 0) where nothing came back
FAR_M = np.float32(1e4)
NOT_A_NUMBER = np.float32(np.nan)
HALF_PI = np.float32(np.pi / 2)
PI = np.float32(np.pi)


@inline
def _angle(y, x):  # type: ignore[no-untyped-def]
    """Angle of (x, y) in radians, error under 2e-6: odd polynomial on [0, 1] and octant folding, free of branches."""
    ax, ay = abs(x), abs(y)
    high, low = max(ax, ay), min(ax, ay)
    a = low / max(high, np.float32(1e-20))
    s = a * a
    p = np.float32(-0.0117212) * s + np.float32(0.05265332)
    p = p * s - np.float32(0.11643287)
    p = p * s + np.float32(0.19354346)
    p = p * s - np.float32(0.33262347)
    p = (p * s + np.float32(0.99997726)) * a
    p = HALF_PI - p if ay > ax else p
    p = PI - p if x < np.float32(0.0) else p
    return -p if y < np.float32(0.0) else p


@kernel
def level(points, T, near_m, limits, ring, sectors, scratch, x, y, z, cell):  # type: ignore[no-untyped-def]
    """Rotate and shift (N, 3+) float32 sensor-frame points into planar level-frame x, y, z (N,) float32.

    limits (3,) float32: largest range, lowest and highest z. cell (N,) int16 is the polar cell, ring * sectors +
    sector, or CLIPPED. Points closer than NO_RETURN_M or not finite get z = NaN and are clipped. scratch (6, BLOCK)
    float32. Returns (returns, those of them closer than near_m).
    """
    near2, near, returns, per_ring = near_m * near_m, 0, 0, np.float32(1.0) / ring
    sensor, squared, sector = scratch[:4], scratch[4], scratch[5]
    for start in range(0, points.shape[0], BLOCK):
        n = min(BLOCK, points.shape[0] - start)
        stop = start + n
        planar(points, start, n, sensor)
        bx, by, bz = x[start:stop], y[start:stop], z[start:stop]
        _turn(sensor[0, :n], sensor[1, :n], sensor[2, :n], T, squared[:n], bx, by, bz)
        block_returns, block_near = count_returns(squared[:n], near2)
        returns += block_returns
        near += block_near
        _polar_cells(bx, by, bz, limits, per_ring, sectors, squared[:n], sector[:n], cell[start:stop])
    return returns, near


@kernel
def level_planar(sensor, n, T, limits, ring, sectors, scratch, x, y, z, cell):  # type: ignore[no-untyped-def]
    """The same for n points that are planar already, sensor (3, n or more) float32, and counted."""
    squared, sector, per_ring = scratch[4], scratch[5], np.float32(1.0) / ring
    for start in range(0, n, BLOCK):
        stop = min(start + BLOCK, n)
        m = stop - start
        bx, by, bz = x[start:stop], y[start:stop], z[start:stop]
        _turn(sensor[0, start:stop], sensor[1, start:stop], sensor[2, start:stop], T, squared[:m], bx, by, bz)
        _polar_cells(bx, by, bz, limits, per_ring, sectors, squared[:m], sector[:m], cell[start:stop])


@kernel
def _turn(a, b, c, T, squared, x, y, z):  # type: ignore[no-untyped-def]
    """x, y, z = T (a, b, c), z = NaN where there was no return; ``squared`` is the squared distance to the sensor."""
    r00, r01, r02, tx = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    r10, r11, r12, ty = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    r20, r21, r22, tz = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    least, most = NO_RETURN_M * NO_RETURN_M, FAR_M * FAR_M
    for i in range(a.shape[0]):
        squared[i] = a[i] * a[i] + b[i] * b[i] + c[i] * c[i]
    for i in range(a.shape[0]):
        x[i] = r00 * a[i] + r01 * b[i] + r02 * c[i] + tx
    for i in range(a.shape[0]):
        y[i] = r10 * a[i] + r11 * b[i] + r12 * c[i] + ty
    for i in range(a.shape[0]):
        h = r20 * a[i] + r21 * b[i] + r22 * c[i] + tz
        z[i] = h if (squared[i] > least) & (squared[i] < most) else NOT_A_NUMBER


@kernel
def count_returns(squared, near2):  # type: ignore[no-untyped-def]
    """(returns, near returns) by squared distance."""
    least, most = NO_RETURN_M * NO_RETURN_M, FAR_M * FAR_M
    returns, near = np.int32(0), np.int32(0)
    for i in range(squared.shape[0]):
        returns += np.int32((squared[i] > least) & (squared[i] < most))
    for i in range(squared.shape[0]):
        near += np.int32((squared[i] > least) & (squared[i] < near2))
    return returns, near


@kernel
def _polar_cells(x, y, z, limits, per_ring, sectors, radius, sector, cell):  # type: ignore[no-untyped-def]
    """Polar cells of a block; ``radius`` and ``sector`` are scratch."""
    range_max, z_min, z_max = limits[0], limits[1], limits[2]
    per_sector, last = np.float32(sectors / (2.0 * np.pi)), np.int32(sectors - 1)
    for i in range(x.shape[0]):
        radius[i] = np.sqrt(x[i] * x[i] + y[i] * y[i])
    for i in range(x.shape[0]):
        sector[i] = (_angle(y[i], x[i]) + PI) * per_sector
    for i in range(x.shape[0]):
        s = min(np.int32(sector[i]), last)
        c = np.int32(radius[i] * per_ring) * np.int32(sectors) + s
        inside = (radius[i] <= range_max) & (z[i] >= z_min) & (z[i] <= z_max)
        cell[i] = np.int16(c) if inside else CLIPPED


@kernel
def height_histograms(cell, z, hist_min, histogram, count):  # type: ignore[no-untyped-def]
    """Fill histogram (cells + 1, bins) uint16 of 1 cm and count (cells,) int32; heights outside go to the end bins.

    The last row is for clipped points, so that nothing has to be decided. Cells are counted afterwards from their
    bins: neighbours in time often share a cell, and adding to one counter again and again waits for memory each time.
    """
    cells, bins = histogram.shape[0] - 1, histogram.shape[1]
    flat = histogram.reshape(histogram.size)
    flat[:] = 0
    per_m, top, clipped = np.float32(1.0 / BIN_M), np.int32(bins - 1), np.int32(cells * bins)
    at = np.empty(BLOCK, np.uint32)
    for start in range(0, cell.shape[0], BLOCK):
        stop = min(start + BLOCK, cell.shape[0])
        bz, bc = z[start:stop], cell[start:stop]
        for i in range(stop - start):
            b = min(max(np.int32((bz[i] - hist_min) * per_m), np.int32(0)), top)
            at[i] = np.uint32(np.int32(bc[i]) * np.int32(bins) + b if bc[i] >= 0 else clipped)
        for i in range(stop - start):
            flat[at[i]] += np.uint16(1)
    for c in range(cells):
        total, row = np.int32(0), histogram[c]
        for b in range(bins):
            total += np.int32(row[b])
        count[c] = total


@kernel
def cell_heights(histogram, count, hist_min, share, min_points, height):  # type: ignore[no-untyped-def]
    """Low percentile of each cell's heights by selection, rank max(1, int(share n)); NaN where too few points."""
    bins = histogram.shape[1]
    for c in range(count.shape[0]):
        n = count[c]
        height[c] = np.nan
        if n < min_points:
            continue
        rank = max(1, int(share * n))
        seen = 0
        for b in range(bins):
            here = histogram[c, b]
            if seen + here > rank:  # inside a bin heights are as good as evenly spread
                height[c] = hist_min + np.float32((b + (rank - seen + 0.5) / here) * BIN_M)
                break
            seen += here


@kernel
def label_ground(x, y, z, cell, surface, below, above, keep_below, height, keep, pick, ground, points, rest):  # type: ignore[no-untyped-def]
    """Label ground and gather the rest.

    surface (cells, 3) float32: z of the road at (x, y) is s0 + s1 x + s2 y. Writes ground (N,) bool, and for the
    M other points inside the limits x, y, z and height above the road to points (4, N) float32 and their index to
    rest; returns M. Points below the band are no obstacle (mirror images in puddles, ditches) unless ``keep_below``.
    height (BLOCK,) float32, keep (BLOCK,) uint8 and pick (BLOCK + 8,) int32 are scratch.
    """
    n, m, words = cell.shape[0], 0, keep.view(np.uint64)
    planes, flat = _planes(surface)
    lowest = -below if keep_below else -FAR_M
    for start in range(0, n, BLOCK):
        stop = min(start + BLOCK, n)
        bx, by, bz, bh = x[start:stop], y[start:stop], z[start:stop], height[: stop - start]
        _heights(bx, by, bz, cell[start:stop], planes, flat, bh)
        keep[stop - start :] = 0
        _choose(bh, below, above, lowest, ground[start:stop], keep)
        picked = pick[: pick_flagged(keep, words, stop - start, pick)]
        last = m + len(picked)
        shift_picked(picked, start, rest[m:last])
        for k, values in enumerate((bx, by, bz, bh)):
            copy_picked(values, picked, points[k, m:last])
        m = last
    return m


@kernel
def _choose(height, below, above, lowest, ground, keep):  # type: ignore[no-untyped-def]
    for i in range(len(height)):
        ground[i] = (height[i] >= -below) & (height[i] <= above)
    for i in range(len(height)):
        keep[i] = (height[i] > above) | (height[i] < lowest)


@kernel
def _planes(surface):  # type: ignore[no-untyped-def]
    """(3, cells + 1) of the planes, the first for clipped points: no height compares with NaN. And: are all level?"""
    planes, flat = np.full((3, surface.shape[0] + 1), NOT_A_NUMBER), True
    for c in range(surface.shape[0]):
        for k in range(3):
            planes[k, c + 1] = surface[c, k]
        flat &= (surface[c, 1] == 0.0) & (surface[c, 2] == 0.0)
    return planes, flat


@kernel
def _heights(x, y, z, cell, planes, flat, height):  # type: ignore[no-untyped-def]
    """Height above the road of a block."""
    s0, s1, s2 = planes[0], planes[1], planes[2]
    if flat:
        for i in range(len(z)):
            height[i] = z[i] - s0[np.uint32(np.int32(cell[i]) + np.int32(1))]
        return
    for i in range(len(z)):
        c = np.uint32(np.int32(cell[i]) + np.int32(1))
        height[i] = z[i] - (s0[c] + s1[c] * x[i] + s2[c] * y[i])


@kernel
def beams_seen(rings, seen):  # type: ignore[no-untyped-def]
    """Number of different rings. rings (N,) float32, seen (256,) bool scratch."""
    seen[:] = False
    for i in range(rings.shape[0]):
        seen[np.uint8(rings[i])] = True
    return seen.sum()
