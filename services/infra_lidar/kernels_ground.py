"""Compiled passes over all points: level, clip, polar cell, height histogram, ground label, compaction.

Points are kept planar (one float32 array per axis) and are handled in blocks that stay in the first-level cache, one
output per inner loop, so that each of them vectorises.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, kernel

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
def level(points, T, near_m, x, y, z):  # type: ignore[no-untyped-def]
    """Rotate and shift (N, 3+) float32 sensor-frame points into planar level-frame x, y, z (N,) float32.

    Points closer than NO_RETURN_M or not finite get z = NaN. Returns (returns, those of them closer than near_m).
    """
    r00, r01, r02, tx = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    r10, r11, r12, ty = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    r20, r21, r22, tz = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    least, most, near2 = NO_RETURN_M * NO_RETURN_M, FAR_M * FAR_M, near_m * near_m
    a, b, c = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    squared = np.empty(BLOCK, np.float32)
    near, returns = 0, 0
    for start in range(0, points.shape[0], BLOCK):
        n = min(BLOCK, points.shape[0] - start)
        block = points[start : start + n]
        bx, by, bz = x[start : start + n], y[start : start + n], z[start : start + n]
        for i in range(n):  # the only loop that reads the interleaved rows
            a[i], b[i], c[i] = block[i, 0], block[i, 1], block[i, 2]
        for i in range(n):
            squared[i] = a[i] * a[i] + b[i] * b[i] + c[i] * c[i]
        for i in range(n):
            bx[i] = r00 * a[i] + r01 * b[i] + r02 * c[i] + tx
        for i in range(n):
            by[i] = r10 * a[i] + r11 * b[i] + r12 * c[i] + ty
        for i in range(n):
            h = r20 * a[i] + r21 * b[i] + r22 * c[i] + tz
            bz[i] = h if (squared[i] > least) & (squared[i] < most) else NOT_A_NUMBER
        block_returns, block_near = np.int32(0), np.int32(0)
        for i in range(n):
            block_returns += np.int32((squared[i] > least) & (squared[i] < most))
        for i in range(n):
            block_near += np.int32((squared[i] > least) & (squared[i] < near2))
        returns += block_returns
        near += block_near
    return returns, near


@kernel
def polar_cells(x, y, z, origin_x, origin_y, range_max, z_min, z_max, ring, sectors, cell):  # type: ignore[no-untyped-def]
    """Polar cell of every point: ring * sectors + sector, or CLIPPED. ``cell`` is (N,) int16, written."""
    n = x.shape[0]
    radius = np.empty(BLOCK, np.float32)
    sector = np.empty(BLOCK, np.float32)
    per_ring = np.float32(1.0) / ring
    per_sector = np.float32(sectors / (2.0 * np.pi))
    last = np.int32(sectors - 1)
    for start in range(0, n, BLOCK):
        stop = min(start + BLOCK, n)
        bx, by, bz, bc = x[start:stop], y[start:stop], z[start:stop], cell[start:stop]
        for i in range(stop - start):
            dx, dy = bx[i] - origin_x, by[i] - origin_y
            radius[i] = np.sqrt(dx * dx + dy * dy)
        for i in range(stop - start):
            sector[i] = (_angle(by[i] - origin_y, bx[i] - origin_x) + PI) * per_sector
        for i in range(stop - start):
            s = min(np.int32(sector[i]), last)
            c = np.int32(radius[i] * per_ring) * np.int32(sectors) + s
            inside = (radius[i] <= range_max) & (bz[i] >= z_min) & (bz[i] <= z_max)
            bc[i] = np.int16(c) if inside else CLIPPED


@kernel
def height_histograms(cell, z, hist_min, histogram, count):  # type: ignore[no-untyped-def]
    """Fill histogram (cells, bins) uint16 of 1 cm and count (cells,) int32; heights outside go to the end bins."""
    histogram[:] = 0
    count[:] = 0
    top = histogram.shape[1] - 1
    per_m = np.float32(1.0 / BIN_M)
    for i in range(cell.shape[0]):
        c = cell[i]
        if c >= 0:
            b = np.int32((z[i] - hist_min) * per_m)
            b = min(max(b, 0), top)
            histogram[c, b] += np.uint16(1)
            count[c] += 1


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
def label_ground(x, y, z, cell, surface, below, above, keep_below, ground, above_ground, rest):  # type: ignore[no-untyped-def]
    """Label ground and gather the rest.

    surface (cells, 3) float32: z of the road at (x, y) is s0 + s1 x + s2 y. Writes ground (N,) bool, and for the
    M other points inside the limits their height above the road and their index; returns M.
    Points below the band are no obstacle (mirror images in puddles, ditches) unless ``keep_below``.
    """
    n, m = cell.shape[0], 0
    height = np.empty(BLOCK, np.float32)
    for start in range(0, n, BLOCK):
        stop = min(start + BLOCK, n)
        bx, by, bz, bc, bg = x[start:stop], y[start:stop], z[start:stop], cell[start:stop], ground[start:stop]
        for i in range(stop - start):
            c = max(bc[i], 0)
            h = bz[i] - (surface[c, 0] + surface[c, 1] * bx[i] + surface[c, 2] * by[i])
            height[i] = h if bc[i] >= 0 else NOT_A_NUMBER  # fails every comparison below
        for i in range(stop - start):
            bg[i] = (height[i] >= -below) & (height[i] <= above)
        for i in range(stop - start):  # without branches: the next point overwrites what is not kept
            rest[m] = start + i
            above_ground[m] = height[i]
            m += (height[i] > above) | (keep_below & (height[i] < -below))
    return m


@kernel
def beams_seen(rings, seen):  # type: ignore[no-untyped-def]
    """Number of different rings. rings (N,) float32, seen (256,) bool scratch."""
    seen[:] = False
    for i in range(rings.shape[0]):
        seen[np.uint8(rings[i])] = True
    return seen.sum()
