"""Which topic of ours becomes which topic of ROS 2, of which type and quality of service."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from common import topics
from common.ros2.keys import SENSOR_DATA, Qos
from common.topics import Topic
from spotter_tools.ros2 import clouds, detections, markers, scans, tracked_objects, transforms, verdicts

OBJECTS_OF_AUTOWARE = "/perception/object_recognition/tracking/objects"
TF, TF_STATIC, DIAGNOSTICS = "/tf", "/tf_static", "/diagnostics"
DEFAULT = Qos()
LATCHED = Qos(transient_local=True, depth=1)


@dataclass(frozen=True)
class Row:
    """``last``: behind ``/spotter/<host>/<service>/``, or a whole name with its slash.

    says_itself: the message has a word on where its data come from, so that it stands under the same name always.
    """

    topic: Topic
    last: str
    type: str
    map: Callable[[Any, str], Any]
    qos: Qos = DEFAULT
    says_itself: bool = False

    def name(self, host: str, kind: str) -> str:
        """The ROS topic. What is not measured now stands below a name of its own: ``/spotter_simulated/...``.

        A host whose name begins with a digit, as no name of ROS may, gets a ``_`` before it.
        """
        root = "/spotter" if kind == "live" or self.says_itself else f"/spotter_{kind}"
        if self.last.startswith("/"):
            return self.last if root == "/spotter" else root + self.last
        return f"{root}/{'_' * host[0].isdigit()}{host}/{self.topic.service}/{self.last}"


ROWS = (
    Row(topics.LIDAR_SCAN, "scan", scans.LASER_SCAN, scans.laser_scan, SENSOR_DATA),
    Row(topics.CAMERA_DETECTIONS, "detections", detections.DETECTIONS_2D, detections.detections_2d),
    Row(topics.CAMERA_IMAGE, "image/compressed", clouds.COMPRESSED_IMAGE, clouds.picture, SENSOR_DATA),
    Row(topics.RADAR_TRACKS, "markers", markers.MARKERS, markers.radar_markers),
    Row(topics.INFRA_TRACKS, "detections", detections.DETECTIONS_3D, detections.detections_3d),
    Row(topics.INFRA_TRACKS, "objects", tracked_objects.TRACKED_OBJECTS, tracked_objects.tracked_objects),
    Row(topics.INFRA_TRACKS, "markers", markers.MARKERS, markers.object_markers),
    Row(topics.INFRA_POINTS, "points", clouds.POINT_CLOUD2, clouds.point_cloud, SENSOR_DATA),
    Row(topics.FUSION_VERDICT, "verdict", verdicts.VERDICT, verdicts.verdict, says_itself=True),
    Row(topics.FUSION_HEALTH, DIAGNOSTICS, verdicts.DIAGNOSTICS, verdicts.diagnostics, says_itself=True),
)
# Only with an option: they use a namespace that belongs to the ROS system.
AUTOWARE_ROW = Row(
    topics.INFRA_TRACKS, OBJECTS_OF_AUTOWARE, tracked_objects.TRACKED_OBJECTS, tracked_objects.tracked_objects_on_map
)
TF_ROW = Row(topics.EGO_MOTION, TF, transforms.TF, transforms.vehicle_transform, Qos(depth=100))
