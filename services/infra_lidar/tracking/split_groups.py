"""Split clusters of people at the predicted positions of their tracks.

The article's track-guided split, on boxes instead of points, into as many pieces as tracks are predicted inside (the
article takes the first two). It precedes the assignment, so that every track finds its piece.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.jit import kernel
from services.infra_lidar.tracking.detections import DETECTION, DetectionRecord
from services.infra_lidar.tracking.kalman import TrackRecord

_CYCLIST, _PEDESTRIAN = CLASSES.index("cyclist"), CLASSES.index("pedestrian")
_PERSON_M = 1.6  # greatest width of a pedestrian, or of a cyclist across
_GROUP_M = (0.7, 3.5)  # long side of a cluster of some people
_HEIGHT_M = (0.8, 2.3)
_SPACING_M, _PIECE_M = 0.3, 0.2  # least distance between two people, least extent of one piece
_MARGIN_M = 0.1  # how far outside the box a prediction may lie
_MAX_PEOPLE = 8  # in one cluster


def split_groups(tracks: np.ndarray, detections: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Replace every group of people among the detections (K,) by one piece for each track (N,) predicted inside.

    Returns (K',) ``DETECTION``, the whole ones first, and (K',) int64, the index of the detection that each comes from.
    A piece has the class probabilities of its track: a cluster of several people says nothing about one.
    """
    people = np.flatnonzero(_are_people(tracks))
    source = np.arange(len(detections))
    if len(people) < 2:
        return detections, source
    pieces, origin = _split(tracks, people, detections)
    if not len(pieces):
        return detections, source
    whole = np.delete(source, origin)
    return np.concatenate((detections[whole], pieces)), np.concatenate((whole, origin))


def _are_people(tracks: np.ndarray) -> np.ndarray:
    """(N,) bool: confirmed tracks of pedestrians and cyclists."""
    votes, size = tracks["votes"], tracks["size"]
    of_people = votes[:, _CYCLIST] + votes[:, _PEDESTRIAN] > 0.5 * votes.sum(axis=1)
    return np.asarray(tracks["confirmed"] & of_people & (np.maximum(size[:, 0], size[:, 1]) < _PERSON_M))


@kernel
def _split(tracks: np.ndarray, people: np.ndarray, detections: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pieces (P,) ``DETECTION`` and the index of the detection that each comes from; people: indices of tracks."""
    pieces = np.empty(_MAX_PEOPLE * len(detections), DETECTION)
    origin, count = np.empty(len(pieces), np.int64), 0
    for d in range(len(detections)):
        if not _may_be_group(detections[d].size):
            continue
        inside, place = _predicted_inside(tracks, people, detections[d])
        edges = _edges_between(place, max(detections[d].size[0], detections[d].size[1]))
        for i in range(len(edges) - 1):
            pieces[count], origin[count] = detections[d], d
            _shorten(pieces[count], tracks[inside[i]], edges[i], edges[i + 1])
            count += 1
    return pieces[:count], origin[:count]


@kernel
def _may_be_group(size: np.ndarray) -> bool:
    """Whether some people together can be as large as that."""
    longer, shorter = max(size[0], size[1]), min(size[0], size[1])
    return _GROUP_M[0] < longer < _GROUP_M[1] and shorter < _PERSON_M and _HEIGHT_M[0] < size[2] < _HEIGHT_M[1]


@kernel
def _predicted_inside(
    tracks: np.ndarray, people: np.ndarray, detection: DetectionRecord
) -> tuple[np.ndarray, np.ndarray]:
    """Index of the tracks predicted inside a detection, in order along its long side, and their position on it from
    the centre (m)."""
    length, width, c, s = detection.size[0], detection.size[1], math.cos(detection.yaw), math.sin(detection.yaw)
    inside, place, count = np.empty(_MAX_PEOPLE, np.int64), np.empty(_MAX_PEOPLE), 0
    for t in people:
        dx, dy = tracks[t].mean[0] - detection.position[0], tracks[t].mean[1] - detection.position[1]
        u, v = c * dx + s * dy, c * dy - s * dx
        if abs(u) >= 0.5 * length + _MARGIN_M or abs(v) >= 0.5 * width + _MARGIN_M or count == _MAX_PEOPLE:
            continue
        along, k = u if length >= width else v, count
        while k > 0 and place[k - 1] > along:  # insertion sort
            inside[k], place[k] = inside[k - 1], place[k - 1]
            k -= 1
        inside[k], place[k] = t, along
        count += 1
    return inside[:count], place[:count]


@kernel
def _edges_between(place: np.ndarray, extent: float) -> np.ndarray:
    """(n + 1,) edges of the pieces along the long side, half way between n neighbours; none where only one person is
    inside, two are too near each other, or a piece would be too small."""
    count = len(place)
    edges = np.empty(count + 1)
    edges[0], edges[-1] = -0.5 * extent, 0.5 * extent
    for k in range(1, count):
        if place[k] - place[k - 1] < _SPACING_M:
            return edges[:0]
        edges[k] = 0.5 * (place[k] + place[k - 1])
    for k in range(count):
        if edges[k + 1] - edges[k] < _PIECE_M:
            return edges[:0]
    return edges if count >= 2 else edges[:0]


@kernel
def _shorten(piece: DetectionRecord, track: TrackRecord, low: float, high: float) -> None:
    """Leave of a detection the part from ``low`` to ``high`` along its long side (m), with the class of its track."""
    axis = 0 if piece.size[0] >= piece.size[1] else 1
    heading, middle = piece.yaw + 0.5 * math.pi * axis, 0.5 * (low + high)
    piece.position[0] += middle * math.cos(heading)
    piece.position[1] += middle * math.sin(heading)
    piece.points = int(piece.points * (high - low) / piece.size[axis])
    piece.size[axis] = high - low
    piece.label = track.label
    votes = track.votes.sum()
    for c in range(len(track.votes)):
        piece.class_probabilities[c] = track.votes[c] / votes
