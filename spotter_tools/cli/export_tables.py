"""Recorded messages as rows of a table, one row per verdict, track or zone. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from common import messages as m
from common.topics import SENSOR_TOPICS

Row = dict[str, Any]
OF_AN_INPUT = ("state", "level", "age_ms", "used")
HEADER = ("table", "key", "stamp_ns", "time_s", "seq")  # time_s: since the first message of the recording

COLUMNS: dict[str, tuple[str, ...]] = {
    "verdicts": (
        "level", "permission", "rule", "because", "confirmed", "suppressed", "advisory", "blind", "to_lower",
        "source_kind", *(f"{sensor}_{what}" for sensor in SENSOR_TOPICS for what in OF_AN_INPUT),
    ),
    "radar": (
        "track_id", "range_m", "azimuth_rad", "velocity_mps", "ttc_s", "level", "approaching", "moving", "coasting",
        "age_frames", "snr_db", "state",
    ),
    "objects": (
        "track_id", "label", "label_confidence", "x_m", "y_m", "z_m", "vx_mps", "vy_mps", "vz_mps", "speed_mps",
        "yaw_rad", "length_m", "width_m", "height_m", "track_state", "score", "age_s", "points", "state",
    ),
    "zones": ("zone", "nearest_m", "points", "level", "raw_level", "state"),
    "camera": (
        "label", "confidence", "distance_m", "distance_sigma_m", "nearest_m", "level", "in_zone", "truncated",
        "left_px", "top_px", "right_px", "bottom_px", "state",
    ),
}  # fmt: skip


def columns(tables: tuple[str, ...]) -> list[str]:
    """The header and every column of these tables once, in order."""
    return list(dict.fromkeys([*HEADER, *(name for table in tables for name in COLUMNS[table])]))


def rows(key: str, message: m.Message, first_ns: int) -> Iterator[Row]:
    """The rows of one message; none for a message that no table is made of. ``None`` is an empty cell."""
    found = _TABLES.get(type(message))
    if found is None:
        return
    table, make = found
    header = (table, key, message.stamp_ns, round((message.stamp_ns - first_ns) / 1e9, 6), message.seq)
    for values in make(message):
        yield {**dict(zip(HEADER, header, strict=True)), **values}


def _verdict(message: m.Verdict) -> Iterator[Row]:
    row = {
        name: getattr(message, name)
        for name in (
            "level", "permission", "rule", "because", "confirmed", "suppressed", "advisory", "blind", "to_lower",
            "source_kind",
        )
    }  # fmt: skip
    for sensor, used in message.inputs.items():
        if sensor in SENSOR_TOPICS:
            for name in OF_AN_INPUT:
                row[f"{sensor}_{name}"] = getattr(used, name)
    yield row


def _radar(message: m.RadarTracks) -> Iterator[Row]:
    for track in message.tracks:
        yield {
            "track_id": track.track_id,
            "range_m": track.range_m,
            "azimuth_rad": track.azimuth_rad,
            "velocity_mps": track.velocity_mps,
            "ttc_s": track.ttc_s,
            "level": track.level,
            "approaching": track.approaching,
            "moving": track.moving,
            "coasting": track.coasting,
            "age_frames": track.age_frames,
            "snr_db": track.snr_db,
            "state": message.state,
        }


def _objects(message: m.ObjectTracks) -> Iterator[Row]:
    for track in message.tracks:
        yield {
            "track_id": track.track_id,
            "label": track.label,
            "label_confidence": track.label_confidence,
            **dict(zip(("x_m", "y_m", "z_m"), track.position_m, strict=True)),
            **dict(zip(("vx_mps", "vy_mps", "vz_mps"), track.velocity_mps, strict=True)),
            "speed_mps": math.hypot(*track.velocity_mps),
            "yaw_rad": track.yaw_rad,
            **dict(zip(("length_m", "width_m", "height_m"), track.size_m, strict=True)),
            "track_state": track.state,
            "score": track.score,
            "age_s": track.age_s,
            "points": track.points,
            "state": message.state,
        }


def _zones(message: m.LidarZones) -> Iterator[Row]:
    for name in ("left", "centre", "right"):
        zone: m.LidarZone = getattr(message, name)
        yield {
            "zone": name,
            "nearest_m": zone.nearest_m,
            "points": zone.points,
            "level": zone.level,
            "raw_level": message.raw_level,
            "state": message.state,
        }


def _camera(message: m.CameraDetections) -> Iterator[Row]:
    for found in message.detections:
        yield {
            "label": found.label,
            "confidence": found.confidence,
            "distance_m": found.distance_m,
            "distance_sigma_m": found.distance_sigma_m,
            "nearest_m": found.nearest_m,
            "level": found.level,
            "in_zone": found.in_zone,
            "truncated": found.truncated,
            **dict(zip(("left_px", "top_px", "right_px", "bottom_px"), found.box_xyxy_px, strict=True)),
            "state": message.state,
        }


_TABLES: dict[type[m.Message], tuple[str, Callable[[Any], Iterator[Row]]]] = {
    m.Verdict: ("verdicts", _verdict),
    m.RadarTracks: ("radar", _radar),
    m.ObjectTracks: ("objects", _objects),
    m.LidarZones: ("zones", _zones),
    m.CameraDetections: ("camera", _camera),
}
