"""Roadside tracks as the content of a Collective Perception Message, ETSI TS 103 324 V2.1.1. Pure.

The reference position is the map's origin; objects lie relative to it, x to the east, y to the north, z up. Units and
ranges: TS 102 894-2 V2.1.1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from common.geodesy import MapOrigin
from common.messages import ObjectTrack, ObjectTracks

Json = dict[str, Any]

PROTOCOL_VERSION, CPM = 2, 14
RSU, SENSORS, OBJECTS = 2, 3, 5  # containers
LIDAR, SENSOR_ID = 2, 1
MAX_OBJECTS = 24  # of a message: about 900 bytes, which fit a frame of ITS-G5 with its security envelope
MAX_SEGMENTS = 8
EPOCH_UTC_MS = 1_072_915_200_000  # 1 January 2004
_LEAP_SECONDS_UTC_MS = (1_136_073_600_000, 1_230_768_000_000, 1_341_100_800_000, 1_435_708_800_000, 1_483_228_800_000)
_95_PERCENT = 1.96  # standard deviations
_UNAVAILABLE_ELLIPSE = {"semiMajorConfidence": 4095, "semiMinorConfidence": 4095, "semiMajorOrientation": 3601}
_CLASSES: dict[str, tuple[str, Any]] = {
    "car": ("vehicleSubClass", 5),
    "large_vehicle": ("vehicleSubClass", 0),  # a bus or a truck: the size says more than a guess
    "pedestrian": ("vruSubClass", ("pedestrian", "unavailable")),
    "cyclist": ("vruSubClass", ("bicyclistAndLightVruVehicle", "bicyclist")),
}
_UNKNOWN = ("otherSubClass", 0)


def its_time_ms(stamp_ns: int) -> int:
    """TimestampIts: milliseconds since 2004 that really passed, leap seconds included."""
    utc_ms = stamp_ns // 1_000_000
    return utc_ms - EPOCH_UTC_MS + 1000 * sum(utc_ms >= second for second in _LEAP_SECONDS_UTC_MS)


def messages_of(message: ObjectTracks, origin: MapOrigin, station_id: int, with_sensors: bool = True) -> Iterator[Json]:
    """The messages of one revolution: one, or segments of it where there are more than ``MAX_OBJECTS`` tracks.

    Tentative tracks are left out. Of more than all segments hold, the ones of the lowest score are left out.

    with_sensors: with the container that tells of the lidar, which the standard wants once a second.
    """
    tracks = sorted((one for one in message.tracks if one.state != "tentative"), key=lambda one: -one.score)
    tracks = tracks[: MAX_OBJECTS * MAX_SEGMENTS]
    parts = [tracks[first : first + MAX_OBJECTS] for first in range(0, len(tracks), MAX_OBJECTS)] or [[]]
    for number, part in enumerate(parts, start=1):
        management = _management(message.stamp_ns, origin)
        if len(parts) > 1:
            management["segmentationInfo"] = {"totalMsgNo": len(parts), "thisMsgNo": number}
        containers: dict[int, Any] = {RSU: {}}
        if with_sensors:
            containers[SENSORS] = [{"sensorId": SENSOR_ID, "sensorType": LIDAR, "shadowingApplies": True}]
        objects = [_object(track, origin) for track in part]
        containers[OBJECTS] = {"numberOfPerceivedObjects": len(objects), "perceivedObjects": objects}
        header = {"protocolVersion": PROTOCOL_VERSION, "messageId": CPM, "stationId": station_id}
        yield {"header": header, "managementContainer": management, "containers": containers}


def _management(stamp_ns: int, origin: MapOrigin) -> Json:
    return {
        "referenceTime": its_time_ms(stamp_ns),
        "referencePosition": {
            "latitude": round(origin.latitude_deg * 1e7),
            "longitude": round(origin.longitude_deg * 1e7),
            "positionConfidenceEllipse": _UNAVAILABLE_ELLIPSE,
            "altitude": {"altitudeValue": round(origin.altitude_m * 100), "altitudeConfidence": 15},
        },
    }


def _object(track: ObjectTrack, origin: MapOrigin) -> Json:
    """One track; its covariance is turned with it, from the map to east and north."""
    turn = math.radians(90.0 - origin.heading_deg)  # of the map's x axis, counter-clockwise from east
    east, north = _turned(track.position_m[0], track.position_m[1], turn)
    ve, vn = _turned(track.velocity_mps[0], track.velocity_mps[1], turn)
    sigma, up = _sigmas(track, turn), track.covariance
    kind, confidence = _CLASSES.get(track.label, _UNKNOWN), min(max(round(100 * track.label_confidence), 1), 100)
    return {
        "objectId": track.track_id % 65536,
        "measurementDeltaTime": 0,
        "position": {
            "xCoordinate": _coordinate(east, sigma[0]),
            "yCoordinate": _coordinate(north, sigma[1]),
            "zCoordinate": _coordinate(track.position_m[2], math.sqrt(max(up[2][2], 0.0))),
        },
        "velocity": ("cartesianVelocity", {"xVelocity": _speed(ve, sigma[2]), "yVelocity": _speed(vn, sigma[3])}),
        "angles": {"zAngle": {"value": round(math.degrees(track.yaw_rad + turn) * 10) % 3600, "confidence": 127}},
        "objectDimensionZ": _dimension(track.size_m[2]),
        "objectDimensionY": _dimension(track.size_m[1]),
        "objectDimensionX": _dimension(track.size_m[0]),
        "objectAge": min(round(track.age_s * 1000), 2047),
        "objectPerceptionQuality": round(15 * track.score),
        "sensorIdList": [SENSOR_ID],
        "classification": [{"objectClass": kind, "confidence": confidence}],
    }


def _turned(x: float, y: float, turn_rad: float) -> tuple[float, float]:
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    return cos * x - sin * y, sin * x + cos * y


def _sigmas(track: ObjectTrack, turn_rad: float) -> tuple[float, float, float, float]:
    """Standard deviations of position and velocity along east and north."""
    cos, sin, c = math.cos(turn_rad), math.sin(turn_rad), track.covariance
    found = []
    for first in (0, 3):
        xx, xy, yy = c[first][first], c[first][first + 1], c[first + 1][first + 1]
        both = 2 * cos * sin * xy
        found += [cos * cos * xx - both + sin * sin * yy, sin * sin * xx + both + cos * cos * yy]
    east, north, ve, vn = (math.sqrt(max(variance, 0.0)) for variance in found)
    return east, north, ve, vn


def _coordinate(value_m: float, sigma_m: float) -> Json:
    """In centimetres; 4095: worse than 40.94 m."""
    confidence = min(max(math.ceil(_95_PERCENT * sigma_m * 100), 1), 4095)
    return {"value": min(max(round(value_m * 100), -131_072), 131_071), "confidence": confidence}


def _speed(value_mps: float, sigma_mps: float) -> Json:
    """In centimetres a second; 126: worse than 1.25 m/s."""
    confidence = min(max(math.ceil(_95_PERCENT * sigma_mps * 100), 1), 126)
    return {"value": min(max(round(value_mps * 100), -16_383), 16_382), "confidence": confidence}


def _dimension(value_m: float) -> Json:
    """In decimetres; 255: larger, confidence 32: unavailable."""
    return {"value": min(max(round(value_m * 10), 1), 255), "confidence": 32}
