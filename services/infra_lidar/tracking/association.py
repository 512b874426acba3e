"""Which detection belongs to which track: gate, cost, Hungarian assignment.

Cost of a pair = d2 + ln det S - w ln(p + 0.02). d2 is the squared Mahalanobis distance of the innovation and has to
pass the gate. ln det S keeps an uncertain track from winning every tie. p is the probability that track and detection
are of one class, so another class adds cost and is not forbidden.

A track without a detection costs ``NO_MATCH_COST`` (global nearest neighbour: Blackman and Popoli, Design and Analysis
of Modern Tracking Systems, 1999, chapter 6). So the track of a hidden vehicle does not take the detection of its
neighbour, whose track would have to take another one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from services.infra_lidar.jit import kernel
from services.infra_lidar.tracking.config import TrackingSettings
from services.infra_lidar.tracking.detections import DetectionRecord
from services.infra_lidar.tracking.kalman import TrackRecord, innovation

FORBIDDEN = 1e6
NO_MATCH_COST = 8.0  # with 5.0 the MOTA of generated streets changes by 0.3 points, up on one set and down on another


class Pairs(NamedTuple):
    """(P,) pairs within the gate: index of the track, index of the detection, cost."""

    track: np.ndarray
    detection: np.ndarray
    cost: np.ndarray


class Matches(NamedTuple):
    """(M,) assigned pairs: index of the track, index of the detection; each at most once."""

    track: np.ndarray
    detection: np.ndarray


def assign(pairs: Pairs) -> Matches:
    """The assignment of least total cost (Hungarian), with ``NO_MATCH_COST`` for each track without a detection.

    Pairs without an alternative are taken at once, whatever they cost: usually most, so that the matrix of the others
    is small.
    """
    is_lone = (np.bincount(pairs.track)[pairs.track] == 1) & (np.bincount(pairs.detection)[pairs.detection] == 1)
    lone_track, lone_detection = pairs.track[is_lone], pairs.detection[is_lone]
    if is_lone.all():
        return Matches(lone_track, lone_detection)
    contested = Pairs(*(column[~is_lone] for column in pairs))
    tracks, detections = (np.flatnonzero(np.bincount(index)) for index in (contested.track, contested.detection))
    saved = np.zeros((len(tracks), len(detections)))  # by a match; 0 = no pair, or none that is worth it
    row, column = tracks.searchsorted(contested.track), detections.searchsorted(contested.detection)
    saved[row, column] = np.maximum(NO_MATCH_COST - contested.cost, 0.0)
    rows, columns = linear_sum_assignment(saved, maximize=True)
    allowed = saved[rows, columns] > 0.0
    return Matches(
        np.concatenate((lone_track, tracks[rows[allowed]])),
        np.concatenate((lone_detection, detections[columns[allowed]])),
    )


@kernel
def gated_pairs(tracks: np.ndarray, detections: np.ndarray, settings: TrackingSettings) -> Pairs:
    """All pairs of tracks (N,) and detections (K,) within the gate, by track."""
    count = len(detections)
    x, y, half_extent = np.empty(count), np.empty(count), np.zeros(count)
    for d in range(count):
        x[d], y[d] = detections[d].position[0], detections[d].position[1]
        if settings.visible:
            half_extent[d] = 0.5 * (detections[d].size[0] + detections[d].size[1])
    room, count = len(tracks) * len(detections), 0
    pairs = Pairs(np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room))
    for t in range(len(tracks)):
        reach, mean = _reach(tracks[t], settings), tracks[t].mean
        for d in range(len(detections)):
            if max(abs(x[d] - mean[0]), abs(y[d] - mean[1])) > reach + half_extent[d]:
                continue
            cost = _pair_cost(tracks[t], detections[d], settings)
            if cost < FORBIDDEN:
                pairs.track[count], pairs.detection[count], pairs.cost[count] = t, d, cost
                count += 1
    return Pairs(pairs.track[:count], pairs.detection[:count], pairs.cost[:count])


@kernel
def _reach(track: TrackRecord, settings: TrackingSettings) -> float:
    """Distance from the track, along x or y, beyond which a point-like detection is not tried (m)."""
    own = 0.5 * (track.size[0] + track.size[1]) if settings.visible else 0.0
    variance = max(track.cov[0, 0], track.cov[1, 1]) + settings.position_sigma_m * settings.position_sigma_m
    return own + 1.45 * math.sqrt(variance * settings.gate)


@kernel
def _pair_cost(track: TrackRecord, detection: DetectionRecord, settings: TrackingSettings) -> float:
    """Cost of one pair, ``FORBIDDEN`` outside the gate."""
    if settings.visible and size_mismatch(track.size, detection.size):
        return FORBIDDEN
    e, cov = innovation(track, detection, settings), track.cov
    sxx, sxy, syy, szz = cov[0, 0] + e.r_xx, cov[0, 1] + e.r_xy, cov[1, 1] + e.r_yy, cov[2, 2] + e.r_zz
    det = sxx * syy - sxy * sxy
    d2 = (e.x * e.x * syy - 2.0 * e.x * e.y * sxy + e.y * e.y * sxx) / det + e.z * e.z / szz
    if d2 > settings.gate:
        return FORBIDDEN
    return d2 + math.log(det * szz) - settings.class_weight * math.log(class_agreement(track, detection) + 0.02)


@kernel
def class_agreement(track: TrackRecord, detection: DetectionRecord) -> float:
    """Probability that track and detection are of one class."""
    same = total = 0.0
    for c in range(len(track.votes)):
        same += track.votes[c] * detection.class_probabilities[c]
        total += track.votes[c]
    return same / total


@kernel
def size_mismatch(known: np.ndarray, measured: np.ndarray) -> bool:
    """A track may lose most of its visible part, but does not become several times as large from one frame to the
    next."""
    return max(measured[0], measured[1]) > 2.5 * max(known[0], known[1]) + 1.0
