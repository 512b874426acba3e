"""What a sensor's message says, in the terms of the verdict: a level and the object or zone behind it.

A message that contradicts itself (its level is lower than that of an object in it) counts as its worst part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

from common.messages import CameraDetections, Level, LidarZones, Message, RadarTracks, SelfReport, SensorMessage, worst
from services.jetson.fusion.evidence import RANK

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Reading:
    """One message, understood."""

    state: SelfReport
    reason: str
    level: Level | None = None
    static_level: Level | None = None
    nearest_m: float | None = None
    deciding: dict[str, Any] | None = None


def read(message: Message) -> Reading:
    """The reading of a lidar, radar or camera message; of any other sensor message its own word on itself."""
    match message:
        case LidarZones():
            return read_lidar(message)
        case RadarTracks():
            return read_radar(message)
        case CameraDetections():
            return read_camera(message)
        case SensorMessage():
            return Reading(message.state, message.reason)
    raise TypeError(f"no reading for {type(message).__name__}")


def read_lidar(message: LidarZones) -> Reading:
    """The worst of the three lanes and of the message's own level."""
    zones = {"left": message.left, "centre": message.centre, "right": message.right}
    name, zone = _most_serious(zones.items(), lambda item: (item[1].level, item[1].nearest_m))
    deciding = {"zone": name, "nearest_m": zone.nearest_m, "points": zone.points, "level": zone.level}
    level = worst(message.level, *(z.level for z in zones.values()))
    return Reading(message.state, message.reason, level, None, zone.nearest_m, deciding)


def read_radar(message: RadarTracks) -> Reading:
    """The worst of the tracks and of the message's own level; not settled is degraded."""
    state, reason = message.state, message.reason
    if not message.settled and state == "online":
        state, reason = "degraded", "settling: the clutter background is not learned yet"
    level = worst(message.level, *(track.level for track in message.tracks))
    if not message.tracks:
        return Reading(state, reason, level, message.static_level)
    track = _most_serious(message.tracks, lambda track: (track.level, track.range_m))
    deciding = {
        "track_id": track.track_id,
        "range_m": track.range_m,
        "azimuth_rad": track.azimuth_rad,
        "velocity_mps": track.velocity_mps,
        "ttc_s": track.ttc_s,
        "level": track.level,
    }
    return Reading(state, reason, level, message.static_level, track.range_m, deciding)


def read_camera(message: CameraDetections) -> Reading:
    """The worst detection in the forward zone; what is beside it does not count."""
    ahead = [detection for detection in message.detections if detection.in_zone]
    if not ahead:
        return Reading(message.state, message.reason, message.level)
    detection = _most_serious(ahead, lambda detection: (detection.level, detection.distance_m))
    deciding = {
        "label": detection.label,
        "confidence": detection.confidence,
        "distance_m": detection.distance_m,
        "box_xyxy_px": list(detection.box_xyxy_px),
        "level": detection.level,
    }
    level = worst(*(d.level for d in ahead), *([message.level] if message.level else []))
    return Reading(message.state, message.reason, level, None, detection.distance_m, deciding)


def _most_serious(items: Iterable[T], key: Callable[[T], tuple[Level, float | None]]) -> T:
    """The one with the highest level; of those the nearest."""

    def order(item: T) -> tuple[int, float]:
        level, distance_m = key(item)
        return -RANK[level], float("inf") if distance_m is None else distance_m

    return min(items, key=order)
