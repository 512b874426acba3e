"""Life of a track: initiated, scored, confirmed, ended."""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.jit import kernel
from services.infra_lidar.tracking.config import TrackingConfig, TrackingSettings
from services.infra_lidar.tracking.kalman import TRACK, TRAIL, FrameTime, TrackRecord, edge_shift

_MIN_VISIBILITY = 0.45
_MAX_STATIC_SCORE = 0.3
_MAX_TURN_RAD = 0.35
_LONG_M = 2.0  # smaller boxes have no reliable direction


@kernel
def record_trail(tracks: np.ndarray, slot: int) -> None:
    """Write the box of every track (N,) into a slot of its trail."""
    for t in range(len(tracks)):
        _write_box(tracks[t].trail[slot], tracks[t].mean, tracks[t].size, tracks[t].yaw)


@kernel
def _write_box(place: np.ndarray, centre: np.ndarray, size: np.ndarray, yaw: float) -> None:
    """Write one entry of a trail (5,): centre, axis-parallel half extents (m) and yaw (rad) of a box."""
    c, s = abs(math.cos(yaw)), abs(math.sin(yaw))
    place[0], place[1] = centre[0], centre[1]
    place[2] = 0.5 * (c * size[0] + s * size[1])
    place[3] = 0.5 * (s * size[0] + c * size[1])
    place[4] = yaw


@kernel
def judge_movement(tracks: np.ndarray, detections: np.ndarray, time: FrameTime, settings: TrackingSettings) -> None:
    """Add this frame to the trails and decide which of the tracks (N,) move, in place.

    A track begins to move only if its detection, of the (K,) of this frame, has shifted too: a wrong velocity carries
    the track itself away from where its detections are.
    """
    record_trail(tracks, time.trail_slot)
    measured = np.empty(5)
    for t in range(len(tracks)):
        track = tracks[t]
        hit = track.detection >= 0
        steps = min(time.trail_frames, track.frames, TRAIL - 1)
        track.frames += 1
        track.hit_streak = track.hit_streak + 1 if hit else 0
        track.visibility += 0.25 * (hit - track.visibility)
        if settings.movement_m == 0.0:
            track.moving = True
        elif hit and steps >= 3 and max(track.hit_streak, min(track.hits, track.frames) - 2) >= 4:
            detection = detections[track.detection]
            _write_box(measured, detection.position, detection.size, detection.yaw)
            track.moving = _moves(track, measured, time.trail_slot, steps, settings.movement_m)


@kernel
def _moves(track: TrackRecord, measured: np.ndarray, slot: int, steps: int, movement_m: float) -> bool:
    """Whether the edges of the box have shifted over the last ``steps`` frames, by more than ``movement_m``, the jitter
    of the box and three sigma, on a fairly straight way and not in one jump.

    ``measured`` (5,): box of the detection; its edges have to have shifted as far. A track that moves already needs
    half of the shift of the track only.
    """
    now, then = track.trail[slot], track.trail[(slot - steps) % TRAIL]
    displacement = _edge_displacement(now, then)
    needed = max(movement_m + track.extent_jitter, 3.0 * math.sqrt(max(track.cov[0, 0], track.cov[1, 1])))
    if track.moving:
        return displacement > 0.5 * needed
    if _turned_by(now[4] - then[4]) > _MAX_TURN_RAD and max(track.size[0], track.size[1]) > _LONG_M:
        return False
    if track.visibility <= _MIN_VISIBILITY or track.static_score > _MAX_STATIC_SCORE:
        return False
    well_observed = steps >= 5 and min(track.hits, track.frames) >= 6
    if displacement <= (needed if well_observed else 2.0 * needed) or _edge_displacement(measured, then) <= needed:
        return False
    path = largest = 0.0
    for k in range(steps):
        after, before = track.trail[(slot - k) % TRAIL], track.trail[(slot - k - 1) % TRAIL]
        step = math.hypot(after[0] - before[0], after[1] - before[1])
        path, largest = path + step, max(largest, step)
    return displacement > 0.6 * path and largest < 0.6 * displacement


@kernel
def _edge_displacement(now: np.ndarray, then: np.ndarray) -> float:
    """Displacement between two entries of a trail (5,), judged by the edges of the box (m)."""
    along_x, _ = edge_shift(now[0] - then[0], 2.0 * now[2], 2.0 * then[2])
    along_y, _ = edge_shift(now[1] - then[1], 2.0 * now[3], 2.0 * then[3])
    return math.hypot(along_x, along_y)


@kernel
def _turned_by(angle_rad: float) -> float:
    """Angle by which a box has turned; a quarter of a circle counts as none."""
    return abs(angle_rad - 0.5 * math.pi * math.floor(angle_rad / (0.5 * math.pi) + 0.5))


_DRIFT_NS = 200_000_000  # a standing track without a detection keeps its estimated velocity for this long
_ROUNDING_S = 1e-6  # of times that are whole frames apart


def stop_lost_tracks(tracks: np.ndarray, stamp_ns: int) -> None:
    """Set the velocity of standing tracks (N,) without a detection to 0, in place: they must not drift with noise."""
    lost = ~tracks["moving"] & (stamp_ns - tracks["seen_ns"] > _DRIFT_NS)
    tracks["mean"][lost, 3:] = 0.0


def manage_tracks(tracks: np.ndarray, detections: np.ndarray, time: FrameTime, config: TrackingConfig) -> np.ndarray:
    """Score and confirm every track (N,), in place. Returns (N,) bool: which of them live on.

    With ``coast_as_known`` a confirmed track coasts no longer than it had been observed before, but at least
    ``tentative_gap_s``.
    """
    hit = tracks["detection"] >= 0
    confidence = np.zeros(len(tracks))
    confidence[hit] = detections["confidence"][tracks["detection"][hit]]
    tracks["score"] += (1.0 - math.exp(-time.dt_s / config.score_s)) * (confidence - tracks["score"])
    old_enough = 1e-9 * (time.stamp_ns - tracks["born_ns"]) >= config.confirm_s - _ROUNDING_S
    tracks["confirmed"] |= (tracks["hits"] >= config.confirm_hits) & old_enough
    coast_s = np.full(len(tracks), config.coast_s)
    if config.coast_as_known:
        coast_s = np.minimum(coast_s, 1e-9 * (tracks["seen_ns"] - tracks["born_ns"]))
    allowed_s = np.where(tracks["confirmed"], np.maximum(coast_s, config.tentative_gap_s), config.tentative_gap_s)
    return np.asarray(1e-9 * (time.stamp_ns - tracks["seen_ns"]) <= allowed_s + _ROUNDING_S)


def initiate(
    detections: np.ndarray, index: np.ndarray, first_id: int, time: FrameTime, config: TrackingConfig
) -> np.ndarray:
    """(M,) ``TRACK``: new tracks at the detections of the frame (K,) with this index (M,), ids from ``first_id`` on."""
    seen, new = detections[index], np.zeros(len(index), TRACK)
    new["track_id"] = first_id + np.arange(len(index))
    new["mean"][:, :3], new["cov"] = seen["position"], _initial_covariance(config)
    for name in ("size", "yaw", "points"):
        new[name] = seen[name]
    new["votes"], new["vote_weight"] = seen["class_probabilities"], 1.0
    new["label"] = seen["class_probabilities"].argmax(axis=1)
    new["born_ns"] = new["seen_ns"] = time.stamp_ns
    for name in ("hits", "hit_streak", "frames", "visibility"):
        new[name] = 1
    new["confirmed"] = config.confirm_hits <= 1 and config.confirm_s <= 0.0
    new["moving"] = config.movement_m == 0.0
    new["score"] = 0.5 * seen["confidence"]
    new["detection"] = index
    record_trail(new, time.trail_slot)
    return new


def _initial_covariance(config: TrackingConfig) -> np.ndarray:
    """(6, 6) of a new track, diagonal: m^2 and (m/s)^2."""
    plane_m, height_m = config.position_sigma_m, config.height_sigma_m
    speed, climb = config.velocity_sigma_mps, config.climb_sigma_mps
    return np.diag(np.square([plane_m, plane_m, height_m, speed, speed, climb]))
