"""Our messages as Foxglove's own: 3-D scene, laser scan, cloud, picture, transforms, log. Pure.

Used by the recorder and by the live bridge alike. Frames: ``map`` > ``vehicle`` > ``lidar``, ``radar``; the roadside
lidar uses ``map``. Needs the extra ``foxglove``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import foxglove.messages as fg
import numpy as np

from common import messages as m
from common.recording.colours import COLOURS
from common.topics import ONBOARD_SENSORS

TRACK_LIFETIME_NS = 500_000_000
LAST_SECOND = 2**32 - 1
LOG_LEVELS = {"SAFE": "Info", "CAUTION": "Warning", "IMMINENT": "Error"}
Converted = list[tuple[str, Any]]


def convert(key: str, message: m.Message) -> Converted:
    """The Foxglove messages that show this one, each with its topic; none for what Foxglove cannot draw."""
    converter = _CONVERTERS.get(type(message))
    return converter(f"/foxglove/{key}", message) if converter else []


def _object_tracks(topic: str, message: m.ObjectTracks) -> Converted:
    entities = [_object(track, message.stamp_ns) for track in message.tracks]
    return [(topic, fg.SceneUpdate(entities=entities))]


def _object(track: m.ObjectTrack, stamp_ns: int) -> Any:
    colour = _colour(track.label, 0.35 if track.state == "coasting" else 0.7)
    pose = _pose(track.position_m, track.yaw_rad)
    speed_mps = math.hypot(*track.velocity_mps[:2])
    heading = math.atan2(track.velocity_mps[1], track.velocity_mps[0])
    arrow = fg.ArrowPrimitive(
        pose=_pose(track.position_m, heading), shaft_length=speed_mps, shaft_diameter=0.15, head_length=0.4,
        head_diameter=0.4, color=colour,
    )  # fmt: skip
    return fg.SceneEntity(
        timestamp=_time(stamp_ns),
        frame_id="map",
        id=f"object-{track.track_id}",
        lifetime=_duration(TRACK_LIFETIME_NS),
        cubes=[fg.CubePrimitive(pose=pose, size=_vector(track.size_m), color=colour)],
        arrows=[arrow] if speed_mps > 0.3 else [],
        texts=[_text(f"{track.label} {track.track_id} {speed_mps:.1f} m/s", track.position_m, 1.0 + track.size_m[2])],
    )


def _radar_tracks(topic: str, message: m.RadarTracks) -> Converted:
    return [(topic, fg.SceneUpdate(entities=[_radar_track(track, message.stamp_ns) for track in message.tracks]))]


def _radar_track(track: m.RadarTrack, stamp_ns: int) -> Any:
    azimuth_rad = track.azimuth_rad or 0.0
    at_m = (track.range_m * math.cos(azimuth_rad), track.range_m * math.sin(azimuth_rad), 0.0)
    colour = _colour(track.level, 0.8)
    away = azimuth_rad if track.velocity_mps >= 0 else azimuth_rad + math.pi
    arrow = fg.ArrowPrimitive(
        pose=_pose(at_m, away), shaft_length=abs(track.velocity_mps) / 2, shaft_diameter=0.03, head_length=0.08,
        head_diameter=0.08, color=colour,
    )  # fmt: skip
    return fg.SceneEntity(
        timestamp=_time(stamp_ns),
        frame_id="radar",
        id=f"radar-{track.track_id}",
        lifetime=_duration(TRACK_LIFETIME_NS),
        spheres=[fg.SpherePrimitive(pose=_pose(at_m, 0.0), size=_vector((0.2, 0.2, 0.2)), color=colour)],
        arrows=[arrow],
        texts=[_text(f"#{track.track_id} {track.velocity_mps:+.1f} m/s", at_m, 0.25)],
    )


def _laser_scan(topic: str, message: m.LaserScan) -> Converted:
    seen = np.asarray(message.ranges_m) > 0
    angles_rad, ranges_m = np.asarray(message.angles_rad)[seen], np.asarray(message.ranges_m)[seen]
    points = np.zeros((len(ranges_m), 3), np.float32)
    points[:, 0], points[:, 1] = ranges_m * np.cos(angles_rad), ranges_m * np.sin(angles_rad)
    return [(topic, _cloud(points, np.asarray(message.confidence)[seen], "lidar", message.stamp_ns))]


def _point_cloud(topic: str, message: m.PointCloud) -> Converted:
    return [(topic, _cloud(np.asarray(message.points), np.asarray(message.intensity), "map", message.stamp_ns))]


def _cloud(points: np.ndarray, intensity: np.ndarray, frame_id: str, stamp_ns: int) -> Any:
    packed = np.empty((len(points), 4), "<f4")
    packed[:, :3], packed[:, 3] = points, intensity
    numeric = fg.PackedElementFieldNumericType.Float32
    fields = [fg.PackedElementField(name=name, offset=4 * i, type=numeric) for i, name in enumerate("xyz")]
    fields.append(fg.PackedElementField(name="intensity", offset=12, type=numeric))
    return fg.PointCloud(
        timestamp=_time(stamp_ns), frame_id=frame_id, pose=_pose((0.0, 0.0, 0.0), 0.0), point_stride=16,
        fields=fields, data=packed.tobytes(),
    )  # fmt: skip


def _image(topic: str, message: m.CompressedImage) -> Converted:
    image = fg.CompressedImage(
        timestamp=_time(message.stamp_ns), frame_id="camera", data=message.data, format=message.format
    )
    return [(topic, image)]


def _ego(topic: str, message: m.EgoMotion) -> Converted:
    if message.T_map_vehicle is None:
        return []
    T = np.asarray(message.T_map_vehicle)
    yaw_rad = math.atan2(T[1, 0], T[0, 0])
    frame = fg.FrameTransform(
        timestamp=_time(message.stamp_ns), parent_frame_id="map", child_frame_id="vehicle",
        translation=_vector(tuple(T[:3, 3])), rotation=_turn(yaw_rad),
    )  # fmt: skip
    return [("/tf", frame)]


def _verdict(topic: str, message: m.Verdict) -> Converted:
    log = fg.Log(
        timestamp=_time(message.stamp_ns),
        level=getattr(fg.LogLevel, LOG_LEVELS[message.level]),
        message=f"{message.level} -> {message.permission}: {message.because} (rule {message.rule})",
        name="fusion",
    )
    return [(topic, log)]


def static_transforms(stamp_ns: int) -> list[Any]:
    """Where the sensors sit on the vehicle: drawn at its origin, which is all that a viewer needs."""
    return [
        fg.FrameTransform(
            timestamp=_time(stamp_ns), parent_frame_id="vehicle", child_frame_id=child,
            translation=_vector((0.0, 0.0, 0.0)), rotation=_turn(0.0),
        )
        for child in ONBOARD_SENSORS
    ]  # fmt: skip


_CONVERTERS: dict[type[m.Message], Callable[[str, Any], Converted]] = {
    m.ObjectTracks: _object_tracks,
    m.RadarTracks: _radar_tracks,
    m.LaserScan: _laser_scan,
    m.PointCloud: _point_cloud,
    m.CompressedImage: _image,
    m.EgoMotion: _ego,
    m.Verdict: _verdict,
}


def _time(stamp_ns: int) -> Any:
    """Foxglove's time ends in 2106: a later stamp, from a wrong clock, is limited so that it raises no error."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return fg.Timestamp(sec=min(seconds, LAST_SECOND), nsec=nanoseconds)


def _duration(ns: int) -> Any:
    return fg.Duration(sec=ns // 1_000_000_000, nsec=ns % 1_000_000_000)


def _vector(v: tuple[float, ...]) -> Any:
    return fg.Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _turn(yaw_rad: float) -> Any:
    return fg.Quaternion(x=0.0, y=0.0, z=math.sin(yaw_rad / 2), w=math.cos(yaw_rad / 2))


def _pose(position_m: tuple[float, ...], yaw_rad: float) -> Any:
    return fg.Pose(position=_vector(position_m), orientation=_turn(yaw_rad))


def _colour(name: str, alpha: float) -> Any:
    r, g, b = COLOURS[name]
    return fg.Color(r=r, g=g, b=b, a=alpha)


def _text(words: str, position_m: tuple[float, ...], above_m: float) -> Any:
    at = (position_m[0], position_m[1], position_m[2] + above_m)
    white = fg.Color(r=1.0, g=1.0, b=1.0, a=1.0)
    return fg.TextPrimitive(
        pose=_pose(at, 0.0), billboard=True, font_size=14.0, scale_invariant=True, color=white, text=words
    )
