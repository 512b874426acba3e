"""The road as a surface that may slope, from the low heights of the polar cells."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import kernel
from services.infra_lidar.segmentation.ground_kernels import GroundSettings

NO_TRUST = 1e-6


@kernel
def sloped_surface(height: np.ndarray, s: GroundSettings) -> np.ndarray:
    """Walk outward from the pole, accept cells that continue the road, then fit a tangent plane to each cell.

    height: (rings, sectors) float32 m, low percentile of each cell, NaN = unknown. Returns (rings, sectors, 3) float32:
    the road at (x, y) of a cell is at s0 + s1 x + s2 y, level frame. A cell may lie ``step_up_m`` above what its inner
    neighbours let expect (a kerb) or ``step_down_m`` below it, and more where the road was hidden for a while.
    """
    rings, sectors = height.shape
    filled = np.empty((rings, sectors), np.float32)  # accepted height, or the expected one
    trend = np.zeros((rings, sectors), np.float32)  # rise per metre along the ray
    trust = np.zeros((rings, sectors), np.float32)  # 1 = measured, less with every cell that was only expected
    for r in range(rings):
        allowed = min(s.limit_base_m + s.limit_slope * (r + 0.5) * s.ring_m, s.limit_max_m)
        for k in range(sectors):
            level, rise, known = 0.0, 0.0, 1.0  # at the pole's foot the calibration holds
            if r > 0:
                level, rise, known = _inner_neighbours(filled[r - 1], trend[r - 1], trust[r - 1], k)
            expected = level + rise * s.ring_m
            slack = s.max_step * s.ring_m * (1.0 - known)
            h = height[r, k]
            accepted = abs(h) <= allowed and h <= max(expected, level) + s.step_up_m + slack
            if accepted and h >= min(expected, level) - s.step_down_m - slack:
                step = (h - filled[r - 1, k]) / s.ring_m if r > 0 else 0.0
                filled[r, k], trend[r, k], trust[r, k] = h, 0.5 * (rise + step), 1.0
            else:
                filled[r, k], trend[r, k], trust[r, k] = expected, 0.8 * rise, 0.8 * known
    return _tangent_planes(filled, trust, s.ring_m)


@kernel
def _inner_neighbours(filled: np.ndarray, trend: np.ndarray, trust: np.ndarray, k: int) -> tuple[float, float, float]:
    """Weighted mean height, rise and trust of the three cells of the inner ring next to sector k."""
    sectors = len(filled)
    weights, level, rise, known = NO_TRUST, 0.0, 0.0, NO_TRUST
    for n in (k - 1 if k > 0 else sectors - 1, k, k + 1 if k < sectors - 1 else 0):
        w = trust[n] * (2.0 if n == k else 1.0) + NO_TRUST
        level += w * filled[n]
        rise += w * trend[n]
        known += w * trust[n]
        weights += w
    return level / weights, rise / weights, known / weights


@kernel
def _tangent_planes(filled: np.ndarray, trust: np.ndarray, ring_m: float) -> np.ndarray:
    """Plane through each cell's height with the slope of its 3 x 3 neighbourhood, least squares weighted by trust."""
    rings, sectors = filled.shape
    surface = np.empty((rings, sectors, 3), np.float32)
    angle = (np.arange(sectors) + 0.5) * (2.0 * np.pi / sectors) - np.pi
    cosine, sine = np.cos(angle), np.sin(angle)
    beside = (np.arange(-1, sectors + 1) % sectors).astype(np.uint32)  # sector k has beside[k : k + 3] around it
    for r in range(rings):
        for k in range(sectors):
            cx, cy = (r + 0.5) * ring_m * cosine[k], (r + 0.5) * ring_m * sine[k]
            sxx, sxy, syy, sxz, syz = 1e-3, 0.0, 1e-3, 0.0, 0.0
            for n in range(max(r - 1, 0), min(r + 2, rings)):
                for m in beside[k : k + 3]:
                    x = (n + 0.5) * ring_m * cosine[m] - cx
                    y = (n + 0.5) * ring_m * sine[m] - cy
                    z = filled[n, m] - filled[r, k]
                    w = trust[n, m] + 1e-3
                    sxx += w * x * x
                    sxy += w * x * y
                    syy += w * y * y
                    sxz += w * x * z
                    syz += w * y * z
            det = sxx * syy - sxy * sxy
            gx, gy = (sxz * syy - syz * sxy) / det, (syz * sxx - sxz * sxy) / det
            # A low percentile is the height of the cell's lower end: put the plane through its middle.
            along = abs(gx * cosine[k] + gy * sine[k]) * ring_m * 0.45
            surface[r, k, 0] = filled[r, k] + along - gx * cx - gy * cy
            surface[r, k, 1], surface[r, k, 2] = gx, gy
    return surface
