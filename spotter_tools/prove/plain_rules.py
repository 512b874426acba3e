"""The article's rules, as plain as they stand in it: what the new rules are measured against.

No way ahead, no coverage, no memory: the nearest return in the lidar's lanes, radar tracks that approach by time to
collision and range, the camera's box in the middle of the picture. The worst of lidar and radar counts; the camera
confirms, or stands in for a lidar that is out; with two of three out it is at least CAUTION.
"""

from __future__ import annotations

import math

from common.bus.pubsub import Received
from common.messages import LEVELS, CameraDetections, LidarZones, Message, RadarTracks, Verdict
from services.jetson.fusion.verdict import PERMISSION

LIDAR_M, NEAR_M, TTC_S = (0.8, 1.8), (0.5, 1.2), (1.5, 3.0)  # IMMINENT, CAUTION
MIDDLE = 0.4  # of the picture's width
STALE_S = 0.5


class PlainRules:
    """The newest message of each sensor, and a level from them."""

    def __init__(self) -> None:
        self._newest: dict[type, tuple[float, Message]] = {}

    def take(self, received: Received[Message]) -> None:
        """Keep it."""
        self._newest[type(received.message)] = (received.arrived_s, received.message)

    def decide(self, now_s: float, now_ns: int) -> Verdict:
        """The verdict of this moment."""
        lidar, radar, camera = (self._of(kind, now_s) for kind in (LidarZones, RadarTracks, CameraDetections))
        level = max(0 if lidar is None else lidar_level(lidar), 0 if radar is None else radar_level(radar))
        seen = None if camera is None else camera_level(camera)
        if seen is not None and (lidar is None or level > 0):
            level = max(level, seen, 1 if lidar is None else 0)
        if sum(one is None for one in (lidar, radar, camera)) >= 2:
            level = max(level, 1)
        return _verdict(now_ns, level)

    def _of(self, kind: type, now_s: float) -> Message | None:
        """The newest of that kind while it is fresh and its sensor sees."""
        arrived_s, message = self._newest.get(kind, (-math.inf, None))
        fresh = message is not None and now_s - arrived_s <= STALE_S
        return message if fresh and getattr(message, "state", "") == "online" else None


def lidar_level(message: Message) -> int:
    """By the nearest return in any of the three lanes."""
    assert isinstance(message, LidarZones)
    lanes = (message.left, message.centre, message.right)
    return _band(min((lane.nearest_m for lane in lanes if lane.nearest_m is not None), default=math.inf), LIDAR_M)


def radar_level(message: Message) -> int:
    """By the worst track that approaches."""
    assert isinstance(message, RadarTracks)
    level = 0
    for track in message.tracks:
        if track.approaching:
            ttc_s = track.range_m / -track.velocity_mps if track.velocity_mps < 0.0 else math.inf
            level = max(level, _band(ttc_s, TTC_S), _band(track.range_m, NEAR_M))
    return level


def camera_level(message: Message) -> int | None:
    """By the nearest box in the middle of the picture; None = there is none."""
    assert isinstance(message, CameraDetections)
    width = message.image_size_px[0]
    ahead = [
        one.distance_m if one.nearest_m is None else one.nearest_m
        for one in message.detections
        if one.box_xyxy_px[2] > 0.5 * (1 - MIDDLE) * width and one.box_xyxy_px[0] < 0.5 * (1 + MIDDLE) * width
    ]
    return _band(min(ahead), NEAR_M) if ahead else None


def _band(value: float, limits: tuple[float, float]) -> int:
    return 2 if value <= limits[0] else 1 if value <= limits[1] else 0


def _verdict(now_ns: int, number: int) -> Verdict:
    level = LEVELS[number]
    return Verdict(
        stamp_ns=now_ns, frame_id="vehicle", level=level, rule="article", because=f"the article's rules say {level}",
        inputs={}, confirmed=False, suppressed=False, advisory=None, blind=False, permission=PERMISSION[level],
        source_kind="simulated",
    )  # fmt: skip
