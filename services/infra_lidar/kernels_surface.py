"""Compiled road surface over the cells of the polar grid: a thousand cells, so anything is affordable here."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner, kernel


@inner
def flat_surface(height, s, surface, accepted):  # type: ignore[no-untyped-def]
    """The article's rule: the cell's own height if it is near the calibration plane, else the plane.

    height (rings, sectors) float32, NaN = unknown; surface (rings, sectors, 3) and accepted are written. s: the
    settings, as in ``kernels_ground``.
    """
    rings, sectors = height.shape
    for r in range(rings):
        allowed = min(s.limit_base_m + s.limit_slope * (r + np.float32(0.5)) * s.ring_m, s.limit_max_m)
        for k in range(sectors):
            h = height[r, k]
            accepted[r, k] = abs(h) <= allowed
            surface[r, k, 0] = h if accepted[r, k] else np.float32(0.0)
            surface[r, k, 1] = 0.0
            surface[r, k, 2] = 0.0


@inner
def sloped_surface(height, s, surface, accepted):  # type: ignore[no-untyped-def]
    """Walk outward from the pole, accept cells that continue the road, then fit a tangent plane per cell.

    height (rings, sectors) float32 low percentile, NaN = unknown; surface (rings, sectors, 3) and accepted written.
    A cell may lie ``s.step_up_m`` above what was expected (a kerb) or ``s.step_down_m`` below it: nothing lies under a
    road.
    """
    rings, sectors = height.shape
    ring_m, up, down = s.ring_m, s.step_up_m, s.step_down_m
    filled = np.empty((rings, sectors), np.float32)  # accepted height, or what was expected there
    trend = np.zeros((rings, sectors), np.float32)  # rise per metre along the ray
    trust = np.zeros((rings, sectors), np.float32)  # 1 measured, falling with every expected cell
    for r in range(rings):
        distance = (r + np.float32(0.5)) * ring_m
        allowed = min(s.limit_base_m + s.limit_slope * distance, s.limit_max_m)
        for k in range(sectors):
            expected, rise, known = np.float32(0.0), np.float32(0.0), np.float32(1.0)  # at the foot: calibrated
            level = np.float32(0.0)  # if the slope ended here
            if r > 0:
                weights = np.float32(1e-6)
                known *= np.float32(1e-6)
                for ds in range(-1, 2):
                    n = (k + ds) % sectors
                    w = trust[r - 1, n] * np.float32(2.0 if ds == 0 else 1.0) + np.float32(1e-6)
                    level += w * filled[r - 1, n]
                    rise += w * trend[r - 1, n]
                    known += w * trust[r - 1, n]
                    weights += w
                level, rise, known = level / weights, rise / weights, known / weights
                expected = level + rise * ring_m
            h = height[r, k]
            slack = s.max_step * ring_m * (np.float32(1.0) - known)
            good = (abs(h) <= allowed) & (h <= max(expected, level) + up + slack)
            good &= h >= min(expected, level) - down - slack
            accepted[r, k] = good
            if good:
                filled[r, k] = h
                step = (h - filled[r - 1, k]) / ring_m if r > 0 else np.float32(0.0)
                trend[r, k] = np.float32(0.5) * rise + np.float32(0.5) * step
                trust[r, k] = 1.0
            else:
                filled[r, k] = expected
                trend[r, k] = np.float32(0.8) * rise
                trust[r, k] = np.float32(0.8) * known
    _tangent_planes(filled, trust, ring_m, surface)


@inner
def _tangent_planes(filled, trust, ring_m, surface):  # type: ignore[no-untyped-def]
    """Plane through each cell's height with the slope of its 3 x 3 neighbourhood, weighted by trust."""
    rings, sectors = filled.shape
    cosine, sine = np.empty(sectors), np.empty(sectors)
    for s in range(sectors):
        angle = (s + 0.5) * 2.0 * np.pi / sectors - np.pi
        cosine[s], sine[s] = np.cos(angle), np.sin(angle)
    for r in range(rings):
        for s in range(sectors):
            cx, cy = (r + 0.5) * ring_m * cosine[s], (r + 0.5) * ring_m * sine[s]
            sxx, sxy, syy, sxz, syz = 1e-3, 0.0, 1e-3, 0.0, 0.0
            for dr in range(-1, 2):
                n = r + dr
                if n < 0 or n >= rings:
                    continue
                for ds in range(-1, 2):
                    m = (s + ds) % sectors
                    x = (n + 0.5) * ring_m * cosine[m] - cx
                    y = (n + 0.5) * ring_m * sine[m] - cy
                    z = filled[n, m] - filled[r, s]
                    w = trust[n, m] + 1e-3
                    sxx += w * x * x
                    sxy += w * x * y
                    syy += w * y * y
                    sxz += w * x * z
                    syz += w * y * z
            det = sxx * syy - sxy * sxy
            gx, gy = (sxz * syy - syz * sxy) / det, (syz * sxx - sxz * sxy) / det
            # a low percentile is the height of the cell's lower end: put the plane through its middle
            along = abs(gx * cosine[s] + gy * sine[s]) * ring_m * 0.45
            surface[r, s, 0] = filled[r, s] + along - gx * cx - gy * cy
            surface[r, s, 1] = gx
            surface[r, s, 2] = gy


@kernel
def road_below(places, surface, ring_m, rings, sectors, height):  # type: ignore[no-untyped-def]
    """height (K,) float32 of the road, surface (rings * sectors, 3), below the places (K, 2 or more) float32."""
    for k in range(height.shape[0]):
        x, y = places[k, 0], places[k, 1]
        ring = min(int(np.hypot(x, y) / ring_m), rings - 1)
        sector = min(max(int((np.arctan2(y, x) + np.pi) * (sectors / (2.0 * np.pi))), 0), sectors - 1)
        plane = surface[ring * sectors + sector]
        height[k] = plane[0] + plane[1] * x + plane[2] * y
