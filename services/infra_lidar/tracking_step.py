"""A frame of the tracker in two compiled calls, around the Hungarian: what takes microseconds is called once.

Tracks lie together at the head of an array of ``TRACK`` with room for more; those that are given up are closed up, and
new ones are written behind the last.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.classes import CLASSES
from services.infra_lidar.jit import inner, kernel
from services.infra_lidar.tracking_assign import allowed_pairs, chosen_pairs, easy_pairs
from services.infra_lidar.tracking_filter import predict
from services.infra_lidar.tracking_life import begin_frame, found, judge_lives
from services.infra_lidar.tracking_overlap import absorb_doubles, founders
from services.infra_lidar.tracking_shape import judge_movement, update_pairs
from services.infra_lidar.tracking_split import cut_groups

_CLASS_COUNT = len(CLASSES)


@kernel
def describe(
    box: np.ndarray, label: np.ndarray, confidence: np.ndarray, points: np.ndarray, chances: np.ndarray, T: np.ndarray,
    made: np.ndarray,
) -> None:  # fmt: skip
    """Fill ``made`` (K,) ``DETECTION``. box (K, 7 or more): centre x, y, z, length, width, height, yaw. points (K,) or
    none; chances (K, C) over ``CLASSES`` or none: then they follow from label and confidence, the rest spread over the
    other classes; unknown is evenly so. T (4, 4): of the map and the frame that the boxes are in."""
    turn = math.atan2(T[1, 0], T[0, 0])
    for d in range(len(made)):
        one, x, y, z = made[d], np.float64(box[d, 0]), np.float64(box[d, 1]), np.float64(box[d, 2])
        for i in range(3):
            one.position[i], one.size[i] = T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3], box[d, 3 + i]
        one.yaw, one.label, one.confidence = box[d, 6] + turn, label[d], min(max(confidence[d], 0.0), 1.0)
        one.points = points[d] if len(points) else 0
        known = label[d] < _CLASS_COUNT
        share = one.confidence if known else 1.0 / _CLASS_COUNT
        for c in range(_CLASS_COUNT):
            if len(chances):
                one.chances[c] = chances[d, c]
            else:
                one.chances[c] = share if known and c == label[d] else (1.0 - share) / (_CLASS_COUNT - 1)


@kernel
def candidates(
    tracks: np.ndarray, seen: np.ndarray, stamp_ns: int, dt_s: float, cut: bool, settings: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Bring every track to the time of this frame, ``cut`` clusters of people where their tracks are, and look who may
    be who.

    Returns the detections, with the index of that of ``seen`` each comes from, none if they are the same; then what
    ``easy_pairs`` says of them.
    """
    p, source = settings[0], np.empty(0, np.int64)
    begin_frame(tracks, stamp_ns)
    predict(tracks, dt_s, p)
    if cut:
        pieces, source = cut_groups(tracks, seen)
        if len(source):
            seen = pieces
    rows, columns, costs = allowed_pairs(tracks, seen, p)
    sure_t, sure_d, contested_t, contested_d, rest = easy_pairs(rows, columns, costs, len(tracks), len(seen))
    return seen, source, sure_t, sure_d, contested_t, contested_d, rest


@kernel
def conclude(
    room: np.ndarray, count: int, sure_t: np.ndarray, sure_d: np.ndarray, contested_t: np.ndarray,
    contested_d: np.ndarray, costs: np.ndarray, r: np.ndarray, c: np.ndarray, seen: np.ndarray, dt_s: float,
    stamp_ns: int, slot: int, ring_ns: np.ndarray, first_id: int, blank: np.ndarray, absorb: bool, settings: np.ndarray,
) -> tuple[int, int, np.ndarray]:  # fmt: skip
    """Correct the tracks that were seen, decide which of all move, retire, found, and give up doubles.

    sure_t to c: the pairs, as ``chosen_pairs`` takes them. room: the tracks, ``count`` of them, and room for as many
    more as there are detections. slot: of the trail, the slots of which were written at ``ring_ns``. blank (1,)
    ``TRACK``: a new track. Returns the number of tracks, how many of them are new, and the ids (L, 2) of the doubles
    that were given up and of the tracks for which.
    """
    p = settings[0]
    rows, columns = chosen_pairs(sure_t, sure_d, contested_t, contested_d, costs, r, c)
    update_pairs(room[:count], rows, columns, seen, dt_s, stamp_ns, p)
    judge_movement(room[:count], slot, _frames_within(p.movement_s, ring_ns, stamp_ns), p)
    count = keep(room, judge_lives(room[:count], seen, dt_s, stamp_ns, p))
    new = founders(room[:count], seen, columns, p)
    for i in range(len(new)):
        room[count + i] = blank[0]
    found(room[count : count + len(new)], seen, new, first_id, stamp_ns, slot, p)
    count += len(new)
    given_up = np.empty((count if absorb else 0, 2), np.int64)
    number = 0
    if absorb:
        into = absorb_doubles(room[:count])
        for t in range(count):
            if into[t] >= 0:
                given_up[number, 0], given_up[number, 1] = room[t].track_id, room[into[t]].track_id
                number += 1
        count = keep(room, into < 0)
    return count, len(new), given_up[:number]


@inner
def _frames_within(span_s: float, ring_ns: np.ndarray, stamp_ns: int) -> int:
    back = 0
    for written_ns in ring_ns:
        back += stamp_ns - written_ns <= span_s * 1e9
    return back


@kernel
def keep(room: np.ndarray, alive: np.ndarray) -> int:
    """Close up the tracks at the head of ``room`` that are ``alive`` (N,) bool; returns how many they are."""
    kept = 0
    for t in range(len(alive)):
        if alive[t]:
            if kept < t:
                room[kept] = room[t]
            kept += 1
    return kept
