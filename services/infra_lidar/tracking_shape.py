"""What an update changes beside the filter: size, heading, class votes, and whether the track has moved at all.

Movement. The velocity of a filter is never exactly 0, least of all for a bush whose visible part changes with every
turn. So a track counts as standing, and reports velocity 0, until a detection shows that it has come far enough from
where it was ``movement_s`` ago: farther than ``movement_m`` plus what its visible extent usually differs by, and than
three sigma of its position, over at least five frames (three if twice as far), on a way that is straight (net
displacement over 60 % of the path) and no single jump (no step over 60 % of it). Once moving it stays so until the
displacement falls under half of that.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from services.infra_lidar.tracking_filter import TRAIL, correct, extents_along, innovation

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
    rate = gain if measured > size[axis] or not visible else 0.1 * gain
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
def judge_movement(tracks: np.ndarray, slot: int, back: int, movement_m: float) -> None:
    """Write the present position into ring slot ``slot`` and decide who moves; ``back`` frames are looked at."""
    for t in range(len(tracks)):
        track = tracks[t]
        track.trail[slot, 0], track.trail[slot, 1] = track.mean[0], track.mean[1]
        steps = min(back, track.frames, TRAIL - 1)
        track.frames += 1
        if steps < 3 or track.detection < 0:
            continue
        path = largest = 0.0
        for k in range(steps):
            now, before = track.trail[(slot - k) % TRAIL], track.trail[(slot - k - 1) % TRAIL]
            step = math.hypot(now[0] - before[0], now[1] - before[1])
            path, largest = path + step, max(largest, step)
        then = track.trail[(slot - steps) % TRAIL]
        net = math.hypot(track.mean[0] - then[0], track.mean[1] - then[1])
        needed = max(movement_m + track.wobble, 3.0 * math.sqrt(max(track.cov[0, 0], track.cov[1, 1])))
        if track.moving:
            track.moving = net > 0.5 * needed
        else:
            far = net > needed if steps >= 5 else net > 2.0 * needed
            track.moving = far and net > 0.6 * path and largest < 0.6 * net
