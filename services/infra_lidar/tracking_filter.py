"""Stacked constant-velocity Kalman filters with oriented-box measurements, compiled.

All tracks are one record array (``TRACK``), all boxes of a frame another (``DETECTION``), all settings one record
(``PARAMETERS``). State: position and velocity in the map frame, covariance (6, 6).

    predict   p += v dt,  P = F P F' + Q(dt),  Q = a^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]] per axis
              (white-noise acceleration, Bar-Shalom 2001, 6.2.2: two steps of dt/2 equal one of dt),
              or the article's constant diagonal Q a frame
    measure   H = [I 0], innovation and noise from the boxes, see ``innovation``
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from services.infra_lidar.jit import inner
from services.infra_lidar.tracking_config import TrackingConfig

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
        ("vote_count", np.float64, CLASS_COUNT),  # how many they are ("mean" only)
        ("label", np.int64),  # of ``LABELS``
        ("born_ns", np.int64),
        ("seen_ns", np.int64),
        ("hits", np.int64),
        ("run", np.int64),  # hits without a miss in between
        ("presence", np.float64),  # share of the last frames with a hit, running mean
        ("fixture", np.float64),  # share of the last detections that were called background, running mean
        ("confirmed", np.bool_),
        ("moving", np.bool_),
        ("score", np.float64),
        ("points", np.int64),
        ("detection", np.int64),  # index in the last frame, -1 = none
        ("trail", np.float64, (TRAIL, 5)),  # where it was: x, y, half extents along x and y, yaw; a ring over frames
        ("frames", np.int64),  # since birth
    ]
)

DETECTION = np.dtype(
    [
        ("position", np.float64, 3),  # centre, map frame
        ("size", np.float64, 3),
        ("yaw", np.float64),
        ("chances", np.float64, CLASS_COUNT),
        ("label", np.int64),  # of ``LABELS``
        ("confidence", np.float64),  # 0..1
        ("points", np.int64),
    ]
)
PARAMETERS = np.dtype(
    [(name, np.float64) for name in (
        "position_sigma_m", "height_sigma_m", "acceleration_sigma", "step_position_sigma_m", "step_velocity_sigma_mps",
        "gate", "class_weight", "size_gain", "yaw_gain", "score_s", "vote_s", "vote_margin", "movement_m", "movement_s",
        "confirm_s", "tentative_gap_s", "coast_s", "min_vote", "found_confidence",
    )]
    + [("confirm_hits", np.int64)]
    + [(name, np.bool_) for name in ("visible", "step", "distance", "hard", "mean_votes", "coast_as_known")]
)  # fmt: skip


def parameters(config: TrackingConfig) -> np.ndarray:
    """(1,) ``PARAMETERS``: the settings. Kernels take an array; a record by itself takes a microsecond to hand over."""
    made = np.zeros(1, PARAMETERS)
    for name in PARAMETERS.names or ():
        if hasattr(config, name):
            made[name] = getattr(config, name)
    made["visible"], made["step"] = config.boxes == "visible", config.process == "step"
    made["distance"], made["hard"] = config.cost == "distance", config.classes == "hard"
    made["mean_votes"] = config.votes == "mean"
    return made


@inner
def predict(tracks: np.ndarray, dt_s: float, p: Any) -> None:
    """Move every track by ``dt_s`` and grow its covariance."""
    q = p.acceleration_sigma * p.acceleration_sigma
    on_place, on_both, on_speed = q * dt_s * dt_s * dt_s / 3.0, q * dt_s * dt_s / 2.0, q * dt_s
    if p.step:
        on_place, on_both = p.step_position_sigma_m * p.step_position_sigma_m, 0.0
        on_speed = p.step_velocity_sigma_mps * p.step_velocity_sigma_mps
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
            cov[i, i] += on_place
            cov[i, i + 3] += on_both
            cov[i + 3, i] += on_both
            cov[i + 3, i + 3] += on_speed


@inner
def extents_along(size: np.ndarray, yaw: float, track_yaw: float) -> tuple[float, float]:
    """Length and width of a measured box along the nearest axes of the track: a box has four equal headings."""
    turn = (yaw - track_yaw) / (0.5 * math.pi)
    quarter = math.floor(turn + 0.5)
    if quarter % 2 == 0:
        return size[0], size[1]
    return size[1], size[0]


@inner
def edge_shift(centre: float, measured: float, extent: float) -> tuple[float, float]:
    """By how much an interval has moved, judged by its edges, and the variance of what cannot be judged.

    ``centre`` is the measured centre minus the predicted one along one axis, ``measured`` and ``extent`` the measured
    and the known length. When less of the object is visible than before, one edge stays where it was and the centre
    jumps, although nothing has moved: so the smaller shift of the two edges counts, and none if the measured
    interval lies inside the known one (or around it).
    """
    low = centre - 0.5 * (measured - extent)
    high = centre + 0.5 * (measured - extent)
    doubt = (measured - extent) * (measured - extent) / 12.0
    if low * high <= 0.0:
        return 0.0, doubt
    return (low if abs(low) < abs(high) else high), doubt


@inner
def innovation(
    mean: np.ndarray, size: np.ndarray, yaw: float, position: np.ndarray, box: np.ndarray, box_yaw: float, p: Any
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Horizontal innovation and noise of one pair: ex, ey, Rxx, Rxy, Ryy, map frame."""
    dx, dy = position[0] - mean[0], position[1] - mean[1]
    noise = p.position_sigma_m * p.position_sigma_m
    if not p.visible:
        return dx, dy, noise, 0.0, noise
    c, s = math.cos(yaw), math.sin(yaw)
    length, width = extents_along(box, box_yaw, yaw)
    along, doubt_along = edge_shift(c * dx + s * dy, length, size[0])
    across, doubt_across = edge_shift(c * dy - s * dx, width, size[1])
    ra, rc = noise + doubt_along, noise + doubt_across
    ex, ey = c * along - s * across, s * along + c * across
    return ex, ey, c * c * ra + s * s * rc, c * s * (ra - rc), s * s * ra + c * c * rc


@inner
def correct(
    mean: np.ndarray, cov: np.ndarray, e: np.ndarray, r_xx: float, r_xy: float, r_yy: float, r_zz: float,
    work: np.ndarray,
) -> None:  # fmt: skip
    """Kalman update in place with a position innovation ``e`` (3,); height is independent of the plane.

    ``work`` (6, 6) is scratch: the gain, and the covariance with the position as it was.
    """
    sxx, sxy, syy, szz = cov[0, 0] + r_xx, cov[0, 1] + r_xy, cov[1, 1] + r_yy, cov[2, 2] + r_zz
    by_det, by_zz = 1.0 / (sxx * syy - sxy * sxy), 1.0 / szz
    for i in range(6):
        a, b, c = cov[i, 0], cov[i, 1], cov[i, 2]
        gx, gy, gz = (a * syy - b * sxy) * by_det, (b * sxx - a * sxy) * by_det, c * by_zz
        work[i, 0], work[i, 1], work[i, 2], work[i, 3], work[i, 4], work[i, 5] = gx, gy, gz, a, b, c
        mean[i] += gx * e[0] + gy * e[1] + gz * e[2]
    for i in range(6):
        for j in range(i + 1):
            cov[i, j] -= work[i, 0] * work[j, 3] + work[i, 1] * work[j, 4] + work[i, 2] * work[j, 5]
            cov[j, i] = cov[i, j]
