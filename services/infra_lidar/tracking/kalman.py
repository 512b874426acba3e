"""Constant-velocity Kalman filters with oriented-box measurements.

All tracks are one record array (``TRACK``), all boxes of a frame another (``DETECTION``). State: position and velocity
in the map frame, covariance (6, 6).

    predict   p += v dt,  P = F P F' + Q(dt),  Q = a^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]] per axis
              (white-noise acceleration, Bar-Shalom 2001, 6.2.2: two steps of dt/2 equal one of dt)
    measure   H = [I 0], innovation and noise from the boxes, see ``innovation``
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from services.infra_lidar.jit import kernel
from services.infra_lidar.tracking.config import TrackingSettings
from services.infra_lidar.tracking.detections import CLASS_COUNT, DetectionRecord

TRAIL = 16  # remembered positions
TRACK = np.dtype(
    [
        ("track_id", np.int64),
        ("mean", np.float64, 6),  # x, y, z, vx, vy, vz, m and m/s, map frame
        ("cov", np.float64, (6, 6)),
        ("size", np.float64, 3),  # length, width, height, m
        ("yaw", np.float64),  # rad, map frame
        ("extent_jitter", np.float64),  # difference between visible extent and size, running mean, m
        ("votes", np.float64, CLASS_COUNT),
        ("vote_weight", np.float64),  # of all votes
        ("label", np.int64),  # index into ``LABELS``
        ("born_ns", np.int64),
        ("seen_ns", np.int64),  # last detection
        ("hits", np.int64),  # detections since birth
        ("hit_streak", np.int64),  # detections since the last miss
        ("visibility", np.float64),  # share of the last frames with a detection, running mean
        ("static_score", np.float64),  # share of the last detections labelled background, running mean
        ("confirmed", np.bool_),
        ("moving", np.bool_),
        ("score", np.float64),
        ("points", np.int64),
        ("detection", np.int64),  # index in the last frame, -1 = none
        ("trail", np.float64, (TRAIL, 5)),  # ring over frames: x, y, half extents along x and y (m), yaw (rad)
        ("frames", np.int64),  # since birth
    ]
)
TrackRecord: TypeAlias = Any  # one record of a ``TRACK`` array; numpy has no static type for its fields


class FrameTime(NamedTuple):
    """When a frame was measured, and its place in the trails."""

    stamp_ns: int
    dt_s: float  # since the last frame
    trail_slot: int  # where this frame is written in ``TRACK.trail``
    trail_frames: int  # number of frames within ``movement_s`` before this one


class Innovation(NamedTuple):
    """Measured minus predicted position (m) and the noise of the measurement (m^2), map frame."""

    x: float
    y: float
    z: float
    r_xx: float
    r_xy: float
    r_yy: float
    r_zz: float


@kernel
def predict(tracks: np.ndarray, dt_s: float, settings: TrackingSettings) -> None:
    """Move every track (N,) by ``dt_s`` and grow its covariance, in place."""
    q = settings.acceleration_sigma * settings.acceleration_sigma
    q_position, q_cross, q_velocity = q * dt_s * dt_s * dt_s / 3.0, q * dt_s * dt_s / 2.0, q * dt_s
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
            cov[i, i] += q_position
            cov[i, i + 3] += q_cross
            cov[i + 3, i] += q_cross
            cov[i + 3, i + 3] += q_velocity


@kernel
def extents_along(size: np.ndarray, yaw: float, track_yaw: float) -> tuple[float, float]:
    """Length and width of a measured box along the nearest axes of the track: a box has four equal headings."""
    quarter = math.floor((yaw - track_yaw) / (0.5 * math.pi) + 0.5)
    if quarter % 2 == 0:
        return size[0], size[1]
    return size[1], size[0]


@kernel
def edge_shift(centre: float, measured: float, extent: float) -> tuple[float, float]:
    """Shift of an interval judged by its edges (m), and the variance of the part that stays unknown (m^2).

    ``centre`` is the measured centre minus the predicted one along one axis, ``measured`` and ``extent`` the measured
    and the known length. When less of the object is visible than before, one edge stays where it was and the centre
    jumps although nothing has moved. So the smaller shift of the two edges counts, and none if the measured
    interval lies inside the known one (or around it).
    """
    low = centre - 0.5 * (measured - extent)
    high = centre + 0.5 * (measured - extent)
    variance = (measured - extent) * (measured - extent) / 12.0
    if low * high <= 0.0:
        return 0.0, variance
    return (low if abs(low) < abs(high) else high), variance


@kernel
def innovation(track: TrackRecord, detection: DetectionRecord, settings: TrackingSettings) -> Innovation:
    """Innovation of one pair: of the edges along the track's axes for visible boxes, else of the centre."""
    dx, dy = detection.position[0] - track.mean[0], detection.position[1] - track.mean[1]
    dz, r_zz = detection.position[2] - track.mean[2], settings.height_sigma_m * settings.height_sigma_m
    noise = settings.position_sigma_m * settings.position_sigma_m
    if not settings.visible:
        return Innovation(dx, dy, dz, noise, 0.0, noise, r_zz)
    c, s = math.cos(track.yaw), math.sin(track.yaw)
    length, width = extents_along(detection.size, detection.yaw, track.yaw)
    along, along_variance = edge_shift(c * dx + s * dy, length, track.size[0])
    across, across_variance = edge_shift(c * dy - s * dx, width, track.size[1])
    ra, rc = noise + along_variance, noise + across_variance
    ex, ey = c * along - s * across, s * along + c * across
    return Innovation(ex, ey, dz, c * c * ra + s * s * rc, c * s * (ra - rc), s * s * ra + c * c * rc, r_zz)


@kernel
def correct(track: TrackRecord, measured: Innovation) -> None:
    """Kalman update of a track in place; height is independent of the plane."""
    mean, cov = track.mean, track.cov
    sxx, sxy, syy = cov[0, 0] + measured.r_xx, cov[0, 1] + measured.r_xy, cov[1, 1] + measured.r_yy
    by_det, by_zz = 1.0 / (sxx * syy - sxy * sxy), 1.0 / (cov[2, 2] + measured.r_zz)
    gain, before = np.empty((6, 3)), np.empty((6, 3))  # before: position columns of the covariance
    for i in range(6):
        a, b, c = cov[i, 0], cov[i, 1], cov[i, 2]
        before[i, 0], before[i, 1], before[i, 2] = a, b, c
        gain[i, 0], gain[i, 1], gain[i, 2] = (a * syy - b * sxy) * by_det, (b * sxx - a * sxy) * by_det, c * by_zz
        mean[i] += gain[i, 0] * measured.x + gain[i, 1] * measured.y + gain[i, 2] * measured.z
    for i in range(6):
        for j in range(i + 1):
            cov[i, j] -= gain[i, 0] * before[j, 0] + gain[i, 1] * before[j, 1] + gain[i, 2] * before[j, 2]
            cov[j, i] = cov[i, j]
