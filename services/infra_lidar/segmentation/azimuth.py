"""Azimuth of many points: the arctangent as a polynomial, which every processor computes several at once.

NumPy's arctan2 does so only with AVX-512; elsewhere it took half of a frame's time.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import kernel

TINY = np.float32(1e-30)  # the azimuth of (0, 0) is 0
QUARTER, HALF = np.float32(np.pi / 2.0), np.float32(np.pi)  # of a turn, rad
SERIES = np.array(
    [0.0028662257, -0.0161657367, 0.0429096138, -0.0752896400, 0.1065626393, -0.1420889944, 0.1999355085, -0.3333314528,
     1.0], np.float32,
)  # fmt: skip
"""arctan(t) / t in powers of t^2, highest first, for 0 <= t <= 1 (Abramowitz and Stegun 1964, 4.4.49)."""


@kernel
def azimuth_of(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(N,) float32 rad, -pi to pi, of x and y (N,) float32: arctan2(y, x), exact to 1e-6 rad."""
    azimuth = np.empty(len(x), np.float32)
    for i in range(len(x)):  # no branch depends on a point: the compiler vectorises it
        across, along = abs(y[i]), abs(x[i])
        t = min(across, along) / max(max(across, along), TINY)
        squared = t * t
        series = SERIES[0]
        for term in SERIES[1:]:
            series = series * squared + term
        angle = series * t
        angle = QUARTER - angle if across > along else angle
        angle = HALF - angle if x[i] < 0.0 else angle
        azimuth[i] = -angle if y[i] < 0.0 else angle
    return azimuth
