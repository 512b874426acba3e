"""The article's ground: one height per polar cell, without slopes."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import kernel
from services.infra_lidar.segmentation.ground_kernels import GroundSettings


@kernel
def flat_surface(height: np.ndarray, s: GroundSettings) -> np.ndarray:
    """The cell's own height where it is within min(base + slope * range, max) of the calibration plane, else the plane.

    Takes and returns what ``services.infra_lidar.segmentation.ground_surface.sloped_surface`` does.
    """
    rings, sectors = height.shape
    surface = np.zeros((rings, sectors, 3), np.float32)
    for r in range(rings):
        allowed = min(s.limit_base_m + s.limit_slope * (r + 0.5) * s.ring_m, s.limit_max_m)
        for k in range(sectors):
            if abs(height[r, k]) <= allowed:
                surface[r, k, 0] = height[r, k]
    return surface
