"""Stacked constant-velocity Kalman filters with oriented-box measurements, compiled.

All tracks are one record array (``TRACK``). State: position and velocity in the map frame, covariance (6, 6).

    predict   p += v dt,  P = F P F' + Q(dt),  Q = a^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]] per axis
              (white-noise acceleration, Bar-Shalom 2001, 6.2.2: two steps of dt/2 equal one of dt)
    measure   H = [I 0], innovation and noise from the boxes, see ``innovation``
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TRAIL = 16  # remembered positions
CLASS_COUNT = 5
TRACK = np.dtype(
    [
        ("track_id", np.int64),
        ("mean", np.float64, 6),  # x y z vx vy vz, map frame
        ("cov", np.float64, (6, 6)),
        ("size", np.float64, 3),  # length, width, height
        ("yaw", np.float64),
        ("wobble", np.float64),  # by how much the visible extent differs from the size, running mean, metres
        ("votes", np.float64, CLASS_COUNT),
        ("born_ns", np.int64),
        ("seen_ns", np.int64),
        ("hits", np.int64),
        ("run", np.int64),  # hits without a miss in between
        ("presence", np.float64),  # share of the last frames with a hit, running mean
        ("confirmed", np.bool_),
        ("moving", np.bool_),
        ("score", np.float64),
        ("points", np.int64),
        ("detection", np.int64),  # index in the last frame, -1 = none
        ("trail", np.float64, (TRAIL, 4)),  # where it was: x, y and half extents along x and y; a ring over frames
        ("frames", np.int64),  # since birth
    ]
)

_jit = njit(nogil=True, cache=True, error_model="numpy")


@_jit
def predict(tracks: np.ndarray, dt_s: float, acceleration: float) -> None:
    """Move every track by ``dt_s`` and grow its covariance."""
    q = acceleration * acceleration
    for t in range(len(tracks)):
        mean, cov = tracks[t].mean, tracks[t].cov
        for i in range(3):
            mean[i] += dt_s * mean[i + 3]
        for i in range(3):
            for j in range(3):
                cov[i, j] += dt_s * (cov[i, j + 3] + cov[i + 3, j]) + dt_s * dt_s * cov[i + 3, j + 3]
        for i in range(3):
            for j in range(3):
                cov[i, j + 3] += dt_s * cov[i + 3, j + 3]
        for i in range(3):
            for j in range(3):
                cov[j + 3, i] = cov[i, j + 3]
            cov[i, i] += q * dt_s**3 / 3.0
            cov[i, i + 3] += q * dt_s**2 / 2.0
            cov[i + 3, i] += q * dt_s**2 / 2.0
            cov[i + 3, i + 3] += q * dt_s


@_jit
def extents_along(size: np.ndarray, yaw: float, track_yaw: float) -> tuple[float, float]:
    """Length and width of a measured box along the nearest axes of the track: a box has four equal headings."""
    turn = (yaw - track_yaw) / (0.5 * math.pi)
    quarter = math.floor(turn + 0.5)
    if quarter % 2 == 0:
        return size[0], size[1]
    return size[1], size[0]


@_jit
def edge_shift(centre: float, measured: float, extent: float) -> tuple[float, float]:
    """By how much an interval has moved, judged by its edges, and the variance of what cannot be judged.

    ``centre`` is the measured centre minus the predicted one along one axis, ``measured`` and ``extent`` the measured
    and the known length. When less of the object is visible than before, one edge stays where it was and the centre
    jumps, although nothing has moved: so the smaller shift of the two edges counts, and none if the measured
    interval lies inside the known one (or around it).
    """
    low = centre - 0.5 * (measured - extent)
    high = centre + 0.5 * (measured - extent)
    doubt = (measured - extent) ** 2 / 12.0
    if low * high <= 0.0:
        return 0.0, doubt
    return (low if abs(low) < abs(high) else high), doubt


@_jit
def innovation(
    mean: np.ndarray, size: np.ndarray, yaw: float, position: np.ndarray, box: np.ndarray, box_yaw: float,
    sigma: float, visible: bool, out: np.ndarray,
) -> None:  # fmt: skip
    """Horizontal innovation and noise of one pair: out = [ex, ey, Rxx, Rxy, Ryy], map frame."""
    dx, dy = position[0] - mean[0], position[1] - mean[1]
    if not visible:
        out[0], out[1], out[2], out[3], out[4] = dx, dy, sigma * sigma, 0.0, sigma * sigma
        return
    c, s = math.cos(yaw), math.sin(yaw)
    length, width = extents_along(box, box_yaw, yaw)
    along, doubt_along = edge_shift(c * dx + s * dy, length, size[0])
    across, doubt_across = edge_shift(c * dy - s * dx, width, size[1])
    ra, rc = sigma * sigma + doubt_along, sigma * sigma + doubt_across
    out[0], out[1] = c * along - s * across, s * along + c * across
    out[2], out[3], out[4] = c * c * ra + s * s * rc, c * s * (ra - rc), s * s * ra + c * c * rc


@_jit
def correct(
    mean: np.ndarray, cov: np.ndarray, e: np.ndarray, r_xx: float, r_xy: float, r_yy: float, r_zz: float
) -> None:
    """Kalman update in place with a position innovation ``e`` (3,); height is independent of the plane."""
    sxx, sxy, syy, szz = cov[0, 0] + r_xx, cov[0, 1] + r_xy, cov[1, 1] + r_yy, cov[2, 2] + r_zz
    det = sxx * syy - sxy * sxy
    gain = np.empty((6, 3))
    for i in range(6):
        gain[i, 0] = (cov[i, 0] * syy - cov[i, 1] * sxy) / det
        gain[i, 1] = (cov[i, 1] * sxx - cov[i, 0] * sxy) / det
        gain[i, 2] = cov[i, 2] / szz
    for i in range(6):
        mean[i] += gain[i, 0] * e[0] + gain[i, 1] * e[1] + gain[i, 2] * e[2]
    top = cov[:3].copy()
    for i in range(6):
        for j in range(6):
            cov[i, j] -= gain[i, 0] * top[0, j] + gain[i, 1] * top[1, j] + gain[i, 2] * top[2, j]
    for i in range(6):
        for j in range(i):
            cov[i, j] = cov[j, i] = 0.5 * (cov[i, j] + cov[j, i])
