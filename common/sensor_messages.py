"""The messages of the sensors: radar, 2-D lidar, camera, roadside lidar, raw bytes and the motion of the vehicle."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from common.message_types import (
    MAX_OBJECTS,
    Count,
    Cover,
    Finite,
    Fraction,
    Level,
    Matrix4,
    Matrix6,
    Message,
    Motion,
    Name,
    NotNegative,
    SensorMessage,
    Text,
    Vector3,
    check_shape,
)

# --- radar ------------------------------------------------------------------------------------------------------


class RadarTrack(msgspec.Struct, kw_only=True):
    """Something that is followed in the radar frame, with its own alarm level."""

    track_id: Count
    range_m: NotNegative
    azimuth_rad: Finite | None
    velocity_mps: Finite  # closing is negative
    age_frames: Count
    approaching: bool  # the approach gate has passed
    moving: bool
    ttc_s: NotNegative | None  # while driving: to contact with the vehicle's outline on its way
    level: Level
    snr_db: Finite
    coasting: bool = False  # no detection in this frame
    approached_s_ago: NotNegative | None = None  # since it last closed in; None = never
    on_way: bool | None = None  # it meets the vehicle's way ahead; None = that does not decide now
    beside_m: tuple[NotNegative, NotNegative] | None = None  # standing: so far off the line of travel at least, at most


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
    motion: Motion | None = None  # by which the tracks were judged; None = unknown: relative closing counts
    cover: Cover | None = None


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


# --- 2-D lidar --------------------------------------------------------------------------------------------------


class LaserScan(SensorMessage, kw_only=True):
    """One full revolution, counter-clockwise angles in the vehicle's frame of mounting; range 0 = no return."""

    angles_rad: np.ndarray  # (N,) float32
    ranges_m: np.ndarray  # (N,) float32
    confidence: np.ndarray  # (N,) uint8
    used: np.ndarray | None = None  # (N,) uint8: 1 kept, 0 rejected by the filters
    motion: Motion | None = None  # of the vehicle during the revolution; None = unknown

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
    curvature_per_m: Finite = 0.0  # of the way that the lanes follow, left positive; 0 = straight


class LidarZones(SensorMessage, kw_only=True):
    """What stands in the three lanes ahead, after persistence."""

    left: LidarZone
    centre: LidarZone
    right: LidarZone
    level: Level
    raw_level: Level  # before persistence
    scan_hz: NotNegative = 0.0
    layout: LaneLayout | None = None
    motion: Motion | None = None  # by which the lanes were bent; None = unknown: straight ahead
    cover: Cover | None = None


# --- camera -----------------------------------------------------------------------------------------------------


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
    seen_before: bool = True  # in a picture just before as well; while the vehicle drives no other box counts


class CameraDetections(SensorMessage, kw_only=True):
    """Objects in one picture; ``level`` is None when nothing is in the forward zone.

    Nothing seen means nothing where ``strips_see`` is False: equally wide upright strips, from left to right.
    """

    detections: Annotated[list[CameraDetection], Meta(max_length=MAX_OBJECTS)]
    brightness: Finite  # mean, 0..255
    level: Level | None
    image_size_px: tuple[Count, Count]  # width, height
    provider: Name = ""  # what the network runs on
    motion: Motion | None = None  # by which the forward zone was bent; None = unknown: the middle of the picture
    cover: Cover | None = None
    strips_see: tuple[bool, ...] = ()  # empty = not judged


class CompressedImage(SensorMessage, kw_only=True):
    """A JPEG picture with the boxes drawn in."""

    format: Literal["jpeg", "png"]
    data: Annotated[bytes, Meta(max_length=8_000_000)]
    # What is written at the boxes, the nearest first.
    captions: Annotated[list[Text], Meta(max_length=MAX_OBJECTS)] = msgspec.field(default_factory=list)


# --- roadside lidar ---------------------------------------------------------------------------------------------

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


# --- any sensor -------------------------------------------------------------------------------------------------


class RawBytes(Message, kw_only=True):
    """What a device sent, before it was interpreted: for recordings that are to be processed again."""

    kind: Name  # "ld06", "bgt60", "bgr8", "velodyne", "ouster", "hesai", "robosense", "points"
    index: Count  # counts all pieces since the source was opened, published or not, from 0
    epoch: Count = 0  # another number than before: the device was opened anew
    data: np.ndarray  # as it came; (N,) uint8 of a byte stream, the device's own shape and type of a frame
    about: dict[Name, object] = msgspec.field(default_factory=dict)  # what a reader has to know beside the bytes


# --- vehicle ----------------------------------------------------------------------------------------------------


class EgoMotion(SensorMessage, kw_only=True):
    """How the vehicle moves, and how well that is known; None = unknown.

    ``speed_mps`` is forward along x, negative in reverse; ``steering_rad`` is the angle of the front wheels, left
    positive. An origin names the device that measured: "encoder", "serial", "vesc", "can", "imu",
    "odometry" (of ROS 2), "radar", "simulated".
    """

    speed_mps: Finite | None
    yaw_rate_radps: Finite | None
    T_map_vehicle: Matrix4 | None = None
    speed_sigma_mps: NotNegative | None = None  # standard deviation
    yaw_rate_sigma_radps: NotNegative | None = None
    steering_rad: Finite | None = None
    battery_v: NotNegative | None = None
    speed_origin: Name = ""
    yaw_rate_origin: Name = ""
