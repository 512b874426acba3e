"""Update of the tracks with their detections: position, size, heading, class votes."""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.classification.classes import BACKGROUND
from services.infra_lidar.jit import kernel
from services.infra_lidar.tracking.association import Matches
from services.infra_lidar.tracking.config import TrackingSettings
from services.infra_lidar.tracking.detections import DetectionRecord
from services.infra_lidar.tracking.kalman import FrameTime, TrackRecord, correct, extents_along, innovation

_HEADING_MPS = 1.5  # from this speed on the heading is the direction of travel


@kernel
def update_tracks(
    tracks: np.ndarray, detections: np.ndarray, matches: Matches, time: FrameTime, settings: TrackingSettings
) -> None:
    """Update every matched track of (N,) with its detection of (K,), in place."""
    vote_decay = math.exp(-time.dt_s / settings.vote_s)
    for i in range(len(matches.track)):
        track, detection = tracks[matches.track[i]], detections[matches.detection[i]]
        e = innovation(track, detection, settings)
        unexplained_x = detection.position[0] - track.mean[0] - e.x
        unexplained_y = detection.position[1] - track.mean[1] - e.y
        correct(track, e)
        _update_size(track, detection, unexplained_x, unexplained_y, settings)
        _update_heading(track, detection.yaw, settings)
        _update_votes(track, detection, vote_decay)
        track.static_score += 0.25 * ((detection.label == BACKGROUND) - track.static_score)
        track.hits += 1
        track.seen_ns = time.stamp_ns
        track.points = detection.points
        track.detection = matches.detection[i]


@kernel
def _update_votes(track: TrackRecord, detection: DetectionRecord, decay: float) -> None:
    """Add the class probabilities of a detection; the label is the class with most votes."""
    track.vote_weight = decay * track.vote_weight + 1.0
    best = track.label
    for c in range(len(track.votes)):
        track.votes[c] = decay * track.votes[c] + detection.class_probabilities[c]
    for c in range(len(track.votes)):
        if track.votes[c] > track.votes[best]:
            best = c
    track.label = best


@kernel
def _update_size(
    track: TrackRecord, detection: DetectionRecord, unexplained_x: float, unexplained_y: float,
    settings: TrackingSettings,
) -> None:  # fmt: skip
    """Grow towards the measured size, shrink more slowly; growth to one side shifts the centre.

    ``unexplained_x``, ``unexplained_y``: the part of the centre's jump that no motion explains (m, map frame).
    """
    size, c, s = track.size, math.cos(track.yaw), math.sin(track.yaw)
    length, width = extents_along(detection.size, detection.yaw, track.yaw)
    difference = max(abs(length - size[0]), abs(width - size[1]))
    track.extent_jitter += max(0.2, 1.0 / track.hits) * (difference - track.extent_jitter)
    along = _resize(size[:1], length, c * unexplained_x + s * unexplained_y, settings)
    across = _resize(size[1:2], width, c * unexplained_y - s * unexplained_x, settings)
    _resize(size[2:], detection.size[2], 0.0, settings)
    track.mean[0] += c * along - s * across
    track.mean[1] += s * along + c * across


@kernel
def _resize(size: np.ndarray, measured: float, unexplained: float, settings: TrackingSettings) -> float:
    """Change ``size`` (1,) in place; returns the shift of the centre (m), at most half of the change.

    A box of visible parts shrinks ten times more slowly than it grows: most of the time the rest is hidden. Up to 1.5 m
    twice: a person is seen whole.
    """
    shrink = 0.1 if size[0] > 1.5 else 0.5
    rate = settings.size_gain if measured > size[0] or not settings.visible else shrink * settings.size_gain
    change = rate * (measured - size[0])
    size[0] += change
    limit = 0.5 * abs(change) if settings.visible else 0.0
    return min(max(unexplained, -limit), limit)


@kernel
def _update_heading(track: TrackRecord, measured_yaw: float, settings: TrackingSettings) -> None:
    """Turn towards the measured box, or towards the direction of travel of a moving track."""
    vx, vy = track.mean[3], track.mean[4]
    if settings.visible and track.moving and math.hypot(vx, vy) > _HEADING_MPS:
        heading = math.atan2(vy, vx)
        quarter = math.floor((heading - track.yaw) / (0.5 * math.pi) + 0.5)
        if quarter % 2 == 1:  # the long side lay across the direction of travel: only front or rear had been visible
            track.size[0], track.size[1] = track.size[1], track.size[0]
        track.yaw = track.yaw + quarter * 0.5 * math.pi
        turn = heading - track.yaw
    else:
        period = 0.5 * math.pi if settings.visible else math.pi
        turn = measured_yaw - track.yaw
        turn -= period * math.floor(turn / period + 0.5)
    track.yaw = _wrap(track.yaw + settings.yaw_gain * _wrap(turn))


@kernel
def _wrap(angle_rad: float) -> float:
    return angle_rad - 2.0 * math.pi * math.floor(angle_rad / (2.0 * math.pi) + 0.5)
