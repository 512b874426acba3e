"""What an update changes beside the filter: size, heading, class votes, and whether the track has moved at all.

Movement. The velocity of a filter is never exactly 0, least of all for a bush whose visible part changes with every
turn. So a track counts as standing, and reports velocity 0, until a detection shows that its edges have come far enough
from where they were ``movement_s`` ago: farther than ``movement_m`` plus what the visible extent usually differs by,
and than three sigma of the position, after at least six detections (four in a row if twice as far), on a way that is
straight (net displacement over 60 % of the path) and no single jump (no step over 60 % of it), seen in about every
second frame or more: in between there is only a prediction. What is left of a hedge does not begin to move, either:
most of its detections must be of something else than background. Nor does a vehicle whose box turned meanwhile: it is
being uncovered. Once moving it stays so until the displacement falls under half of that.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from services.infra_lidar.classes import BACKGROUND
from services.infra_lidar.jit import inner
from services.infra_lidar.tracking_filter import TRAIL, correct, edge_shift, extents_along, innovation

_MIN_PRESENCE = 0.45
_MAX_FIXTURE = 0.3
_MAX_TURN_RAD = 0.35  # a vehicle that is only being uncovered turns its box; one that sets off hardly does
_LONG_M = 2.0  # smaller boxes have no direction to speak of
_HEADING_MPS = 1.5  # from this speed on the heading is where the track goes


@inner
def update_pairs(
    tracks: np.ndarray, rows: np.ndarray, columns: np.ndarray, detections: np.ndarray, dt_s: float, stamp_ns: int,
    p: Any,
) -> None:  # fmt: skip
    """Feed detection ``columns[i]`` to track ``rows[i]``, in place."""
    e, work, vote_keep = np.empty(3), np.empty((6, 6)), math.exp(-dt_s / p.vote_s)
    for i in range(len(rows)):
        track, seen = tracks[rows[i]], detections[columns[i]]
        mean, position = track.mean, seen.position
        ex, ey, rxx, rxy, ryy = innovation(mean, track.size, track.yaw, position, seen.size, seen.yaw, p)
        e[0], e[1], e[2] = ex, ey, position[2] - mean[2]
        left_x, left_y = position[0] - mean[0] - ex, position[1] - mean[1] - ey
        correct(mean, track.cov, e, rxx, rxy, ryy, p.height_sigma_m * p.height_sigma_m, work)
        _follow_size(track, seen.size, seen.yaw, left_x, left_y, p.size_gain, p.visible)
        _follow_yaw(track, seen.yaw, p.yaw_gain, p.visible)
        vote(track, seen, vote_keep, p)
        track.fixture += 0.25 * ((seen.label == BACKGROUND) - track.fixture)
        track.hits += 1
        track.seen_ns = stamp_ns
        track.points = seen.points
        track.detection = columns[i]


@inner
def vote(track: Any, seen: Any, keep: float, p: Any) -> None:
    """Add a detection's word on the class; the label changes when another class leads by the margin."""
    for c in range(len(track.votes)):
        if not p.mean_votes:
            track.votes[c] = keep * track.votes[c] + seen.chances[c]
            track.vote_count[c] = keep * track.vote_count[c] + 1.0
        elif c == seen.label:
            track.votes[c] = keep * track.votes[c] + seen.confidence
            track.vote_count[c] = keep * track.vote_count[c] + 1.0
    best = 0
    for c in range(1, len(track.votes)):
        if strength(track, c) > strength(track, best):
            best = c
    leads = strength(track, best) > strength(track, track.label) + p.vote_margin
    if leads or (track.hits == 0 and not p.mean_votes):
        track.label = best


@inner
def strength(track: Any, label: int) -> float:
    """How much of the votes a class has; 0 for "unknown"."""
    if label >= len(track.votes) or track.vote_count[label] == 0.0:
        return 0.0
    return min(track.votes[label] / track.vote_count[label], 1.0)


@inner
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
    along = _resize(track.size[:1], length, c * left_x + s * left_y, gain, visible)
    across = _resize(track.size[1:2], width, c * left_y - s * left_x, gain, visible)
    _resize(track.size[2:], box[2], 0.0, gain, visible)
    track.mean[0] += c * along - s * across
    track.mean[1] += s * along + c * across


@inner
def _resize(size: np.ndarray, measured: float, left: float, gain: float, visible: bool) -> float:
    shrink = 0.1 if size[0] > 1.5 else 0.5
    rate = gain if measured > size[0] or not visible else shrink * gain
    change = rate * (measured - size[0])
    size[0] += change
    room = 0.5 * abs(change) if visible else 0.0
    return min(max(left, -room), room)


@inner
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


@inner
def _wrap(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@inner
def note_place(track: Any, slot: int) -> None:
    """Write centre and axis-parallel half extents into a slot of the trail."""
    c, s, place = abs(math.cos(track.yaw)), abs(math.sin(track.yaw)), track.trail[slot]
    place[0], place[1] = track.mean[0], track.mean[1]
    place[2] = 0.5 * (c * track.size[0] + s * track.size[1])
    place[3] = 0.5 * (s * track.size[0] + c * track.size[1])
    place[4] = track.yaw


@inner
def _way(now: np.ndarray, then: np.ndarray) -> float:
    """How far the edges say it has come."""
    along, _ = edge_shift(now[0] - then[0], 2.0 * now[2], 2.0 * then[2])
    across, _ = edge_shift(now[1] - then[1], 2.0 * now[3], 2.0 * then[3])
    return math.hypot(along, across)


@inner
def _turned(angle: float) -> float:
    """How far a box has turned; a quarter of a circle is none."""
    return abs(angle - 0.5 * math.pi * math.floor(angle / (0.5 * math.pi) + 0.5))


@inner
def judge_movement(tracks: np.ndarray, slot: int, back: int, p: Any) -> None:
    """Write the present place into ring slot ``slot`` and decide who moves; ``back`` frames are looked at."""
    for t in range(len(tracks)):
        track = tracks[t]
        note_place(track, slot)
        steps = min(back, track.frames, TRAIL - 1)
        track.frames += 1
        track.run = track.run + 1 if track.detection >= 0 else 0
        track.presence += 0.25 * ((track.detection >= 0) - track.presence)
        if p.movement_m == 0.0:
            track.moving = True
        elif steps >= 3 and max(track.run, min(track.hits, track.frames) - 2) >= 4 and track.detection >= 0:
            track.moving = _moves(track, slot, steps, p.movement_m)


@inner
def _moves(track: Any, slot: int, steps: int, movement_m: float) -> bool:
    """Has it come far enough in the last ``steps`` frames, straight and without a jump?"""
    net = _way(track.trail[slot], track.trail[(slot - steps) % TRAIL])
    needed = max(movement_m + track.wobble, 3.0 * math.sqrt(max(track.cov[0, 0], track.cov[1, 1])))
    if track.moving:
        return net > 0.5 * needed
    turn = _turned(track.trail[slot, 4] - track.trail[(slot - steps) % TRAIL, 4])
    if turn > _MAX_TURN_RAD and max(track.size[0], track.size[1]) > _LONG_M:
        return False
    sure = steps >= 5 and min(track.hits, track.frames) >= 6
    if track.presence <= _MIN_PRESENCE or track.fixture > _MAX_FIXTURE or net <= (needed if sure else 2.0 * needed):
        return False
    path = largest = 0.0
    for k in range(steps):
        now, before = track.trail[(slot - k) % TRAIL], track.trail[(slot - k - 1) % TRAIL]
        step = math.hypot(now[0] - before[0], now[1] - before[1])
        path, largest = path + step, max(largest, step)
    return net > 0.6 * path and largest < 0.6 * net
