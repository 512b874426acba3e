"""The bodies of a random world, the vehicle among them, and what each sensor makes of a body."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from common.messages import (
    CameraDetection,
    CameraDetections,
    Level,
    LidarZone,
    LidarZones,
    RadarTrack,
    RadarTracks,
    SensorMessage,
    worst,
)

SIGHTS = (("lidar",), ("radar",), ("lidar", "radar"), ("lidar", "camera"), ("lidar", "radar", "camera"))
APART_M = 1.2  # nearer to each other two bodies are one, for sensors as coarse as these
LANE_M, SIDE_M = 0.125, 0.316
BANDS_M: dict[str, tuple[float, float]] = {"lidar": (0.8, 1.8), "radar": (0.5, 1.2), "camera": (0.5, 1.2)}
PICTURE_PX, FOCAL_PX = 640, 397.0


@dataclass(frozen=True)
class Body:
    """Stands at a place of the world from one time to another, or walks there and back along x."""

    number: int
    x_m: float
    y_m: float
    walk_m: float
    period_s: float
    from_s: float
    until_s: float
    seen_by: tuple[str, ...]
    radius_m: float = 0.15

    def place(self, now_s: float) -> tuple[float, float] | None:
        """World coordinates; None while it is not there."""
        if not self.from_s <= now_s < self.until_s:
            return None
        return self.x_m + self.walk_m * math.sin(2 * math.pi * now_s / self.period_s), self.y_m


@dataclass
class Vehicle:
    """The true motion: pieces of constant speed and turning."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    speed_mps: float = 0.0
    yaw_rate_radps: float = 0.0

    def step(self, step_s: float) -> None:
        """Drive on."""
        self.yaw_rad += self.yaw_rate_radps * step_s
        self.x_m += self.speed_mps * step_s * math.cos(self.yaw_rad)
        self.y_m += self.speed_mps * step_s * math.sin(self.yaw_rad)

    def sees_at(self, place: tuple[float, float]) -> tuple[float, float]:
        """A place of the world, ahead and to the left of the vehicle's front."""
        dx, dy = place[0] - self.x_m, place[1] - self.y_m
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return cos * dx + sin * dy, cos * dy - sin * dx


def scatter(dice: random.Random, seconds: float) -> list[Body]:
    """One to three bodies ahead, apart from each other."""
    bodies: list[Body] = []
    for number in range(dice.randint(1, 3)):
        for _ in range(20):
            close = dice.random() < 0.5  # in the middle of the way
            x, y = dice.uniform(0.2, 1.0 if close else 3.0), dice.uniform(-1.0, 1.0) * (0.1 if close else 0.4)
            if all(math.hypot(x - other.x_m, y - other.y_m) > APART_M for other in bodies):
                break
        else:
            continue
        begin_s = dice.uniform(0.0, 0.6 * seconds)
        bodies.append(
            Body(
                number, x, y, dice.choice((0.0, 0.0, 0.3)), dice.uniform(3.0, 12.0), begin_s,
                begin_s + dice.uniform(2.0, seconds), dice.choice(SIGHTS),
            )
        )  # fmt: skip
    return bodies


def level_at(sensor: str, distance_m: float) -> Level:
    """By the sensor's bands."""
    imminent_m, caution_m = BANDS_M[sensor]
    return "IMMINENT" if distance_m <= imminent_m else "CAUTION" if distance_m <= caution_m else "SAFE"


def in_reach(sensor: str, x_m: float, y_m: float) -> bool:
    """Whether the sensor would report a body there."""
    if x_m <= 0.02:
        return False
    bearing = abs(math.atan2(y_m, x_m))
    if sensor == "lidar":
        return x_m <= 3.0 and abs(y_m) <= SIDE_M and bearing <= math.radians(20.0)
    if sensor == "radar":
        return x_m <= 4.0 and bearing <= math.radians(40.0)
    return x_m <= 6.0 and bearing <= math.radians(17.0)


Seen = list[tuple[float, float]]  # ahead and left, of the bodies in the message


def message_of(sensor: str, stamp_ns: int, seen: Seen, reason: str) -> SensorMessage:
    """The sensor's real message."""
    state = {"state": "degraded", "reason": reason} if reason else {}
    build = {"lidar": _zones, "radar": _tracks, "camera": _boxes}[sensor]
    message = build(stamp_ns, seen)
    for name, value in state.items():
        setattr(message, name, value)
    return message


def _zones(stamp_ns: int, seen: Seen) -> LidarZones:
    nearest: dict[str, float] = {}
    for x, y in seen:
        lane = "centre" if abs(y) <= LANE_M else "left" if y > 0 else "right"
        nearest[lane] = min(x, nearest.get(lane, math.inf))
    zones = {
        lane: LidarZone(nearest_m=nearest.get(lane), points=5, level=level_at("lidar", nearest.get(lane, 9.0)))
        for lane in ("left", "centre", "right")
    }
    level = worst(*(zone.level for zone in zones.values()))
    left, centre, right = zones["left"], zones["centre"], zones["right"]
    return LidarZones(stamp_ns=stamp_ns, level=level, raw_level=level, left=left, centre=centre, right=right)


def _tracks(stamp_ns: int, seen: Seen) -> RadarTracks:
    tracks = [
        RadarTrack(
            track_id=number, range_m=math.hypot(x, y), azimuth_rad=math.atan2(y, x), velocity_mps=-0.5, age_frames=9,
            approaching=True, moving=True, ttc_s=None, level=level_at("radar", math.hypot(x, y)), snr_db=20.0,
        )
        for number, (x, y) in enumerate(seen)
    ]  # fmt: skip
    level = worst(*(track.level for track in tracks))
    return RadarTracks(stamp_ns=stamp_ns, tracks=tracks, level=level, settled=True, noise_floor_db=-60.0)


def _boxes(stamp_ns: int, seen: Seen) -> CameraDetections:
    boxes = []
    for x, y in seen:
        middle_px = PICTURE_PX / 2 - FOCAL_PX * y / x
        boxes.append(
            CameraDetection(
                label="person", confidence=0.8, box_xyxy_px=(middle_px - 20, 10.0, middle_px + 20, 400.0),
                distance_m=x, level=level_at("camera", x), in_zone=True, truncated=False,
            )
        )  # fmt: skip
    level = worst(*(box.level for box in boxes)) if boxes else None
    return CameraDetections(
        stamp_ns=stamp_ns, detections=boxes, brightness=90.0, level=level, image_size_px=(PICTURE_PX, 480)
    )
