"""Tracks of the roadside lidar, seen from the vehicle: does one of them run into us, and when?

Each track is carried from its measurement to now with constant velocity, its covariance with it
(P' = F P F^T + Q, white acceleration), then into the vehicle's frame and relative to the vehicle's own motion. The time
to collision is when the relative path enters the vehicle's outline, widened by the object's size and uncertainty
(slab method, Kay and Kajiya 1986).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from common.geometry import invert
from common.messages import LEVELS, Level, ObjectTrack
from services.jetson.fusion.config import RoadsideConfig
from services.jetson.fusion.evidence import RANK

MAX_SIGMA_M = 2.0  # a track less certain than this says nothing about a corridor of a metre


@dataclass(frozen=True, slots=True)
class Threat:
    """The roadside object that reaches the vehicle first."""

    level: Level
    distance_m: float
    deciding: dict[str, Any]


@dataclass(frozen=True, slots=True)
class TrackTable:
    """The tracks of one message as arrays."""

    tracks: tuple[ObjectTrack, ...]
    position_m: np.ndarray  # (N, 3) float64, map frame, at the measurement
    velocity_mps: np.ndarray  # (N, 3) map frame
    covariance: np.ndarray  # (N, 6, 6) of position and velocity
    radius_m: np.ndarray  # (N,) of the circle around the box


def tabulate(tracks: list[ObjectTrack]) -> TrackTable:
    """Confirmed and coasting tracks of anything that is not scenery; what has no class keeps its right to alarm."""
    kept = tuple(track for track in tracks if track.state != "tentative" and track.label != "background")
    return TrackTable(
        kept,
        np.array([track.position_m for track in kept], float).reshape(len(kept), 3),
        np.array([track.velocity_mps for track in kept], float).reshape(len(kept), 3),
        np.array([track.covariance for track in kept], float).reshape(len(kept), 6, 6),
        np.array([max(track.size_m[0], track.size_m[1]) / 2 for track in kept], float),
    )


def compensate(table: TrackTable, age_s: float, acceleration_mps2: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) now, and the larger standard deviation (N,) of each in the plane."""
    F = np.eye(6)
    F[:3, 3:] = age_s * np.eye(3)
    predicted = F @ table.covariance @ F.T
    variance = np.linalg.eigvalsh(predicted[:, :2, :2])[:, -1] + (acceleration_mps2 * age_s**2 / 2) ** 2
    return table.position_m + age_s * table.velocity_mps, np.sqrt(np.maximum(variance, 0.0))


def relative_motion(
    position_m: np.ndarray,
    velocity_mps: np.ndarray,
    T_map_vehicle: np.ndarray,
    speed_mps: float,
    yaw_rate_radps: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (N, 2) in the vehicle's frame, as the moving, turning vehicle sees them."""
    T_vehicle_map = invert(T_map_vehicle)
    rotation, origin_m = T_vehicle_map[:3, :3], T_vehicle_map[:3, 3]
    position, velocity = position_m @ rotation.T + origin_m, velocity_mps @ rotation.T
    turning = yaw_rate_radps * np.column_stack([-position[:, 1], position[:, 0]])
    return position[:, :2], velocity[:, :2] - np.array([speed_mps, 0.0]) - turning


def time_to_enter(
    position_m: np.ndarray, velocity_mps: np.ndarray, low_m: np.ndarray, high_m: np.ndarray
) -> np.ndarray:
    """(N,) seconds until each straight path is inside its box (N, 2 corners); inf = never, 0 = already inside."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        to_low, to_high = (low_m - position_m) / velocity_mps, (high_m - position_m) / velocity_mps
    inside = (position_m >= low_m) & (position_m <= high_m)
    still = velocity_mps == 0.0
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(to_low, to_high)).max(axis=1)
    leave = np.where(still, np.inf, np.maximum(to_low, to_high)).min(axis=1)
    return np.where((leave >= 0.0) & (enter <= leave), np.maximum(enter, 0.0), np.inf)


def find_threat(
    table: TrackTable,
    age_s: float,
    T_map_vehicle: np.ndarray,
    speed_mps: float,
    yaw_rate_radps: float,
    config: RoadsideConfig,
) -> Threat | None:
    """The most urgent track on its way into the vehicle's outline; None when nothing is.

    A track whose centre lies in the outline is the vehicle itself as the pole sees it.
    """
    if not table.tracks:
        return None
    # 1. from the measurement to now
    position_m, sigma_m = compensate(table, age_s, config.acceleration_mps2)
    # 2. from the map to the vehicle
    position, velocity = relative_motion(position_m, table.velocity_mps, T_map_vehicle, speed_mps, yaw_rate_radps)
    # 3. when does each path enter the widened outline
    low, high = np.array([-config.rear_m, -config.half_width_m]), np.array([config.front_m, config.half_width_m])
    margin = (table.radius_m + config.sigmas * sigma_m)[:, None]
    ttc_s = time_to_enter(position, velocity, low - margin, high + margin)
    # 4. only what moves, is certain enough and is not ourselves
    itself = ((position >= low) & (position <= high)).all(axis=1)
    slow = np.linalg.norm(velocity, axis=1) < config.min_speed_mps
    receding = (position * velocity).sum(axis=1) >= 0.0
    ttc_s = np.where(itself | slow | receding | (sigma_m > MAX_SIGMA_M), np.inf, ttc_s)
    first = int(np.argmin(ttc_s))
    if ttc_s[first] >= config.caution_ttc_s:
        return None
    level: Level = "IMMINENT" if ttc_s[first] < config.imminent_ttc_s else "CAUTION"
    return _threat(level, table.tracks[first], position[first], velocity[first], ttc_s[first], sigma_m[first])


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


def _threat(
    level: Level, track: ObjectTrack, position: np.ndarray, velocity: np.ndarray, ttc_s: float, sigma_m: float
) -> Threat:
    deciding = {
        "track_id": track.track_id,
        "label": track.label,
        "position_m": [round(float(v), 2) for v in position],
        "velocity_mps": [round(float(v), 2) for v in velocity],
        "ttc_s": round(float(ttc_s), 2),
        "sigma_m": round(float(sigma_m), 2),
    }
    return Threat(level, float(np.linalg.norm(position)), deciding)
