"""People who were apart and now stand close enough to be one cluster: their tracks tell where to cut it.

The article's track-guided split, on boxes instead of points, between as many tracks as are predicted inside (the
article takes the first two), before the assignment: every track then finds its piece.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from services.infra_lidar.classes import CLASSES
from services.infra_lidar.jit import inner
from services.infra_lidar.ordering import places_of, rising
from services.infra_lidar.tracking_overlap import all_votes

_CYCLIST, _PEDESTRIAN = CLASSES.index("cyclist"), CLASSES.index("pedestrian")
_PERSON_M = 1.6  # no person on foot, and no cyclist across, is wider
_GROUP_M = (0.7, 3.5)  # the long side of a cluster of some people
_HEIGHT_M = (0.8, 2.3)
_APART_M, _PIECE_M, _MARGIN_M = 0.3, 0.2, 0.1  # between two, least of one, and how far outside a prediction may lie
_MOST = 8  # people in one cluster


@inner
def cut_groups(tracks: np.ndarray, detections: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Detections (``DETECTION``) with the groups cut into one piece a track: what is whole, then the pieces, and the
    index of the detection that each came from. Nothing where none is cut.

    A piece has the class chances of its track: a cluster of several says nothing about one.
    """
    who, people = np.empty(len(tracks), np.int64), 0
    for t in range(len(tracks)):
        who[people] = t
        people += _is_person(tracks[t])
    source, owner, low, high = _cuts(tracks, detections, who[: people if people >= 2 else 0])
    whole = np.ones(len(detections), np.bool_)
    for d in source:
        whole[d] = False
    kept = places_of(whole)
    number = len(kept) + len(source) if len(source) else 0
    made, origin = np.empty(number, detections.dtype), np.empty(number, np.int64)
    for i in range(number):
        piece = i - len(kept)
        origin[i] = kept[i] if piece < 0 else source[piece]
        made[i] = detections[origin[i]]
        if piece >= 0:
            _shorten(made[i], tracks[owner[piece]], low[piece], high[piece])
    return made, origin


@inner
def _cuts(
    tracks: np.ndarray, detections: np.ndarray, who: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pieces: index of the detection, of its track, and where it begins and ends along the long side, from the middle
    (m). who: the tracks that are people."""
    room = _MOST * len(detections) if len(who) else 0
    source, owner = np.empty(room, np.int64), np.empty(room, np.int64)
    low, high, pieces = np.empty(room), np.empty(room), 0
    for d in range(len(detections) if len(who) else 0):
        if not _may_be_group(detections[d].size):
            continue
        inside, place = _predicted_inside(tracks, who, detections[d])
        extent = max(detections[d].size[0], detections[d].size[1])
        edges = np.empty(len(inside) + 1)
        if len(inside) < 2 or not _cut(place, extent, edges):
            continue
        for i in range(len(inside)):
            source[pieces], owner[pieces] = d, inside[i]
            low[pieces], high[pieces] = edges[i], edges[i + 1]
            pieces += 1
    return source[:pieces], owner[:pieces], low[:pieces], high[:pieces]


@inner
def _shorten(piece: Any, track: Any, low: float, high: float) -> None:
    """Leave of a detection what lies from low to high along its long side, as one of its track's class."""
    along = 0 if piece.size[0] >= piece.size[1] else 1
    heading, middle = piece.yaw + 0.5 * math.pi * along, 0.5 * (low + high)
    piece.position[0] += middle * math.cos(heading)
    piece.position[1] += middle * math.sin(heading)
    piece.points = int(piece.points * (high - low) / piece.size[along])
    piece.size[along] = high - low
    piece.label = track.label
    votes = all_votes(track)
    for c in range(len(track.votes)):
        piece.chances[c] = track.votes[c] / votes


@inner
def _is_person(track: Any) -> bool:
    people = track.votes[_CYCLIST] + track.votes[_PEDESTRIAN]
    return track.confirmed and people > 0.5 * all_votes(track) and max(track.size[0], track.size[1]) < _PERSON_M


@inner
def _may_be_group(size: np.ndarray) -> bool:
    """Whether some people together can be as large as that."""
    longer, shorter = max(size[0], size[1]), min(size[0], size[1])
    return _GROUP_M[0] < longer < _GROUP_M[1] and shorter < _PERSON_M and _HEIGHT_M[0] < size[2] < _HEIGHT_M[1]


@inner
def _predicted_inside(tracks: np.ndarray, who: np.ndarray, seen: Any) -> tuple[np.ndarray, np.ndarray]:
    """The people predicted inside a cluster, in their order along its long side, and where."""
    length, width, c, s = seen.size[0], seen.size[1], math.cos(seen.yaw), math.sin(seen.yaw)
    inside, place, found = np.empty(_MOST, np.int64), np.empty(_MOST), 0
    for t in who:
        dx, dy = tracks[t].mean[0] - seen.position[0], tracks[t].mean[1] - seen.position[1]
        u, v = c * dx + s * dy, c * dy - s * dx
        if abs(u) < 0.5 * length + _MARGIN_M and abs(v) < 0.5 * width + _MARGIN_M and found < _MOST:
            inside[found], place[found] = t, u if length >= width else v
            found += 1
    sorted_inside, sorted_place = np.empty(found, np.int64), np.empty(found)
    for i, k in enumerate(rising(place[:found])):
        sorted_inside[i], sorted_place[i] = inside[k], place[k]
    return sorted_inside, sorted_place


@inner
def _cut(place: np.ndarray, extent: float, edges: np.ndarray) -> bool:
    """Cut half way between neighbours; false where two are too near each other, or a piece would be too small."""
    edges[0], edges[-1] = -0.5 * extent, 0.5 * extent
    for k in range(1, len(place)):
        if place[k] - place[k - 1] < _APART_M:
            return False
        edges[k] = 0.5 * (place[k] + place[k - 1])
    narrowest = np.inf
    for k in range(len(place)):
        narrowest = min(narrowest, edges[k + 1] - edges[k])
    return narrowest >= _PIECE_M
