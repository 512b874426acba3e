"""Detections and tracks to vision_msgs. Pure."""

from __future__ import annotations

from typing import Any

import numpy as np

from common import messages as m
from common.ros2.types import build, header
from spotter_tools.ros2.geometry import MAP, pose, vector

DETECTIONS_2D, DETECTIONS_3D = "vision_msgs/msg/Detection2DArray", "vision_msgs/msg/Detection3DArray"


def detections_2d(message: m.CameraDetections, host: str) -> Any:
    """Boxes in pixels; the distance along the optical axis is z of the hypothesis' pose, with its variance."""
    head = header(message.stamp_ns, "camera")
    found = [_detection_2d(one, head) for one in message.detections]
    return build(DETECTIONS_2D, header=head, detections=found)


def _detection_2d(one: m.CameraDetection, head: Any) -> Any:
    left, top, right, bottom = one.box_xyxy_px
    centre = build("vision_msgs/msg/Point2D", x=(left + right) / 2, y=(top + bottom) / 2)
    covariance = np.zeros(36)
    covariance[14] = one.distance_sigma_m**2  # of z
    where = build("geometry_msgs/msg/PoseWithCovariance", covariance=covariance)
    where.pose.position.z, where.pose.orientation.w = float(one.distance_m), 1.0
    box = build("vision_msgs/msg/BoundingBox2D", center=build("vision_msgs/msg/Pose2D", position=centre),
                size_x=right - left, size_y=bottom - top)  # fmt: skip
    return build(
        "vision_msgs/msg/Detection2D", header=head, results=[_hypothesis(one.label, one.confidence, where)], bbox=box
    )


def detections_3d(message: m.ObjectTracks, host: str) -> Any:
    """Every track as a box in the map frame; ``id`` is the track's, kept for life."""
    head = header(message.stamp_ns, message.frame_id or MAP)
    return build(DETECTIONS_3D, header=head, detections=[_detection_3d(track, head) for track in message.tracks])


def _detection_3d(track: m.ObjectTrack, head: Any) -> Any:
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.reshape(track.covariance, (6, 6))[:3, :3]
    centre = pose(track.position_m, track.yaw_rad)
    where = build("geometry_msgs/msg/PoseWithCovariance", pose=centre, covariance=covariance.ravel())
    box = build("vision_msgs/msg/BoundingBox3D", center=centre, size=vector(track.size_m))
    results = [_hypothesis(track.label, track.label_confidence, where)]
    return build("vision_msgs/msg/Detection3D", header=head, results=results, bbox=box, id=str(track.track_id))


def _hypothesis(label: str, score: float, where: Any) -> Any:
    what = build("vision_msgs/msg/ObjectHypothesis", class_id=label, score=float(score))
    return build("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=what, pose=where)
