"""What an update changes beside the filter: size, heading, class votes, and whether the track has moved at all.

Movement. The velocity of a filter is never exactly 0, least of all for a bush whose visible part changes with every
turn. So a track counts as standing, and reports velocity 0, until a detection shows that its edges have come far enough
from where they were ``movement_s`` ago: farther than ``movement_m`` plus what the visible extent usually differs by,
and than three sigma of the position, after at least six detections (four in a row if twice as far), on a way that is
straight (net displacement over 60 % of the path) and no single jump (no step over 60 % of it), seen in about every
second frame or more: in between there is only a prediction. Once moving it stays so until the displacement falls under
half of that.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from services.infra_lidar.tracking_filter import TRAIL, correct, edge_shift, extents_along, innovation

_SAME_CLASS = 0.3  # chance of being of one class from which on a piece may belong to a whole
_BREAKABLE_M2 = 2.0  # a vehicle may fall apart into pieces; two people who part are two people
_MIN_PRESENCE = 0.45
_HEADING_MPS = 1.5  # from this speed on the heading is where the track goes
_jit = njit(nogil=True, cache=True, error_model="numpy")


@_jit
def update_pairs(
    tracks: np.ndarray, pairs: np.ndarray, position: np.ndarray, size: np.ndarray, yaw: np.ndarray,
    chances: np.ndarray, points: np.ndarray, sigma: float, height_sigma: float, visible: bool,
    size_gain: float, yaw_gain: float, vote_keep: float, stamp_ns: int,
) -> None:  # fmt: skip
    """Feed detection ``pairs[i, 1]`` to track ``pairs[i, 0]``, in place."""
    pair, e = np.empty(5), np.empty(3)
    for i in range(len(pairs)):
        track, d = tracks[pairs[i, 0]], pairs[i, 1]
        mean = track.mean
        innovation(mean, track.size, track.yaw, position[d], size[d], yaw[d], sigma, visible, pair)
        e[0], e[1], e[2] = pair[0], pair[1], position[d, 2] - mean[2]
        left_x, left_y = position[d, 0] - mean[0] - e[0], position[d, 1] - mean[1] - e[1]
        correct(mean, track.cov, e, pair[2], pair[3], pair[4], height_sigma * height_sigma)
        _follow_size(track, size[d], yaw[d], left_x, left_y, size_gain, visible)
        _follow_yaw(track, yaw[d], yaw_gain, visible)
        for c in range(len(track.votes)):
            track.votes[c] = vote_keep * track.votes[c] + chances[d, c]
        track.hits += 1
        track.seen_ns = stamp_ns
        track.points = points[d]
        track.detection = d


@_jit
def _follow_size(
    track: Any, box: np.ndarray, box_yaw: float, left_x: float, left_y: float, gain: float, visible: bool
) -> None:
    """Grow towards the measured size, shrink ten times slower; the centre takes what growth explains.

    ``left`` is the part of the centre's jump that no motion explains (map frame).
    """
    c, s = math.cos(track.yaw), math.sin(track.yaw)
    length, width = extents_along(box, box_yaw, track.yaw)
    differs = max(abs(length - track.size[0]), abs(width - track.size[1]))
    track.wobble += max(0.2, 1.0 / track.hits) * (differs - track.wobble)
    along = _resize(track.size, 0, length, c * left_x + s * left_y, gain, visible)
    across = _resize(track.size, 1, width, c * left_y - s * left_x, gain, visible)
    _resize(track.size, 2, box[2], 0.0, gain, visible)
    track.mean[0] += c * along - s * across
    track.mean[1] += s * along + c * across


@_jit
def _resize(size: np.ndarray, axis: int, measured: float, left: float, gain: float, visible: bool) -> float:
    shrink = 0.1 if size[axis] > 1.5 else 0.5
    rate = gain if measured > size[axis] or not visible else shrink * gain
    change = rate * (measured - size[axis])
    size[axis] += change
    room = 0.5 * abs(change) if visible else 0.0
    return min(max(left, -room), room)


@_jit
def _follow_yaw(track: Any, yaw: float, gain: float, visible: bool) -> None:
    """Turn towards the measured box, or towards where the track goes once it is under way."""
    vx, vy = track.mean[3], track.mean[4]
    if visible and track.moving and math.hypot(vx, vy) > _HEADING_MPS:
        heading = math.atan2(vy, vx)
        quarter = math.floor((heading - track.yaw) / (0.5 * math.pi) + 0.5)
        if quarter % 2 == 1:  # the long side lay across the way: it was the front that had been seen
            track.size[0], track.size[1] = track.size[1], track.size[0]
        track.yaw = track.yaw + quarter * 0.5 * math.pi
        turn = heading - track.yaw
    else:
        period = 0.5 * math.pi if visible else math.pi
        turn = yaw - track.yaw
        turn -= period * math.floor(turn / period + 0.5)
    track.yaw = _wrap(track.yaw + gain * _wrap(turn))


@_jit
def _wrap(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@_jit
def note_place(track: Any, slot: int) -> None:
    """Write centre and axis-parallel half extents into a slot of the trail."""
    c, s, place = abs(math.cos(track.yaw)), abs(math.sin(track.yaw)), track.trail[slot]
    place[0], place[1] = track.mean[0], track.mean[1]
    place[2] = 0.5 * (c * track.size[0] + s * track.size[1])
    place[3] = 0.5 * (s * track.size[0] + c * track.size[1])


@_jit
def note_places(tracks: np.ndarray, slot: int) -> None:
    """The same for all of them."""
    for t in range(len(tracks)):
        note_place(tracks[t], slot)


@_jit
def _way(now: np.ndarray, then: np.ndarray) -> float:
    """How far the edges say it has come."""
    along, _ = edge_shift(now[0] - then[0], 2.0 * now[2], 2.0 * then[2])
    across, _ = edge_shift(now[1] - then[1], 2.0 * now[3], 2.0 * then[3])
    return math.hypot(along, across)


@_jit
def judge_movement(tracks: np.ndarray, slot: int, back: int, movement_m: float) -> None:
    """Write the present place into ring slot ``slot`` and decide who moves; ``back`` frames are looked at."""
    for t in range(len(tracks)):
        track = tracks[t]
        note_place(track, slot)
        steps = min(back, track.frames, TRAIL - 1)
        track.frames += 1
        track.run = track.run + 1 if track.detection >= 0 else 0
        track.presence += 0.25 * ((track.detection >= 0) - track.presence)
        if steps < 3 or max(track.run, track.hits - 2) < 4 or track.detection < 0:
            continue
        path = largest = 0.0
        for k in range(steps):
            now, before = track.trail[(slot - k) % TRAIL], track.trail[(slot - k - 1) % TRAIL]
            step = math.hypot(now[0] - before[0], now[1] - before[1])
            path, largest = path + step, max(largest, step)
        net = _way(track.trail[slot], track.trail[(slot - steps) % TRAIL])
        needed = max(movement_m + track.wobble, 3.0 * math.sqrt(max(track.cov[0, 0], track.cov[1, 1])))
        if track.moving:
            track.moving = net > 0.5 * needed
        else:
            sure = steps >= 5 and track.hits >= 6
            far = net > needed if sure else net > 2.0 * needed
            straight = net > 0.6 * path and largest < 0.6 * net
            track.moving = far and straight and track.presence > _MIN_PRESENCE


@_jit
def pieces_of_known(tracks: np.ndarray, position: np.ndarray, size: np.ndarray, chances: np.ndarray) -> np.ndarray:
    """(K,) bool: the detection lies inside the box of a confirmed track that was seen in this frame, is smaller, and
    may well be of its class: a piece of an object that the clustering broke, and no object of its own."""
    piece = np.zeros(len(position), np.bool_)
    for t in range(len(tracks)):
        track = tracks[t]
        if not track.confirmed or track.detection < 0 or track.size[0] * track.size[1] < _BREAKABLE_M2:
            continue
        c, s, total = math.cos(track.yaw), math.sin(track.yaw), track.votes.sum()
        for d in range(len(position)):
            dx, dy = position[d, 0] - track.mean[0], position[d, 1] - track.mean[1]
            inside = abs(c * dx + s * dy) < 0.5 * track.size[0] and abs(c * dy - s * dx) < 0.5 * track.size[1]
            if inside and size[d, 0] * size[d, 1] < 0.7 * track.size[0] * track.size[1]:
                same = 0.0
                for k in range(len(track.votes)):
                    same += track.votes[k] * chances[d, k]
                piece[d] |= same > _SAME_CLASS * total
    return piece
