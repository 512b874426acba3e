"""Features by fixed heights above the road, and how deep a surface is along the line of sight.

A wheel, a hip and a shoulder stand at the same heights whatever part of a body is hidden, which slices of the visible
part do not. Leaves scatter along the beam; paint and cloth do not. Both hold on sensors with other beams.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.jit import kernel

EDGES_M = np.array([0.35, 0.7, 1.05, 1.4, 1.75, 2.2, 3.0], np.float32)
BANDS = len(EDGES_M)  # the lowest begins at the road; what is higher than the last edge is in none
_ACROSS, _UP = 12, 8  # cells seen from the sensor
BAND_NAMES = (
    *(f"band_frac_{b}" for b in range(BANDS)),
    *(f"band_length_{b}" for b in range(BANDS)),
    *(f"band_width_{b}" for b in range(BANDS)),
    "depth_scatter", "depth_extent",
)  # fmt: skip


@kernel
def band_columns(local: np.ndarray, mean: np.ndarray, base: float, row: np.ndarray) -> None:
    """Fill row (3 BANDS + 2,), columns as in ``BAND_NAMES``.

    local (5, n): x, y, z about the mean (3,), places along and across the main axis; base: height of the mean above
    the road (m).
    """
    z, n = local[2], local.shape[1]
    count, extent = np.zeros(BANDS, np.int64), np.empty((BANDS, 4), np.float32)
    extent[:, 0] = extent[:, 2] = np.inf
    extent[:, 1] = extent[:, 3] = -np.inf
    for i in range(n):
        b, height = 0, z[i] + base
        for edge in EDGES_M:
            b += height >= edge
        if b < BANDS:
            count[b] += 1
            u, v = local[3, i], local[4, i]
            extent[b, 0], extent[b, 1] = min(extent[b, 0], u), max(extent[b, 1], u)
            extent[b, 2], extent[b, 3] = min(extent[b, 2], v), max(extent[b, 3], v)
    for b in range(BANDS):
        row[b] = count[b] / n
        if count[b] > 1:
            row[BANDS + b], row[2 * BANDS + b] = extent[b, 1] - extent[b, 0], extent[b, 3] - extent[b, 2]
    row[3 * BANDS], row[3 * BANDS + 1] = _depth(local, mean)


@kernel
def _depth(local: np.ndarray, mean: np.ndarray) -> tuple[float, float]:
    """Deviation of the depth within cells seen from the sensor above (0, 0), and the extent of the depth (m)."""
    x, y, z = local[0], local[1], local[2]
    away = max(math.hypot(mean[0], mean[1]), 1e-6)
    vx, vy = np.float32(mean[0] / away), np.float32(mean[1] / away)
    near = far = vx * x[0] + vy * y[0]
    right = left = vx * y[0] - vy * x[0]
    low = high = z[0]
    for i in range(len(z)):
        depth, across = vx * x[i] + vy * y[i], vx * y[i] - vy * x[i]
        near, far = min(near, depth), max(far, depth)
        right, left = min(right, across), max(left, across)
        low, high = min(low, z[i]), max(high, z[i])
    per_across = np.float32(_ACROSS / max(left - right, 1e-3))
    per_up = np.float32(_UP / max(high - low, 1e-3))
    sums = np.zeros((_ACROSS * _UP, 3), np.float32)  # points, depth, depth squared
    for i in range(len(z)):
        depth, across = vx * x[i] + vy * y[i], vx * y[i] - vy * x[i]
        column = min(int((across - right) * per_across), _ACROSS - 1)
        c = column * _UP + min(int((z[i] - low) * per_up), _UP - 1)
        sums[c, 0] += np.float32(1.0)
        sums[c, 1] += depth
        sums[c, 2] += depth * depth
    weight = total = 0.0
    for cell in sums:
        if cell[0] >= 3.0:
            middle = cell[1] / cell[0]
            total += cell[0] * math.sqrt(max(cell[2] / cell[0] - middle * middle, 0.0))
            weight += cell[0]
    return (total / weight if weight > 0.0 else 0.0), far - near
