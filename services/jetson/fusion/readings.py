"""What a sensor's message says, in the terms of the verdict: a level and the object or zone behind it.

A message that contradicts itself (its level is lower than that of an object in it) counts as its worst part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

from common.messages import (
    CameraDetection,
    CameraDetections,
    LaneLayout,
    Level,
    LidarZone,
    LidarZones,
    Message,
    ObjectTracks,
    RadarTrack,
    RadarTracks,
    SelfReport,
    worst,
)
from services.jetson.fusion.evidence import RANK, Place, Sighting

T = TypeVar("T")

LIDAR_HALF_CONE = math.tan(math.radians(20.0))  # the lidar judges no return outside
USUAL_LANES = LaneLayout(centre_width_m=0.25, side_width_m=0.19, look_ahead_m=3.0, imminent_m=0.8, caution_m=1.8)
PICTURE_WIDTH = 1.6  # metres that a picture is wide at one metre; only to tell objects side by side apart
RADAR_RADIUS_M, CAMERA_RADIUS_M = 0.2, 0.25
MAX_SIGHTINGS = 16  # the worst and nearest


@dataclass(frozen=True, slots=True)
class Reading:
    """One message, understood."""

    state: SelfReport
    reason: str
    level: Level | None = None
    static_level: Level | None = None
    nearest_m: float | None = None
    deciding: dict[str, Any] | None = None
    sightings: tuple[Sighting, ...] = ()
    raw_level: Level | None = None  # before the sensor's own counting


def read(message: Message) -> Reading:
    """The reading of one sensor's message. The roadside's level is worked out later, from its tracks.

    Raises:
        TypeError: a message without a reading: its sensor would pass for one that sees nothing.
    """
    match message:
        case LidarZones():
            return read_lidar(message)
        case RadarTracks():
            return read_radar(message)
        case CameraDetections():
            return read_camera(message)
        case ObjectTracks():
            return Reading(message.state, message.reason)
    raise TypeError(f"no reading for {type(message).__name__}")


def read_lidar(message: LidarZones) -> Reading:
    """The worst of the three lanes and of the message's own level."""
    zones = {"left": message.left, "centre": message.centre, "right": message.right}
    name, zone = _most_serious(zones.items(), lambda item: (item[1].level, item[1].nearest_m))
    deciding = {"zone": name, "nearest_m": zone.nearest_m, "points": zone.points, "level": zone.level}
    level = worst(message.level, *(z.level for z in zones.values()))
    lanes = message.layout or USUAL_LANES
    seen = _foremost(_lane_sighting(one, z, lanes) for one, z in zones.items() if z.level != "SAFE")
    return Reading(message.state, message.reason, level, None, zone.nearest_m, deciding, seen, message.raw_level)


def _lane_sighting(name: str, zone: LidarZone, lanes: LaneLayout) -> Sighting:
    """The lane's nearest obstacle: in the lane's middle, or where the cone's edge cuts the lane."""
    side = {"left": 1.0, "centre": 0.0, "right": -1.0}[name]
    width_m = lanes.side_width_m if side else lanes.centre_width_m
    if zone.nearest_m is None:
        return Sighting(zone.level, None, name, key=name)
    middle_m = side * min((lanes.centre_width_m + lanes.side_width_m) / 2, zone.nearest_m * LIDAR_HALF_CONE)
    return Sighting(zone.level, Place(zone.nearest_m, middle_m, width_m / 2), name, key=name)


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
    seen = _foremost(track_sighting(track) for track in message.tracks if track.level != "SAFE")
    return Reading(state, reason, level, message.static_level, track.range_m, deciding, seen)


def track_sighting(track: RadarTrack) -> Sighting:
    """One track as the verdict takes it."""
    azimuth_rad = track.azimuth_rad or 0.0
    x_m, y_m = track.range_m * math.cos(azimuth_rad), track.range_m * math.sin(azimuth_rad)
    return Sighting(track.level, Place(x_m, y_m, RADAR_RADIUS_M))


def read_camera(message: CameraDetections) -> Reading:
    """The worst detection in the forward zone; what is beside it, or a box of one picture alone, does not count."""
    ahead = [detection for detection in message.detections if detection.in_zone and detection.seen_before]
    if not ahead:
        return Reading(message.state, message.reason, message.level)
    detection = _most_serious(ahead, lambda detection: (detection.level, near_end_m(detection)))
    deciding = {
        "label": detection.label,
        "confidence": detection.confidence,
        "distance_m": detection.distance_m,
        "nearest_m": near_end_m(detection),
        "box_xyxy_px": list(detection.box_xyxy_px),
        "level": detection.level,
    }
    level = worst(*(d.level for d in ahead), *([message.level] if message.level else []))
    seen = _foremost(_box_sighting(one, message.image_size_px[0]) for one in ahead)
    return Reading(message.state, message.reason, level, None, near_end_m(detection), deciding, seen)


def near_end_m(detection: CameraDetection) -> float:
    """Distance to the object's nearest side, by which its level goes; its middle where the sender tells no more."""
    return detection.distance_m if detection.nearest_m is None else detection.nearest_m


def _box_sighting(detection: CameraDetection, width_px: int) -> Sighting:
    distance_m = near_end_m(detection)
    left_px, _, right_px, _ = detection.box_xyxy_px
    aside = 0.5 - (left_px + right_px) / 2 / width_px if width_px else 0.0  # share of the width, to the left
    return Sighting(
        detection.level, Place(distance_m, aside * PICTURE_WIDTH * distance_m, CAMERA_RADIUS_M), detection.label
    )


def _foremost(sightings: Iterable[Sighting]) -> tuple[Sighting, ...]:
    def order(sighting: Sighting) -> tuple[int, float]:
        return -RANK[sighting.level], math.inf if sighting.place is None else sighting.place.x_m

    return tuple(sorted(sightings, key=order)[:MAX_SIGHTINGS])


def _most_serious(items: Iterable[T], key: Callable[[T], tuple[Level, float | None]]) -> T:
    """The one with the highest level; of those the nearest."""

    def order(item: T) -> tuple[int, float]:
        level, distance_m = key(item)
        return -RANK[level], float("inf") if distance_m is None else distance_m

    return min(items, key=order)
