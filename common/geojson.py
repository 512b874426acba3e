"""Tracked road users as GeoJSON (RFC 7946): WGS84 longitude, latitude, height above the ellipsoid. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from common.geodesy import MapOrigin, compass_deg, map_to_wgs84
from common.messages import ObjectTrack, ObjectTracks

Json = dict[str, Any]
MAP_FRAME = "map"
_DEGREE_DIGITS, _METRE_DIGITS = 8, 3  # a millimetre on the ground


def collection(features: Iterable[Json], **more: object) -> Json:
    """A FeatureCollection; ``more`` are members of ours beside it."""
    return {"type": "FeatureCollection", "features": list(features), **more}


def points(key: str, message: ObjectTracks, origin: MapOrigin) -> list[Json]:
    """A Point for each track of one message; none if the tracks are not in the map frame."""
    if message.frame_id not in ("", MAP_FRAME):
        return []
    places = positions([track.position_m for track in message.tracks], origin)
    return [
        feature("Point", place, properties(key, message, track, origin))
        for place, track in zip(places, message.tracks, strict=True)
    ]


def feature(kind: str, coordinates: object, about: Json) -> Json:
    """One Feature; its id is the host's with the track's."""
    name = f"{about['host']}/{about['track_id']}"
    return {"type": "Feature", "id": name, "geometry": {"type": kind, "coordinates": coordinates}, "properties": about}


def positions(points_m: Iterable[tuple[float, float, float]], origin: MapOrigin) -> list[list[float]]:
    """[longitude, latitude, height] of each point in the map frame."""
    places = map_to_wgs84(origin, np.array(list(points_m), float).reshape(-1, 3))
    return [
        [round(longitude, _DEGREE_DIGITS), round(latitude, _DEGREE_DIGITS), round(height, _METRE_DIGITS)]
        for latitude, longitude, height in places.tolist()
    ]


def properties(key: str, message: ObjectTracks, track: ObjectTrack, origin: MapOrigin) -> Json:
    """What is known of a track now. ``course_deg`` and ``heading_deg`` are clockwise from true north.

    ``course_deg`` is the way it moves, None where it stands; ``heading_deg`` the way its box points.
    """
    x_mps, y_mps, _ = track.velocity_mps
    speed_mps = math.hypot(x_mps, y_mps)
    course_deg = compass_deg(origin, math.atan2(y_mps, x_mps)) if speed_mps > 0.0 else None
    return {
        "host": key.partition("/")[0],
        "track_id": track.track_id,
        "label": track.label,
        "label_confidence": track.label_confidence,
        "state": track.state,
        "stamp_ns": message.stamp_ns,
        "source_kind": message.source_kind,
        "speed_mps": round(speed_mps, 3),
        "course_deg": course_deg if course_deg is None else round(course_deg, 2),
        "heading_deg": round(compass_deg(origin, track.yaw_rad), 2),
        "length_m": track.size_m[0],
        "width_m": track.size_m[1],
        "height_m": track.size_m[2],
        "sigma_m": round(math.sqrt(max(track.covariance[0][0] + track.covariance[1][1], 0.0)), 3),
    }
