"""One road user, one track: pieces of a vehicle found no track of their own, and second tracks are given up."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from services.infra_lidar.classes import BACKGROUND, CLASSES
from services.infra_lidar.jit import inner
from services.infra_lidar.ordering import places_of, rising
from services.infra_lidar.tracking_assign import another_size

_SAME_CLASS = 0.3  # chance of being of one class from which on a piece may belong to a whole
_DOUBLE_SHARE = 0.33  # of a box inside another from which on two vehicles are one
_YOUNG_NS = 1_000_000_000
_LARGE = CLASSES.index("large_vehicle")
_CAR_M, _LARGE_M = (5.5, 2.3), (19.0, 3.5)  # length and width that such a vehicle may have
_CYCLIST, _PEDESTRIAN = CLASSES.index("cyclist"), CLASSES.index("pedestrian")
_BREAKABLE_M2 = 2.0  # a vehicle may fall apart into pieces; two people who part are two people


@inner
def founders(tracks: np.ndarray, detections: np.ndarray, taken: np.ndarray, p: Any) -> np.ndarray:
    """Indices of the detections that may found a track: nobody has ``taken`` them, sure enough, no background,
    no piece of a whole."""
    free = np.ones(len(detections), np.bool_)
    free[taken] = False
    for d in range(len(detections)):
        may = detections[d].label != BACKGROUND and detections[d].confidence >= p.found_confidence
        free[d] = free[d] and may
    if p.visible:
        for t in range(len(tracks)):
            _claim_pieces(tracks[t], detections, free)
    return places_of(free)


@inner
def _claim_pieces(track: Any, detections: np.ndarray, free: np.ndarray) -> None:
    """A detection inside the box of a confirmed track that was seen in this frame, smaller than it, and maybe of its
    class, is a piece of an object that the clustering broke: it is not free."""
    if not track.confirmed or track.detection < 0 or track.size[0] * track.size[1] < _BREAKABLE_M2:
        return
    c, s, total = math.cos(track.yaw), math.sin(track.yaw), all_votes(track)
    for d in range(len(detections)):
        if not free[d]:
            continue
        piece = detections[d]
        dx, dy = piece.position[0] - track.mean[0], piece.position[1] - track.mean[1]
        inside = abs(c * dx + s * dy) < 0.5 * track.size[0] and abs(c * dy - s * dx) < 0.5 * track.size[1]
        if inside and piece.size[0] * piece.size[1] < 0.7 * track.size[0] * track.size[1]:
            same = 0.0
            for k in range(len(track.votes)):
                same += track.votes[k] * piece.chances[k]
            free[d] = same <= _SAME_CLASS * total


@inner
def absorb_doubles(tracks: np.ndarray) -> np.ndarray:
    """(N,) int64: -1, or the index of the track that this one is given up for. Two vehicles cannot be in one place:
    where two tracks that go the same way share much of the smaller one's box, the older one lives on, with the box and
    the filter of whichever has more points."""
    count = len(tracks)
    into, farthest = np.full(count, -1, np.int64), 0.0
    x, y, reach = np.empty(count), np.empty(count), np.empty(count)
    for t in range(count):
        x[t], y[t] = tracks[t].mean[0], tracks[t].mean[1]
        reach[t] = 0.5 * (tracks[t].size[0] + tracks[t].size[1])
        farthest = max(farthest, reach[t])
    order = rising(x)
    for i in range(count):
        one = order[i]
        for j in range(i + 1, count):
            other = order[j]
            if x[other] - x[one] > reach[one] + farthest:
                break
            if abs(y[other] - y[one]) > reach[one] + reach[other]:
                continue
            if into[one] < 0 and into[other] < 0:
                _absorb(tracks, one, other, into)
    return into


@inner
def _absorb(tracks: np.ndarray, one: int, other: int, into: np.ndarray) -> None:
    """The confirmed one lives on; of two confirmed ones the older one."""
    a, b = one, other
    if tracks[a].confirmed == tracks[b].confirmed:
        if tracks[b].track_id < tracks[a].track_id:
            a, b = other, one
    elif tracks[b].confirmed:
        a, b = other, one
    keeper, double = tracks[a], tracks[b]
    if not (keeper.confirmed and _vehicle(keeper) and _vehicle(double) and _goes_with(double, keeper)):
        return
    if _shared(keeper, double) > _DOUBLE_SHARE:
        into[b] = a
        if double.detection >= 0 and (keeper.detection < 0 or double.points > keeper.points):
            _take_over(keeper, double)


@inner
def _vehicle(track: Any) -> bool:
    """Large enough, and hardly a person on foot or on a bicycle."""
    people = track.votes[_CYCLIST] + track.votes[_PEDESTRIAN]
    return people < 0.4 * all_votes(track)


@inner
def all_votes(track: Any) -> float:
    """The sum of a track's votes."""
    total = 0.0
    for c in range(len(track.votes)):
        total += track.votes[c]
    return total


@inner
def _goes_with(piece: Any, whole: Any) -> bool:
    """Of a size that may be one with it, and the same velocity as far as can be told. Pieces change shape, so their
    velocity is rough; a young track that has not shown movement has none to compare."""
    if another_size(whole.size, piece.size):
        return False
    if not piece.moving and piece.born_ns + _YOUNG_NS > piece.seen_ns:
        return True
    speed = math.hypot(whole.mean[3], whole.mean[4]) if whole.moving else 0.0
    du = piece.mean[3] * piece.moving - whole.mean[3] * whole.moving
    dv = piece.mean[4] * piece.moving - whole.mean[4] * whole.moving
    return math.hypot(du, dv) < 1.0 + 0.5 * speed


@inner
def _shared(first: Any, second: Any) -> float:
    """Share of the smaller box's footprint that lies in the larger one's, by 5 x 5 points."""
    small, large = first, second
    if first.size[0] * first.size[1] > second.size[0] * second.size[1]:
        small, large = second, first
    dx, dy = small.mean[0] - large.mean[0], small.mean[1] - large.mean[1]
    if math.hypot(dx, dy) > 0.5 * (small.size[0] + small.size[1] + large.size[0] + large.size[1]):
        return 0.0
    cs, ss, cl, sl = math.cos(small.yaw), math.sin(small.yaw), math.cos(large.yaw), math.sin(large.yaw)
    most_long, most_wide = _LARGE_M if large.label == _LARGE else _CAR_M
    half_length, half_width = 0.5 * min(large.size[0], most_long), 0.5 * min(large.size[1], most_wide)
    inside = 0
    for i in range(-2, 3):
        for j in range(-2, 3):
            u, v = 0.2 * i * small.size[0], 0.2 * j * small.size[1]
            x, y = dx + cs * u - ss * v, dy + ss * u + cs * v
            inside += abs(cl * x + sl * y) < half_length and abs(cl * y - sl * x) < half_width
    return inside / 25.0


@inner
def _take_over(track: Any, better: Any) -> None:
    """Identity, age, votes and score stay; place, movement, box and detection are the other one's."""
    for i in range(6):  # spelled out: whole-array assignments take the compiler seconds
        track.mean[i] = better.mean[i]
        for j in range(6):
            track.cov[i, j] = better.cov[i, j]
    for i in range(3):
        track.size[i] = better.size[i]
    for i in range(track.trail.shape[0]):
        for j in range(track.trail.shape[1]):
            track.trail[i, j] = better.trail[i, j]
    track.yaw, track.wobble = better.yaw, better.wobble
    track.frames, track.run, track.presence, track.fixture = better.frames, better.run, better.presence, better.fixture
    track.seen_ns, track.points, track.detection = better.seen_ns, better.points, better.detection
    track.moving = track.moving or better.moving
    if not track.moving:  # pieces of what stands take turns, and such a way is none: it is looked at anew
        track.frames = track.run = 0
