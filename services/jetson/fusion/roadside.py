"""Tracks of the roadside lidar, seen from the vehicle: does one of them run into us, and when?

Each track is carried from its measurement to now with constant velocity, its covariance with it
(P' = F P F^T + Q, white acceleration), then into the vehicle's frame. The time to collision is when its oriented box
touches the vehicle's outline, both on their ways (``outlines.py``). Our own vehicle is among the tracks
(``own_track.py``).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from common.geometry import invert
from common.messages import LEVELS, Level, ObjectTrack, ObjectTracks
from services.jetson.fusion.config import RoadsideConfig
from services.jetson.fusion.evidence import RANK
from services.jetson.fusion.outlines import Boxes, Outline, time_to_touch
from services.jetson.fusion.own_track import OwnTrack
from services.jetson.fusion.vehicle import Vehicle

MAX_SIGMA_M = 2.0  # a track less certain than this says nothing about a corridor of a metre


@dataclass(frozen=True, slots=True)
class Threat:
    """The roadside object that reaches the vehicle first."""

    level: Level
    distance_m: float
    deciding: dict[str, Any]


class Around(NamedTuple):
    """The tracks of one message as the vehicle sees them now."""

    tracks: tuple[ObjectTrack, ...]
    boxes: Boxes
    sigma_m: np.ndarray  # (N,) the larger standard deviation of the place in the plane
    relative_mps: np.ndarray  # (N, 2) velocity as the moving, turning vehicle sees it
    beside_m: np.ndarray  # (N,) from the outline to the middle of the box; 0 inside


def counting(tracks: list[ObjectTrack]) -> tuple[ObjectTrack, ...]:
    """Confirmed and coasting tracks of anything that is not scenery; what has no class keeps its right to alarm."""
    return tuple(track for track in tracks if track.state != "tentative" and track.label != "background")


def look_around(
    tracks: tuple[ObjectTrack, ...], age_s: float, T_map_vehicle: np.ndarray, own: Outline, acceleration_mps2: float
) -> Around:
    """The tracks now, ``age_s`` after they were measured, in the frame of the vehicle."""
    n = len(tracks)
    position = np.array([track.position_m for track in tracks], float).reshape(n, 3)
    velocity = np.array([track.velocity_mps for track in tracks], float).reshape(n, 3)
    covariance = np.array([track.covariance for track in tracks], float).reshape(n, 6, 6)
    # 1. from the measurement to now
    F = np.eye(6)
    F[:3, 3:] = age_s * np.eye(3)
    covariance = F @ covariance @ F.T
    covariance[:, range(2), range(2)] += (acceleration_mps2 * age_s**2 / 2) ** 2
    # 2. from the map to the vehicle
    T = invert(T_map_vehicle)
    centre = (position + age_s * velocity) @ T[:3, :3].T + T[:3, 3]
    over_ground = velocity @ T[:3, :3].T
    turn = np.kron(np.eye(2), T[:3, :3])
    plane = (turn @ covariance @ turn.T)[:, [0, 1, 3, 4]][:, :, [0, 1, 3, 4]]
    yaw = np.array([track.yaw_rad for track in tracks], float) + np.arctan2(T[1, 0], T[0, 0])
    half_m = np.array([track.size_m[:2] for track in tracks], float).reshape(n, 2) / 2
    # 3. relative to the vehicle
    turning = own.yaw_rate_radps * np.column_stack([-centre[:, 1], centre[:, 0]])
    return Around(
        tracks,
        Boxes(centre[:, :2], over_ground[:, :2], yaw, half_m, plane),
        np.sqrt(np.maximum(np.linalg.eigvalsh(plane[:, :2, :2])[:, -1], 0.0)) if n else np.zeros(0),
        over_ground[:, :2] - np.array([own.speed_mps, 0.0]) - turning,
        _beside(centre, own),
    )


def find_threat(around: Around, own: Outline, own_id: int | None, config: RoadsideConfig) -> Threat | None:
    """The most urgent track on its way into the vehicle's outline; None when nothing is. ``own_id`` is ourselves."""
    if not around.tracks:
        return None
    ttc_s = time_to_touch(around.boxes, own, config.caution_ttc_s, config.sigmas)
    # only what moves, is certain enough and is not ourselves; what touches us already counts while it comes nearer
    itself = np.array([track.track_id == own_id for track in around.tracks])
    slow = np.linalg.norm(around.relative_mps, axis=1) < config.min_speed_mps
    leaving = (ttc_s == 0.0) & ((around.boxes.centre_m * around.relative_mps).sum(axis=1) >= 0.0)
    ttc_s = np.where(itself | slow | leaving | (around.sigma_m > MAX_SIGMA_M), np.inf, ttc_s)
    first = int(np.argmin(ttc_s))
    if ttc_s[first] >= config.caution_ttc_s:
        return None
    return _threat("IMMINENT" if ttc_s[first] < config.imminent_ttc_s else "CAUTION", around, first, ttc_s[first])


def _beside(centre_m: np.ndarray, own: Outline) -> np.ndarray:
    """(N,) from the outline to points (N, 2 or 3), 0 inside it."""
    x, y = centre_m[:, 0], np.abs(centre_m[:, 1])
    outside_x = np.maximum(np.maximum(x - own.front_m, -own.rear_m - x), 0.0)
    return np.asarray(np.hypot(outside_x, np.maximum(y - own.half_width_m, 0.0)))


class RoadsideWatch:
    """What the roadside means for us, message by message: finds ourselves among the tracks, and the threat."""

    def __init__(self, config: RoadsideConfig) -> None:
        self._config = config
        self._own_track = OwnTrack()
        self._alarm = RoadsideAlarm(config)

    def reset(self) -> None:
        """The roadside or our pose is gone; what was said is worth nothing any more."""
        self._alarm.reset()
        self._own_track.reset()

    def take(self, message: ObjectTracks, age_s: float, vehicle: Vehicle) -> None:
        """One more message, ``age_s`` after its measurement; unknown motion counts as standing, as it must for a pose
        that is only configured.

        Raises:
            ValueError: the vehicle's pose is unknown.
        """
        if vehicle.T_map_vehicle is None:
            raise ValueError("without the vehicle's pose no track can be placed")
        config = self._config
        own = Outline(
            config.front_m, config.rear_m, config.half_width_m, vehicle.ground_speed_mps, vehicle.ground_yaw_rate_radps
        )
        tracks = counting(message.tracks)
        around = look_around(tracks, age_s, vehicle.T_map_vehicle, own, config.acceleration_mps2)
        reach = np.where(around.beside_m <= config.own_error_m, around.beside_m, np.inf)
        speeds = np.linalg.norm(around.relative_mps, axis=1)
        differs_mps = config.own_speed_mps if vehicle.ground_motion_is_known else np.inf
        own_id = self._own_track.find([track.track_id for track in tracks], reach, speeds, differs_mps)
        self._alarm.update(find_threat(around, own, own_id, config))

    @property
    def level(self) -> Level | None:
        """The debounced level, None when there is none."""
        return self._alarm.level

    @property
    def threat(self) -> Threat | None:
        """The newest threat, for the explanation."""
        return self._alarm.threat


class RoadsideAlarm:
    """Debounces the threats of successive messages: raised after some in a row, lowered after some more in a row."""

    def __init__(self, config: RoadsideConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        """The roadside is gone; what it said is worth nothing any more."""
        self._ranks: deque[int] = deque(maxlen=max(self._config.raise_messages, self._config.clear_messages))
        self._rank = 0
        self.threat: Threat | None = None  # the newest, for the explanation

    def update(self, threat: Threat | None) -> Level | None:
        """Take the threat in one more message; returns the debounced level, None when there is none."""
        self._ranks.append(0 if threat is None else RANK[threat.level])
        self.threat = threat or self.threat
        recent = list(self._ranks)
        if len(recent) >= self._config.raise_messages:
            self._rank = max(self._rank, min(recent[-self._config.raise_messages :]))
        if len(recent) >= self._config.clear_messages:
            self._rank = min(self._rank, max(recent[-self._config.clear_messages :]))
        return self.level

    @property
    def level(self) -> Level | None:
        """The debounced level, None when there is none."""
        return LEVELS[self._rank] if self._rank else None


def _threat(level: Level, around: Around, index: int, ttc_s: float) -> Threat:
    track, position, velocity = around.tracks[index], around.boxes.centre_m[index], around.relative_mps[index]
    deciding = {
        "track_id": track.track_id,
        "label": track.label,
        "position_m": [round(float(v), 2) for v in position],
        "velocity_mps": [round(float(v), 2) for v in velocity],
        "ttc_s": round(float(ttc_s), 2),
        "sigma_m": round(float(around.sigma_m[index]), 2),
    }
    return Threat(level, float(np.linalg.norm(position)), deciding)
