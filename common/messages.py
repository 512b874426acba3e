"""The messages on the wire: typed, units in the names, checked when they are built and when they arrive.

Every message begins with ``stamp_ns`` (UTC nanoseconds of the *measurement*), ``seq`` and ``frame_id``. Frames are
x forward, y left, z up; angles are radians, counter-clockwise positive; a closing velocity is negative.

A float is finite and of a sane size, a list is bounded: a payload with a NaN or a million tracks is refused by the
codec with the path of the field, before anybody computes with it.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

Level = Literal["SAFE", "CAUTION", "IMMINENT"]
LEVELS: tuple[Level, ...] = ("SAFE", "CAUTION", "IMMINENT")
SensorState = Literal["online", "degraded", "disconnected"]
SelfReport = Literal["online", "degraded"]
ServiceState = Literal["starting", "online", "degraded", "disconnected"]

Finite = Annotated[float, Meta(ge=-1e12, le=1e12)]  # NaN and infinity fail both comparisons
NotNegative = Annotated[float, Meta(ge=0.0, le=1e12)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Count = Annotated[int, Meta(ge=0)]
Text = Annotated[str, Meta(max_length=2000)]
Name = Annotated[str, Meta(max_length=100)]
Vector3 = tuple[Finite, Finite, Finite]
Matrix6 = Annotated[
    list[Annotated[list[Finite], Meta(min_length=6, max_length=6)]],
    Meta(min_length=6, max_length=6),
]
Matrix4 = Annotated[
    list[Annotated[list[Finite], Meta(min_length=4, max_length=4)]],
    Meta(min_length=4, max_length=4),
]
StageMs = dict[Name, Finite]

MAX_OBJECTS = 2000


def worst(*levels: Level) -> Level:
    """The most serious of the levels; SAFE of none."""
    return max(levels, key=LEVELS.index, default="SAFE")


def check_shape(owner: object, name: str, value: np.ndarray, *shape: int | None) -> None:
    """Raise ``ValueError`` unless ``value`` has this shape; ``None`` stands for any length."""
    fits = value.ndim == len(shape) and all(
        want is None or want == got for want, got in zip(shape, value.shape, strict=True)
    )
    if not fits:
        expected = "(" + ", ".join("N" if want is None else str(want) for want in shape) + ")"
        raise ValueError(f"{type(owner).__name__}.{name}: expected shape {expected}, got {value.shape}")


class Message(msgspec.Struct, kw_only=True):
    """The header of every message. ``seq`` and ``sent_ns`` are filled in by the publisher."""

    stamp_ns: Count  # UTC ns of the measurement, read where the device is read
    seq: Count = 0  # counts this topic's messages since the process started
    frame_id: Name = ""
    received_ns: Count = 0  # UTC ns when the measurement was complete in the service (0 = not told)
    sent_ns: Count = 0  # UTC ns when the message was handed to the network


class SensorMessage(Message, kw_only=True):
    """A sensor's data together with the sensor's own word on whether it can see."""

    state: SelfReport = "online"
    reason: Text = ""  # why it is degraded; for a person
    stage_ms: StageMs = {}


# --- radar ----------------------------------------------------------------------------------------------------


class RadarTrack(msgspec.Struct, kw_only=True):
    """Something that is followed in the radar frame, with its own alarm level."""

    track_id: Count
    range_m: NotNegative
    azimuth_rad: Finite | None
    velocity_mps: Finite  # closing is negative
    age_frames: Count
    approaching: bool  # the approach gate has passed
    moving: bool
    ttc_s: NotNegative | None
    level: Level
    snr_db: Finite
    coasting: bool = False  # no detection in this frame
    approached_s_ago: NotNegative | None = None  # since it last closed in; None = never


class RadarTracks(SensorMessage, kw_only=True):
    """Confirmed radar tracks in the radar frame, an empty list when nothing moves."""

    tracks: Annotated[list[RadarTrack], Meta(max_length=MAX_OBJECTS)]
    level: Level
    settled: bool  # the clutter background has settled; before that SAFE means nothing
    noise_floor_db: Finite
    static_level: Level | None = None  # what standing tracks would say: fusion's fallback only
    v_max_mps: NotNegative = 0.0  # unambiguous speed of the configuration
    range_min_m: NotNegative = 0.0
    range_max_m: NotNegative = 0.0


class RadarDetection(msgspec.Struct, kw_only=True):
    """A cell of the range-Doppler map that stands out of its surroundings; closing is negative."""

    range_m: NotNegative
    azimuth_rad: Finite | None
    velocity_mps: Finite
    snr_db: Finite


class RadarDetections(SensorMessage, kw_only=True):
    """CFAR detections of one frame and the range-Doppler map they were found in."""

    detections: Annotated[list[RadarDetection], Meta(max_length=MAX_OBJECTS)]
    range_doppler_db: np.ndarray  # (R, D) float32, range rows from 0, Doppler columns rising
    range_axis_m: np.ndarray  # (R,)
    velocity_axis_mps: np.ndarray  # (D,)

    def __post_init__(self) -> None:
        check_shape(self, "range_axis_m", self.range_axis_m, None)
        check_shape(self, "velocity_axis_mps", self.velocity_axis_mps, None)
        rows, columns = len(self.range_axis_m), len(self.velocity_axis_mps)
        check_shape(self, "range_doppler_db", self.range_doppler_db, rows, columns)


# --- 2-D lidar ------------------------------------------------------------------------------------------------


class LaserScan(SensorMessage, kw_only=True):
    """One full revolution, counter-clockwise angles in the vehicle's frame of mounting; range 0 = no return."""

    angles_rad: np.ndarray  # (N,) float32
    ranges_m: np.ndarray  # (N,) float32
    confidence: np.ndarray  # (N,) uint8
    used: np.ndarray | None = None  # (N,) uint8: 1 kept, 0 rejected by the filters

    def __post_init__(self) -> None:
        check_shape(self, "angles_rad", self.angles_rad, None)
        check_shape(self, "ranges_m", self.ranges_m, len(self.angles_rad))
        check_shape(self, "confidence", self.confidence, len(self.angles_rad))
        if self.used is not None:
            check_shape(self, "used", self.used, len(self.angles_rad))


class LidarZone(msgspec.Struct, kw_only=True):
    """The nearest return in one lane, None = none, and how many there are."""

    nearest_m: NotNegative | None
    points: Count
    level: Level


class LaneLayout(msgspec.Struct, kw_only=True):
    """The lanes and alarm lines in use, so that a viewer draws what the service checks."""

    centre_width_m: NotNegative
    side_width_m: NotNegative
    look_ahead_m: NotNegative
    imminent_m: NotNegative
    caution_m: NotNegative


class LidarZones(SensorMessage, kw_only=True):
    """What stands in the three lanes ahead, after persistence."""

    left: LidarZone
    centre: LidarZone
    right: LidarZone
    level: Level
    raw_level: Level  # before persistence
    scan_hz: NotNegative = 0.0
    layout: LaneLayout | None = None


# --- camera ---------------------------------------------------------------------------------------------------


class CameraDetection(msgspec.Struct, kw_only=True):
    """An object in one picture; its distance follows from the height of its box."""

    label: Name
    confidence: Fraction
    box_xyxy_px: tuple[Finite, Finite, Finite, Finite]
    distance_m: NotNegative
    level: Level
    in_zone: bool
    truncated: bool  # the box touches the picture's edge: the distance is "at most"
    distance_sigma_m: NotNegative = 0.0
    nearest_m: NotNegative | None = None  # to the object's nearest side: what the level is judged by


class CameraDetections(SensorMessage, kw_only=True):
    """Objects in one picture; ``level`` is None when nothing is in the forward zone."""

    detections: Annotated[list[CameraDetection], Meta(max_length=MAX_OBJECTS)]
    brightness: Finite  # mean, 0..255
    level: Level | None
    image_size_px: tuple[Count, Count]  # width, height
    provider: Name = ""  # what the network runs on


class CompressedImage(SensorMessage, kw_only=True):
    """A JPEG picture with the boxes drawn in."""

    format: Literal["jpeg", "png"]
    data: Annotated[bytes, Meta(max_length=8_000_000)]


# --- roadside lidar -------------------------------------------------------------------------------------------

ObjectLabel = Literal["car", "large_vehicle", "cyclist", "pedestrian", "background", "unknown"]


class ObjectTrack(msgspec.Struct, kw_only=True, gc=False):
    """A road user that is followed: box, motion and class in the map frame. Its id is kept for life."""

    track_id: Count
    label: ObjectLabel
    label_confidence: Fraction
    position_m: Vector3  # centre of the box, map frame
    velocity_mps: Vector3
    covariance: Matrix6  # of position and velocity
    size_m: Vector3  # length, width, height
    yaw_rad: Finite
    age_s: NotNegative
    score: Fraction
    state: Literal["tentative", "confirmed", "coasting"]
    points: Count


class ObjectTracks(SensorMessage, kw_only=True):
    """Tracked road users in the map frame."""

    tracks: Annotated[list[ObjectTrack], Meta(max_length=MAX_OBJECTS)]
    points_in: Count = 0
    clusters: Count = 0


class Cluster(msgspec.Struct, kw_only=True):
    """What stands together in one frame, and what it is taken for; yaw along its longer side, map frame."""

    label: ObjectLabel
    confidence: Fraction
    centre_m: Vector3
    size_m: Vector3
    yaw_rad: Finite
    points: Count


class Clusters(SensorMessage, kw_only=True):
    """Everything in one frame that is neither road nor learned background."""

    clusters: Annotated[list[Cluster], Meta(max_length=5000)]


class PointCloud(SensorMessage, kw_only=True):
    """A decimated cloud for viewers, in the map frame."""

    points: np.ndarray  # (N, 3) float32 metres
    intensity: np.ndarray  # (N,) uint8
    kind: np.ndarray  # (N,) uint8: 0 other, 1 ground, 2 in a cluster, 3 learned background

    def __post_init__(self) -> None:
        check_shape(self, "points", self.points, None, 3)
        check_shape(self, "intensity", self.intensity, len(self.points))
        check_shape(self, "kind", self.kind, len(self.points))


# --- any sensor -----------------------------------------------------------------------------------------------


class RawBytes(Message, kw_only=True):
    """What a device sent, before it was interpreted: for recordings that are to be processed again."""

    kind: Name  # "ld06", "bgt60", "bgr8", "velodyne", "ouster", "points"
    index: Count  # counts all pieces since the source was opened, heard or not: 0 is the very first
    epoch: Count = 0  # another number than before: the device was opened anew
    data: np.ndarray  # as it came; (N,) uint8 of a byte stream, the device's own shape and type of a frame
    about: dict[Name, object] = {}  # what a reader has to know beside the bytes


# --- vehicle --------------------------------------------------------------------------------------------------


class EgoMotion(Message, kw_only=True):
    """How the vehicle moves; None = unknown."""

    speed_mps: Finite | None
    yaw_rate_radps: Finite | None
    T_map_vehicle: Matrix4 | None = None


# --- fusion ---------------------------------------------------------------------------------------------------


class VerdictInput(msgspec.Struct, kw_only=True):
    """What one sensor contributed, and why it did or did not count."""

    state: SensorState
    level: Level | None
    age_ms: Finite | None  # None = never seen
    used: bool
    why: Text
    stage_ms: StageMs = {}  # capture, processing, transport, fusion
    stamp_ns: Count = 0  # of the measurement that was used; 0 = none


class Verdict(Message, kw_only=True):
    """What fusion says: how dangerous it is, by which rule, and from what. SAFE is never said for want of data."""

    level: Level
    rule: Name  # id of the rule that decided
    because: Text  # a sentence for a person
    inputs: dict[Name, VerdictInput]
    confirmed: bool
    suppressed: bool
    advisory: Name | None
    blind: bool
    permission: Literal["GO", "SLOW", "STOP"]
    to_lower: Text = ""  # what would have to change for the level to drop
    deciding: dict[str, object] | None = None  # the object or zone behind it, in its message's own fields


class FusionTrace(Message, kw_only=True):
    """Everything one verdict was decided from, so that anybody can decide it again."""

    verdict_seq: Count
    inputs: dict[Name, object]  # services.jetson.fusion.evidence.FusionInputs
    memory: dict[Name, object]  # FusionMemory before the verdict
    rules: dict[Name, object]  # RulesConfig in force


class SensorHealth(msgspec.Struct, kw_only=True):
    """Whether fusion can rely on a sensor, since when, and why not."""

    state: SensorState
    reason: Text
    since_ns: Count
    age_ms: Finite | None
    rate_hz: NotNegative
    # host_unreachable | service_gone | device_lost | stale | impaired | clock | waiting | recovering | isolated |
    # two_claimants; empty when online
    cause: Name = ""


class ServiceHealth(msgspec.Struct, kw_only=True):
    """Whether a process is there, by its liveliness tokens, and what it says of itself."""

    alive: bool
    instances: Count
    state: ServiceState
    reason: Text
    since_ns: Count


class ClockHealth(msgspec.Struct, kw_only=True):
    """Offset of another host's clock from ours: their time minus our time, true within ``bound_ms``."""

    offset_ms: Finite
    bound_ms: NotNegative
    age_s: NotNegative
    trusted: bool


class SystemHealth(Message, kw_only=True):
    """The health of everything that one host's fusion depends on."""

    sensors: dict[Name, SensorHealth]
    colour: Literal["green", "amber", "red"]
    summary: Text  # the health bar's text
    services: dict[Name, ServiceHealth]  # by "<host>/<service>"
    clocks: dict[Name, ClockHealth] = {}  # by "<host>/<service>"
    notes: list[Text] = []  # what else a person should know: isolation, start-up, latency budget


# --- every service --------------------------------------------------------------------------------------------


class ServiceStatus(Message, kw_only=True):
    """What a service says of itself every second: its state, and what it counted since it began."""

    state: ServiceState
    reason: Text
    published: Count
    dropped: Count
    bad_input: Count
    rate_hz: NotNegative
    last_frame_age_s: NotNegative | None
    stage_ms: StageMs
    rss_mb: NotNegative
    instance: Name = ""
    cpu_s: NotNegative = 0.0
    counters: dict[Name, Count] = {}  # what was rejected and why, by name


class ServiceInfo(Message, kw_only=True):
    """Who a service is: asked for, not sent."""

    service: Name
    host: Name
    instance: Name
    version: Name
    config_hash: Name
    topics: list[Name]
    started_ns: Count
    pid: Count
    source: Text = ""
    config: dict[Name, object] = {}  # the effective configuration, without secrets


class ClockReply(Message, kw_only=True):
    """NTP-style echo: ``stamp_ns`` is the asker's own time stamp, given back."""

    request_received_ns: Count
    reply_sent_ns: Count
