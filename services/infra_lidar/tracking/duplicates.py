"""One road user, one track: pieces of a vehicle initiate no track of their own, duplicate tracks are merged."""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.classification.classes import BACKGROUND, CLASSES
from services.infra_lidar.jit import kernel
from services.infra_lidar.tracking.association import class_agreement, size_mismatch
from services.infra_lidar.tracking.config import TrackingConfig
from services.infra_lidar.tracking.detections import DetectionRecord
from services.infra_lidar.tracking.kalman import TRAIL, TrackRecord

_SAME_CLASS = 0.3  # probability of one class above which a piece may belong to a whole
_DUPLICATE_SHARE = 0.33  # overlap of the smaller box above which two vehicles are one
_YOUNG_NS = 1_000_000_000
_LARGE = CLASSES.index("large_vehicle")
_CAR_M, _LARGE_M = (5.5, 2.3), (19.0, 3.5)  # greatest length and width of such a vehicle
_CYCLIST, _PEDESTRIAN = CLASSES.index("cyclist"), CLASSES.index("pedestrian")
_BREAKABLE_M2 = 2.0  # larger objects may be seen in pieces; two pieces of a smaller one are two people


def initiators(tracks: np.ndarray, detections: np.ndarray, config: TrackingConfig) -> np.ndarray:
    """(M,) index of the detections (K,) that initiate a track: not assigned to one of the tracks (N,), confident
    enough, not background, no piece of a tracked object."""
    free = (detections["label"] != BACKGROUND) & (detections["confidence"] >= config.initiate_confidence)
    free[tracks["detection"][tracks["detection"] >= 0]] = False
    if config.boxes == "visible":
        _exclude_pieces(tracks, detections, free)
    return np.flatnonzero(free)


@kernel
def _exclude_pieces(tracks: np.ndarray, detections: np.ndarray, free: np.ndarray) -> None:
    """Clear ``free`` (K,) bool for every detection that is a piece of an object broken up by the clustering."""
    for d in range(len(detections)):
        for t in range(len(tracks)):
            if free[d] and _is_piece(detections[d], tracks[t]):
                free[d] = False


@kernel
def _is_piece(piece: DetectionRecord, track: TrackRecord) -> bool:
    """Inside the box of a confirmed track with a detection in this frame, smaller than it, perhaps of its class."""
    area = track.size[0] * track.size[1]
    if not track.confirmed or track.detection < 0 or area < _BREAKABLE_M2:
        return False
    c, s = math.cos(track.yaw), math.sin(track.yaw)
    dx, dy = piece.position[0] - track.mean[0], piece.position[1] - track.mean[1]
    if abs(c * dx + s * dy) >= 0.5 * track.size[0] or abs(c * dy - s * dx) >= 0.5 * track.size[1]:
        return False
    return piece.size[0] * piece.size[1] < 0.7 * area and class_agreement(track, piece) > _SAME_CLASS


def merge_duplicate_tracks(tracks: np.ndarray) -> np.ndarray:
    """Merge, in place, tracks (N,) of vehicles that move together and overlap: two vehicles cannot be in one place.

    The older track lives on, with the box and the filter of the one that is seen better. Returns (N,) int64: index of
    the track that each was merged into, -1 = none.
    """
    order = np.argsort(tracks["mean"][:, 0], kind="stable")
    place, reach = tracks["mean"][:, :2].copy(), 0.5 * (tracks["size"][:, 0] + tracks["size"][:, 1])
    return _merge_along_x(tracks, order, place, reach)


@kernel
def _merge_along_x(tracks: np.ndarray, order: np.ndarray, place: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Sweep along x. order: (N,) of rising x. place: (N, 2) x and y, reach: (N,) upper bound of the half extent (m)."""
    into = np.full(len(tracks), -1, np.int64)
    farthest = reach.max() if len(reach) else 0.0
    for i in range(len(order)):
        for j in range(i + 1, len(order)):
            a, b = order[i], order[j]
            if place[b, 0] - place[a, 0] > reach[a] + farthest:
                break
            if abs(place[b, 1] - place[a, 1]) > reach[a] + reach[b] or into[a] >= 0 or into[b] >= 0:
                continue
            k, r = (a, b) if _is_senior(tracks[a], tracks[b]) else (b, a)
            kept, removed = tracks[k], tracks[r]
            if _is_duplicate(kept, removed):
                into[r] = k
                if _is_better_seen(removed, kept):
                    _take_over_state(kept, removed)
    return into


@kernel
def _is_better_seen(one: TrackRecord, other: TrackRecord) -> bool:
    """The only one with a detection, or the one with more points. A piece that just broke off a moving vehicle has no
    velocity yet: its filter is no better."""
    if one.detection < 0 or other.detection < 0:
        return one.detection >= 0
    is_young_piece = other.moving and not one.moving and one.size[0] * one.size[1] < other.size[0] * other.size[1]
    return one.points > other.points and not is_young_piece


@kernel
def _is_senior(one: TrackRecord, other: TrackRecord) -> bool:
    """A confirmed track before a tentative one, then the older one."""
    if one.confirmed != other.confirmed:
        return one.confirmed
    return one.track_id < other.track_id


@kernel
def _is_duplicate(kept: TrackRecord, removed: TrackRecord) -> bool:
    if not (kept.confirmed and _is_vehicle(kept) and _is_vehicle(removed) and _moves_together(removed, kept)):
        return False
    return _overlap_share(kept, removed) > _DUPLICATE_SHARE


@kernel
def _is_vehicle(track: TrackRecord) -> bool:
    """Hardly a person on foot or on a bicycle."""
    return track.votes[_CYCLIST] + track.votes[_PEDESTRIAN] < 0.4 * track.votes.sum()


@kernel
def _moves_together(piece: TrackRecord, whole: TrackRecord) -> bool:
    """Whether a piece has a size and a velocity that fit the whole. Pieces change shape, so their velocity is rough; a
    young track that has not shown movement has none to compare."""
    if size_mismatch(whole.size, piece.size):
        return False
    if not piece.moving and piece.born_ns + _YOUNG_NS > piece.seen_ns:
        return True
    speed = math.hypot(whole.mean[3], whole.mean[4]) if whole.moving else 0.0
    dvx = piece.mean[3] * piece.moving - whole.mean[3] * whole.moving
    dvy = piece.mean[4] * piece.moving - whole.mean[4] * whole.moving
    return math.hypot(dvx, dvy) < 1.0 + 0.5 * speed


@kernel
def _overlap_share(first: TrackRecord, second: TrackRecord) -> float:
    """Share of the smaller footprint inside the larger one, by 5 x 5 points."""
    small, large = first, second
    if first.size[0] * first.size[1] > second.size[0] * second.size[1]:
        small, large = second, first
    dx, dy = small.mean[0] - large.mean[0], small.mean[1] - large.mean[1]
    cs, ss, cl, sl = math.cos(small.yaw), math.sin(small.yaw), math.cos(large.yaw), math.sin(large.yaw)
    max_length, max_width = _LARGE_M if large.label == _LARGE else _CAR_M
    half_length, half_width = 0.5 * min(large.size[0], max_length), 0.5 * min(large.size[1], max_width)
    inside = 0
    for i in range(-2, 3):
        for j in range(-2, 3):
            u, v = 0.2 * i * small.size[0], 0.2 * j * small.size[1]
            x, y = dx + cs * u - ss * v, dy + ss * u + cs * v
            inside += abs(cl * x + sl * y) < half_length and abs(cl * y - sl * x) < half_width
    return inside / 25.0


@kernel
def _take_over_state(kept: TrackRecord, better: TrackRecord) -> None:
    """Copy filter, box, trail and detection of ``better``; identity, age, votes and score of ``kept`` remain."""
    for i in range(6):  # loops: Numba takes seconds to compile whole-array assignments
        kept.mean[i] = better.mean[i]
        for j in range(6):
            kept.cov[i, j] = better.cov[i, j]
    for i in range(3):
        kept.size[i] = better.size[i]
    for i in range(TRAIL):
        for j in range(5):
            kept.trail[i, j] = better.trail[i, j]
    kept.yaw, kept.extent_jitter = better.yaw, better.extent_jitter
    kept.frames, kept.hit_streak = better.frames, better.hit_streak
    kept.visibility, kept.static_score = better.visibility, better.static_score
    kept.seen_ns, kept.points, kept.detection = better.seen_ns, better.points, better.detection
    kept.moving = kept.moving or better.moving
    if not kept.moving:  # alternating pieces of a standing vehicle look like movement: its trail begins anew
        kept.frames = kept.hit_streak = 0
