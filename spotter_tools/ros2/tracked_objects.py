"""ObjectTracks to autoware_perception_msgs/TrackedObjects. Pure."""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np

from common import messages as m
from common.ros2.types import build, header
from spotter_tools.ros2.geometry import MAP, FrameError, pose, vector

TRACKED_OBJECTS = "autoware_perception_msgs/msg/TrackedObjects"
# autoware_perception_msgs/ObjectClassification; a large vehicle is a lorry or a bus; which one is unknown.
LABELS = {"car": 1, "large_vehicle": 2, "cyclist": 6, "pedestrian": 7, "unknown": 0, "background": 0}
SIGN_UNKNOWN, AVAILABLE = 1, 2  # of an orientation
BOUNDING_BOX = 0
HEADING_MPS = 1.0  # from this speed on the way it moves tells front from back
STANDS_MPS = 0.3


def tracked_objects(message: m.ObjectTracks, host: str) -> Any:
    """Every track, in the message's frame. Its id is the same for life, and another one on another host."""
    objects = [_object(track, host) for track in message.tracks]
    return build(TRACKED_OBJECTS, header=header(message.stamp_ns, message.frame_id or MAP), objects=objects)


def tracked_objects_on_map(message: m.ObjectTracks, host: str) -> Any:
    """The same for a consumer that knows the map only.

    Raises:
        FrameError: the tracks are in another frame.
    """
    if message.frame_id not in ("", MAP):
        raise FrameError(f"tracks in the frame {message.frame_id}, not {MAP}")
    return tracked_objects(message, host)


def _object(track: m.ObjectTrack, host: str) -> Any:
    identity = hashlib.sha256(f"{host}/{track.track_id}".encode()).digest()[:16]
    label = build(
        "autoware_perception_msgs/msg/ObjectClassification", label=LABELS[track.label],
        probability=float(track.label_confidence),
    )  # fmt: skip
    return build(
        "autoware_perception_msgs/msg/TrackedObject",
        object_id=build("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(identity, np.uint8)),
        existence_probability=float(track.score),
        classification=[label],
        kinematics=_kinematics(track),
        shape=build("autoware_perception_msgs/msg/Shape", type=BOUNDING_BOX, dimensions=vector(track.size_m)),
    )


def _kinematics(track: m.ObjectTrack) -> Any:
    """The twist is in the object's own frame (x ahead), so the velocity is turned back by its yaw."""
    vx, vy, vz = track.velocity_mps
    speed_mps, yaw_rad, known = math.hypot(vx, vy), track.yaw_rad, SIGN_UNKNOWN
    if speed_mps >= HEADING_MPS:
        known = AVAILABLE
        if vx * math.cos(yaw_rad) + vy * math.sin(yaw_rad) < 0.0:
            yaw_rad += math.pi
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # map to object
    full = np.reshape(track.covariance, (6, 6))
    of_pose, of_twist = np.zeros((6, 6)), np.zeros((6, 6))
    of_pose[:3, :3], of_twist[:3, :3] = full[:3, :3], turned @ full[3:, 3:] @ turned.T
    twist = build("geometry_msgs/msg/Twist", linear=vector(turned @ np.array([vx, vy, vz])))
    return build(
        "autoware_perception_msgs/msg/TrackedObjectKinematics",
        pose_with_covariance=build(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose(track.position_m, yaw_rad), covariance=of_pose.ravel()
        ),
        twist_with_covariance=build("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=of_twist.ravel()),
        orientation_availability=known,
        is_stationary=speed_mps < STANDS_MPS,
    )
