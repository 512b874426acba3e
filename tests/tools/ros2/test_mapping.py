"""Our messages as messages of ROS 2, one mapping after the other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common import messages as m
from common.config import public
from common.geometry import wrap_angle
from common.ros2.reader import Arrived
from common.ros2.types import from_cdr, ns_of, to_cdr, type_store
from services.infra_lidar.input.pointcloud2 import points_of_message
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.ros2 import picture_of
from services.jetson.lidar.config import LidarConfig, MountingSection
from services.jetson.lidar.ros2 import laser_scan as read_scan
from spotter_tools.ros2.clouds import COMPRESSED_IMAGE, picture, point_cloud
from spotter_tools.ros2.detections import detections_2d, detections_3d
from spotter_tools.ros2.geometry import FrameError, turn
from spotter_tools.ros2.markers import object_markers, radar_markers
from spotter_tools.ros2.scans import laser_scan
from spotter_tools.ros2.table import AUTOWARE_ROW, ROWS, TF_ROW
from spotter_tools.ros2.tracked_objects import tracked_objects
from spotter_tools.ros2.transforms import sensor_transform, vehicle_transform
from spotter_tools.ros2.verdicts import diagnostics, verdict

STAMP_NS = 1_700_000_000_123_456_789


def there_and_back(message: Any) -> Any:
    """As a reader of ROS gets it."""
    return from_cdr(to_cdr(message), message.__msgtype__)


def track(**change: Any) -> m.ObjectTrack:
    about: dict[str, Any] = {
        "track_id": 7, "label": "car", "label_confidence": 0.9, "position_m": (10.0, -2.0, 0.8),
        "velocity_mps": (3.0, 4.0, 0.0), "covariance": np.diag([1.0, 2, 3, 4, 5, 6]).tolist(),
        "size_m": (4.5, 1.8, 1.5), "yaw_rad": math.atan2(4.0, 3.0), "age_s": 3.0, "score": 0.8, "state": "confirmed",
        "points": 99,
    }  # fmt: skip
    return m.ObjectTrack(**(about | change))


def tracks(*of: m.ObjectTrack) -> m.ObjectTracks:
    return m.ObjectTracks(stamp_ns=STAMP_NS, tracks=list(of), source_kind="live")


def test_a_scan_keeps_its_returns_within_half_a_step() -> None:
    angles = np.linspace(-math.pi, math.pi, 450, endpoint=False)
    ranges = np.where(np.arange(450) % 7, 1.0 + np.arange(450) / 100, 0.0)
    ours = m.LaserScan(
        stamp_ns=STAMP_NS, angles_rad=np.roll(angles, 100).astype(np.float32),
        ranges_m=np.roll(ranges, 100).astype(np.float32), confidence=np.full(450, 200, np.uint8),
    )  # fmt: skip
    theirs = there_and_back(laser_scan(ours, "jetson0"))
    assert (ns_of(theirs.header.stamp), theirs.header.frame_id) == (STAMP_NS, "lidar")
    np.testing.assert_allclose(theirs.ranges, np.where(ranges > 0, ranges, np.inf), rtol=1e-6)
    again = read_scan(Arrived(STAMP_NS, STAMP_NS, theirs), MountingSection())
    np.testing.assert_allclose(again.ranges_m, ranges, rtol=1e-6)
    np.testing.assert_allclose(wrap_angle(again.angles_rad - angles), 0.0, atol=1e-5)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.floats(-4, 4), st.floats(0.1, 20)), max_size=40))
def test_the_nearest_return_of_a_scan_is_never_lost(beams: list[tuple[float, float]]) -> None:
    angles, ranges = np.array([b[0] for b in beams], np.float32), np.array([b[1] for b in beams], np.float32)
    ours = m.LaserScan(stamp_ns=1, angles_rad=angles, ranges_m=ranges, confidence=np.ones(len(beams), np.uint8))
    theirs = laser_scan(ours, "jetson0")
    assert theirs.ranges.min() == (ranges.min() if len(beams) else np.inf)


def test_a_cloud_is_read_back_by_our_own_reader() -> None:
    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    ours = m.PointCloud(
        stamp_ns=STAMP_NS, points=points, intensity=np.arange(4, dtype=np.uint8), kind=np.array([0, 1, 2, 3], np.uint8)
    )
    theirs = there_and_back(point_cloud(ours, "infra0"))
    np.testing.assert_array_equal(points_of_message(theirs), np.column_stack([points, np.arange(4)]))
    assert [f.name for f in theirs.fields] == ["x", "y", "z", "intensity", "kind"]
    assert (theirs.point_step, theirs.row_step, theirs.width, theirs.header.frame_id) == (20, 80, 4, "map")
    empty = m.PointCloud(
        stamp_ns=1, points=np.zeros((0, 3), np.float32), intensity=np.zeros(0, np.uint8), kind=np.zeros(0, np.uint8)
    )
    assert there_and_back(point_cloud(empty, "infra0")).width == 0


def test_a_picture() -> None:
    import cv2

    data = cv2.imencode(".png", np.full((4, 4, 3), 9, np.uint8))[1].tobytes()
    theirs = there_and_back(picture(m.CompressedImage(stamp_ns=STAMP_NS, format="png", data=data), "jetson0"))
    assert picture_of(theirs, COMPRESSED_IMAGE).shape == (4, 4, 3)


def test_detections_in_the_picture() -> None:
    one = m.CameraDetection(
        label="person", confidence=0.7, box_xyxy_px=(10.0, 20.0, 30.0, 60.0), distance_m=1.5, level="CAUTION",
        in_zone=True, truncated=False, distance_sigma_m=0.2,
    )  # fmt: skip
    ours = m.CameraDetections(
        stamp_ns=STAMP_NS, detections=[one], brightness=90.0, level="CAUTION", image_size_px=(640, 480)
    )
    (theirs,) = there_and_back(detections_2d(ours, "jetson0")).detections
    assert (theirs.bbox.center.position.x, theirs.bbox.center.position.y) == (20.0, 40.0)
    assert (theirs.bbox.size_x, theirs.bbox.size_y) == (20.0, 40.0)
    (result,) = theirs.results
    assert (result.hypothesis.class_id, result.hypothesis.score) == ("person", 0.7)
    assert (result.pose.pose.position.z, result.pose.covariance[14]) == (1.5, pytest.approx(0.04))


def test_tracks_as_boxes() -> None:
    (theirs,) = there_and_back(detections_3d(tracks(track()), "infra0")).detections
    assert (theirs.id, theirs.results[0].hypothesis.class_id) == ("7", "car")
    assert (theirs.bbox.size.x, theirs.bbox.center.position.x) == (4.5, 10.0)
    assert 2 * math.atan2(theirs.bbox.center.orientation.z, theirs.bbox.center.orientation.w) == pytest.approx(
        0.9273, abs=1e-4
    )
    assert list(np.diag(theirs.results[0].pose.covariance.reshape(6, 6))) == [1, 2, 3, 0, 0, 0]


def test_tracks_and_points_keep_their_frame_and_autoware_gets_those_of_the_map_only() -> None:
    message = tracks(track())
    message.frame_id = "pole"
    for mapped in (detections_3d, tracked_objects):
        assert there_and_back(mapped(message, "infra0")).header.frame_id == "pole"
    assert there_and_back(object_markers(message, "infra0")).markers[0].header.frame_id == "pole"
    with pytest.raises(FrameError, match="tracks in the frame pole, not map"):
        AUTOWARE_ROW.map(message, "infra0")
    message.frame_id = ""
    assert there_and_back(AUTOWARE_ROW.map(message, "infra0")).header.frame_id == "map"


def test_tracks_for_autoware_have_their_velocity_in_their_own_frame() -> None:
    (theirs,) = there_and_back(tracked_objects(tracks(track()), "infra0")).objects
    kinematics = theirs.kinematics
    twist = kinematics.twist_with_covariance.twist.linear
    assert (twist.x, twist.y) == (pytest.approx(5.0), pytest.approx(0.0, abs=1e-9))
    assert (kinematics.orientation_availability, kinematics.is_stationary) == (2, False)
    assert (theirs.classification[0].label, theirs.shape.type, theirs.shape.dimensions.z) == (1, 0, 1.5)
    assert theirs.existence_probability == pytest.approx(0.8)


def test_a_box_that_points_backwards_is_turned_and_one_that_stands_says_that_its_sign_is_not_known() -> None:
    backwards = track(yaw_rad=math.atan2(4.0, 3.0) + math.pi)
    (theirs,) = tracked_objects(tracks(backwards), "infra0").objects
    assert theirs.kinematics.twist_with_covariance.twist.linear.x == pytest.approx(5.0)
    (standing,) = tracked_objects(tracks(track(velocity_mps=(0.1, 0.0, 0.0))), "infra0").objects
    assert (standing.kinematics.orientation_availability, standing.kinematics.is_stationary) == (1, True)


def test_an_object_keeps_its_id_and_has_another_one_on_another_host() -> None:
    def identity(host: str, number: int) -> bytes:
        return tracked_objects(tracks(track(track_id=number)), host).objects[0].object_id.uuid.tobytes()

    assert identity("infra0", 7) == identity("infra0", 7)
    assert len({identity("infra0", 7), identity("infra0", 8), identity("infra1", 7)}) == 3


def test_markers_for_rviz() -> None:
    theirs = there_and_back(object_markers(tracks(track(), track(track_id=8, velocity_mps=(0.0, 0.0, 0.0))), "infra0"))
    assert [(marker.ns, marker.id, marker.type) for marker in theirs.markers] == [
        ("objects", 7, 1), ("velocity", 7, 0), ("names", 7, 9), ("objects", 8, 1), ("names", 8, 9)
    ]  # fmt: skip
    assert theirs.markers[1].scale.x == pytest.approx(5.0)
    assert theirs.markers[2].text == "car 7 5.0 m/s"
    assert all(marker.header.frame_id == "map" and marker.lifetime.nanosec == 500_000_000 for marker in theirs.markers)
    one = m.RadarTrack(
        track_id=3, range_m=2.0, azimuth_rad=math.pi / 2, velocity_mps=-1.0, age_frames=9, approaching=True,
        moving=True, ttc_s=2.0, level="IMMINENT", snr_db=20.0,
    )  # fmt: skip
    radar = m.RadarTracks(stamp_ns=1, tracks=[one], level="IMMINENT", settled=True, noise_floor_db=-60.0)
    ball, words = there_and_back(radar_markers(radar, "pi0")).markers
    assert (ball.pose.position.y, ball.header.frame_id, words.text) == (pytest.approx(2.0), "radar", "#3 -1.0 m/s")


@pytest.mark.parametrize(
    ("level", "permission", "expected"),
    [("SAFE", "GO", (1, 2)), ("CAUTION", "SLOW", (2, 1)), ("IMMINENT", "STOP", (3, 0))],
)
def test_a_verdict(level: Any, permission: Any, expected: tuple[int, int]) -> None:
    ours = m.Verdict(
        stamp_ns=STAMP_NS, seq=5, level=level, rule="R1", because="why", inputs={}, confirmed=True, suppressed=False,
        advisory=None, blind=False, permission=permission, covered_m=3.0, source_kind="simulated",
    )  # fmt: skip
    theirs = there_and_back(verdict(ours, "jetson0"))
    assert (theirs.level, theirs.permission) == expected
    assert (theirs.rule, theirs.because, theirs.source_kind, theirs.covered_m) == ("R1", "why", "simulated", 3.0)
    assert math.isnan(theirs.max_safe_speed_mps)


def test_health() -> None:
    sensor = m.SensorHealth(
        state="disconnected",
        reason="cable",
        since_ns=1,
        age_ms=None,
        rate_hz=0.0,
        cause="device_lost",
        source_kind="live",
    )
    ours = m.SystemHealth(
        stamp_ns=STAMP_NS, sensors={"lidar": sensor}, colour="red", summary="LiDAR: cable", services={}
    )
    whole, lidar = there_and_back(diagnostics(ours, "jetson0")).status
    assert (whole.level, whole.message, whole.hardware_id) == (2, "LiDAR: cable", "jetson0")
    assert (lidar.level, lidar.name, lidar.message) == (2, "spotter: LiDAR", "cable")
    assert {pair.key: pair.value for pair in lidar.values}["age_ms"] == "never seen"


def test_where_the_vehicle_and_its_sensors_are() -> None:
    T = np.eye(4)
    T[:2, :2], T[:3, 3] = [[0, -1], [1, 0]], (1, 2, 0)
    ours = m.EgoMotion(stamp_ns=STAMP_NS, speed_mps=1.0, yaw_rate_radps=0.0, T_map_vehicle=T.tolist())
    (theirs,) = there_and_back(vehicle_transform(ours, "jetson0")).transforms
    assert (theirs.header.frame_id, theirs.child_frame_id, theirs.transform.translation.y) == ("map", "base_link", 2.0)
    assert theirs.transform.rotation.z == pytest.approx(math.sqrt(0.5))
    assert vehicle_transform(m.EgoMotion(stamp_ns=1, speed_mps=None, yaw_rate_radps=None), "jetson0") is None
    config = public(LidarConfig(mounting=MountingSection(front_m=0.05, left_m=-0.02)))
    (lidar,) = there_and_back(sensor_transform("lidar", config, 5)).transforms
    assert lidar.transform.translation.x == pytest.approx(LidarConfig().path.front_m - 0.05)
    assert lidar.transform.translation.y == -0.02
    (camera,) = sensor_transform("camera", public(CameraConfig()), 5).transforms
    assert camera.transform.translation.x == CameraConfig().zone.camera_x_m
    assert sensor_transform("fusion", {}, 5) is None
    assert sensor_transform("lidar", {"host": "their own program"}, 5) is None


def test_a_nose_that_points_up_is_a_turn_about_minus_y() -> None:
    up = turn(0.0, 0.2)
    assert (up.y, up.w) == (pytest.approx(-math.sin(0.1)), pytest.approx(math.cos(0.1)))
    left_and_up = turn(math.pi / 2, 0.2)  # ahead of it: left and up
    q = np.array([left_and_up.x, left_and_up.y, left_and_up.z])
    ahead = np.array([1.0, 0, 0]) + 2 * np.cross(q, np.cross(q, [1.0, 0, 0]) + left_and_up.w * np.array([1.0, 0, 0]))
    np.testing.assert_allclose(ahead, [0, math.cos(0.2), math.sin(0.2)], atol=1e-12)


def test_names_are_legal_and_tell_what_is_not_live() -> None:
    rows = (*ROWS, AUTOWARE_ROW, TF_ROW)
    assert {row.type for row in rows} <= set(type_store().fielddefs)
    assert len({(row.name("h", "live"), row.topic) for row in rows}) == len(rows)
    assert ROWS[0].name("jetson0", "live") == "/spotter/jetson0/lidar/scan"
    assert ROWS[0].name("jetson0", "simulated") == "/spotter_simulated/jetson0/lidar/scan"
    assert AUTOWARE_ROW.name("infra0", "recorded") == "/spotter_recorded/perception/object_recognition/tracking/objects"
    assert TF_ROW.name("jetson0", "live") == "/tf"
