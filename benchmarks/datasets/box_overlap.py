"""Overlap of upright boxes turned about the vertical: all pairs of two sets in one compiled call."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_jit = njit(nogil=True, cache=True, error_model="numpy")


@_jit
def overlap_3d(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, m) 3-D intersection over union of boxes (., 7): x y z h w l rot_y, y down, bottom centre (KITTI)."""
    out = np.zeros((len(first), len(second)))
    corners = np.empty((2, 16, 2))
    for i in range(len(first)):
        for j in range(len(second)):
            a, b = first[i], second[j]
            reach = 0.5 * (math.hypot(a[4], a[5]) + math.hypot(b[4], b[5]))
            tall = min(a[1], b[1]) - max(a[1] - a[3], b[1] - b[3])
            if tall <= 0.0 or math.hypot(a[0] - b[0], a[2] - b[2]) >= reach:
                continue
            shared = _shared_area(a, b, corners) * tall
            out[i, j] = shared / (a[3] * a[4] * a[5] + b[3] * b[4] * b[5] - shared)
    return out


@_jit
def _shared_area(a: np.ndarray, b: np.ndarray, corners: np.ndarray) -> float:
    """Clip rectangle a, seen in the frame of b, by the four sides of b (Sutherland & Hodgman 1974)."""
    c, s = math.cos(b[6]), math.sin(b[6])
    turn = a[6] - b[6]
    ca, sa = math.cos(turn), math.sin(turn)
    dx, dz = a[0] - b[0], a[2] - b[2]
    x0, z0 = c * dx - s * dz, s * dx + c * dz
    polygon, clipped, count = corners[0], corners[1], 4
    for k in range(4):
        u = 0.5 * a[5] * (1.0 if k in (0, 3) else -1.0)
        v = 0.5 * a[4] * (1.0 if k < 2 else -1.0)
        polygon[k, 0], polygon[k, 1] = x0 + ca * u + sa * v, z0 - sa * u + ca * v
    for side in range(4):
        axis, sign = side // 2, 1.0 if side % 2 == 0 else -1.0
        limit = 0.5 * (b[5] if axis == 0 else b[4])
        kept = 0
        for k in range(count):
            p, q = polygon[k], polygon[(k + 1) % count]
            dp, dq = limit - sign * p[axis], limit - sign * q[axis]
            if dp >= 0.0:
                clipped[kept] = p
                kept += 1
            if (dp >= 0.0) != (dq >= 0.0):
                share = dp / (dp - dq)
                clipped[kept, 0] = p[0] + share * (q[0] - p[0])
                clipped[kept, 1] = p[1] + share * (q[1] - p[1])
                kept += 1
        polygon, clipped, count = clipped, polygon, kept
        if count < 3:
            return 0.0
    total = 0.0
    for k in range(count):
        p, q = polygon[k], polygon[(k + 1) % count]
        total += p[0] * q[1] - q[0] * p[1]
    return 0.5 * abs(total)
