"""Our messages as Rerun's archetypes: 3-D boxes and points, picture, plots, log. Pure; needs the extra ``rerun``.

Entities: ``map`` > ``map/vehicle`` > ``map/vehicle/lidar`` and ``.../radar``; the roadside lidar uses ``map``.
Everything lies on the timeline ``stamp``: UTC of the measurement.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from common import messages as m
from common.codec import DecodeError, decode
from common.recording.colours import COLOURS
from common.topics import find_topic

TIMELINE = "stamp"
STATES = {"online": 0, "degraded": 1, "disconnected": 2, "starting": 1}
LOG_LEVELS = {"SAFE": "INFO", "CAUTION": "WARN", "IMMINENT": "ERROR", "green": "INFO", "amber": "WARN", "red": "ERROR"}
Entries = list[tuple[str, Any]]


class Sentence(NamedTuple):
    """For the log, where it is written when it changes: not twenty times a second."""

    text: str
    level: str


class RerunLog:
    """Writes messages as they come to a Rerun recording stream."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self._said: dict[str, Sentence] = {}
        self.logged = self.undecodable = 0
        stream.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def add(self, key: str, payload: bytes) -> None:
        """One message as it was on the wire; what Rerun cannot show is left out."""
        topic = find_topic(key)
        if topic is None:
            return
        try:
            message = decode(payload, topic.message, topic.max_bytes)
        except DecodeError:
            self.undecodable += 1
            return
        shown = entries(key, message)
        if shown:
            self._stream.set_time(TIMELINE, timestamp=np.datetime64(message.stamp_ns, "ns"))
        for path, what in shown:
            if not isinstance(what, Sentence):
                self._stream.log(path, what)
            elif self._said.get(path) != what:
                self._said[path] = what
                self._stream.log(path, rr.TextLog(what.text, level=what.level))
        self.logged += bool(shown)


def entries(key: str, message: m.Message) -> Entries:
    """What shows this message, each with its entity; none for what Rerun cannot draw."""
    converter = _CONVERTERS.get(type(message))
    return converter(key, message) if converter else []


def _verdict(key: str, message: m.Verdict) -> Entries:
    words = f"{message.level} -> {message.permission}: {message.because} (rule {message.rule})"
    ages = [
        (f"verdict/age_ms/{name}", rr.Scalars(one.age_ms))
        for name, one in message.inputs.items()
        if one.age_ms is not None
    ]
    level = rr.Scalars(m.LEVELS.index(message.level))
    return [("verdict/level", level), ("verdict/log", Sentence(words, LOG_LEVELS[message.level])), *ages]


def _health(key: str, message: m.SystemHealth) -> Entries:
    states = [(f"health/state/{name}", rr.Scalars(STATES[one.state])) for name, one in message.sensors.items()]
    return [("health/log", Sentence(message.summary, LOG_LEVELS[message.colour])), *states]


def _status(key: str, message: m.ServiceStatus) -> Entries:
    service = key.removesuffix("/status")
    words = f"{service} {message.state}: {message.reason}".removesuffix(": ")
    figures = (("rate_hz", message.rate_hz), ("rss_mb", message.rss_mb), ("bad_input", message.bad_input))
    return [
        (f"services/{service}/log", Sentence(words, "INFO" if message.state == "online" else "WARN")),
        *((f"services/{service}/{name}", rr.Scalars(value)) for name, value in figures),
    ]


def _object_tracks(key: str, message: m.ObjectTracks) -> Entries:
    tracks, colours = message.tracks, [_colour(track.label) for track in message.tracks]
    boxes = rr.Boxes3D(
        centers=_rows([track.position_m for track in tracks]),
        sizes=_rows([track.size_m for track in tracks]),
        rotation_axis_angles=[rr.RotationAxisAngle(axis=(0, 0, 1), radians=track.yaw_rad) for track in tracks],
        labels=[f"{track.label} {track.track_id}  {math.hypot(*track.velocity_mps[:2]):.1f} m/s" for track in tracks],
        colors=colours,
    )
    arrows = rr.Arrows3D(
        origins=_rows([track.position_m for track in tracks]),
        vectors=_rows([track.velocity_mps for track in tracks]),
        colors=colours,
    )
    return [("map/objects", boxes), ("map/objects/velocity", arrows)]


def _radar_tracks(key: str, message: m.RadarTracks) -> Entries:
    azimuths_rad = np.array([track.azimuth_rad or 0.0 for track in message.tracks])
    away = np.column_stack([np.cos(azimuths_rad), np.sin(azimuths_rad), np.zeros_like(azimuths_rad)])
    at_m = away * np.array([[track.range_m] for track in message.tracks]).reshape(-1, 1)
    colours = [_colour(track.level) for track in message.tracks]
    labels = [f"#{track.track_id} {track.velocity_mps:+.1f} m/s" for track in message.tracks]
    speeds_mps = np.array([[track.velocity_mps] for track in message.tracks]).reshape(-1, 1)
    return [
        ("map/vehicle/radar/tracks", rr.Points3D(at_m, radii=0.1, labels=labels, colors=colours)),
        ("map/vehicle/radar/velocity", rr.Arrows3D(origins=at_m, vectors=away * speeds_mps, colors=colours)),
    ]


def _laser_scan(key: str, message: m.LaserScan) -> Entries:
    seen = np.asarray(message.ranges_m) > 0
    angles_rad, ranges_m = np.asarray(message.angles_rad)[seen], np.asarray(message.ranges_m)[seen]
    points = np.column_stack([ranges_m * np.cos(angles_rad), ranges_m * np.sin(angles_rad), np.zeros_like(ranges_m)])
    return [("map/vehicle/lidar/scan", rr.Points3D(points, radii=0.02))]


def _zones(key: str, message: m.LidarZones) -> Entries:
    """Distances to plot; a free lane has none."""
    lanes = {"left": message.left, "centre": message.centre, "right": message.right}
    nearest = [(f"lidar/nearest_m/{lane}", zone.nearest_m) for lane, zone in lanes.items()]
    level = ("lidar/level", rr.Scalars(m.LEVELS.index(message.level)))
    return [level, *((path, rr.Scalars(metres)) for path, metres in nearest if metres is not None)]


def _point_cloud(key: str, message: m.PointCloud) -> Entries:
    grey = np.repeat(np.maximum(np.asarray(message.intensity), 60)[:, None], 3, axis=1)
    return [("map/cloud", rr.Points3D(np.asarray(message.points), colors=grey, radii=0.03))]


def _image(key: str, message: m.CompressedImage) -> Entries:
    """The picture as the camera service draws it: with boxes and distances."""
    return [("camera/image", rr.EncodedImage(contents=message.data, media_type=f"image/{message.format}"))]


def _detections(key: str, message: m.CameraDetections) -> Entries:
    """The boxes with their numbers, in pixels of the camera's own picture."""
    boxes = [detection.box_xyxy_px for detection in message.detections]
    labels = [f"{one.label} {one.distance_m:.1f} m" for one in message.detections]
    colours = [_colour(one.level) for one in message.detections]
    drawn = rr.Boxes2D(
        array=np.asarray(boxes, np.float32).reshape(-1, 4), array_format=rr.Box2DFormat.XYXY,
        labels=labels, colors=colours,
    )  # fmt: skip
    return [("camera/detections", drawn), ("camera/brightness", rr.Scalars(message.brightness))]


def _ego(key: str, message: m.EgoMotion) -> Entries:
    if message.T_map_vehicle is None:
        return []
    T = np.asarray(message.T_map_vehicle)
    return [("map/vehicle", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))]


_CONVERTERS: dict[type[m.Message], Callable[[str, Any], Entries]] = {
    m.Verdict: _verdict,
    m.SystemHealth: _health,
    m.ServiceStatus: _status,
    m.ObjectTracks: _object_tracks,
    m.RadarTracks: _radar_tracks,
    m.LaserScan: _laser_scan,
    m.LidarZones: _zones,
    m.PointCloud: _point_cloud,
    m.CompressedImage: _image,
    m.CameraDetections: _detections,
    m.EgoMotion: _ego,
}


def _rows(vectors: list[tuple[float, ...]]) -> np.ndarray:
    """(N, 3) float32, also of none."""
    return np.asarray(vectors, np.float32).reshape(-1, 3)


def _colour(name: str) -> tuple[int, int, int]:
    r, g, b = COLOURS[name]
    return round(255 * r), round(255 * g), round(255 * b)
