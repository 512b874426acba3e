"""Scans of a ROS 2 driver: the mapping, and the source over a real router."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
import pytest

from common.bus.session import open_session
from common.bus.status import Report
from common.clock import utc_ns
from common.config import ConfigError, ZenohConfig
from common.messages import LaserScan
from common.ros2.keys import SENSOR_DATA
from common.ros2.node import Node
from common.ros2.reader import Arrived
from common.ros2.types import build, header
from services.jetson.lidar.config import LidarConfig, MountingSection
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.ros2 import SCAN, ScanError, laser_scan
from services.jetson.lidar.source import open_source

AHEAD = MountingSection()


def scan(ranges: Any, **fields: Any) -> Arrived:
    count = len(ranges)
    about = {"angle_min": -math.pi, "angle_increment": 2 * math.pi / count, "range_min": 0.1, "range_max": 12.0}
    return Arrived(5, 7, build(SCAN, header=header(5, "laser"), ranges=ranges, **(about | fields)))


def test_angles_ranges_and_stamps_are_the_message_s() -> None:
    ours = laser_scan(scan([1.0, 2.0, 3.0, 4.0]), AHEAD)
    np.testing.assert_allclose(ours.angles_rad, [-math.pi, -math.pi / 2, 0, math.pi / 2], atol=1e-6)
    np.testing.assert_array_equal(ours.ranges_m, [1, 2, 3, 4])
    assert (ours.stamp_ns, ours.received_ns) == (5, 7)


def test_the_mounting_turns_and_mirrors() -> None:
    ours = laser_scan(scan([1.0, 2.0, 3.0, 4.0]), MountingSection(upside_down=True, yaw_deg=90.0))
    np.testing.assert_allclose(ours.angles_rad, [-math.pi / 2, -math.pi, math.pi / 2, 0], atol=1e-6)


def test_what_is_no_distance_is_no_return_and_too_near_is_light_at_the_lens() -> None:
    """REP-117: nan is nothing, inf is nothing in reach, -inf is too near; beyond the limits is to be discarded."""
    ours = laser_scan(scan([1.0, np.nan, np.inf, -np.inf, 0.05, 13.0, 0.0, -1.0]), AHEAD)
    np.testing.assert_array_equal(ours.ranges_m, [1, 0, 0, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(ours.confidence, [255, 0, 0, 255, 255, 0, 0, 0])


def test_intensities_are_confidence_only_where_that_is_said() -> None:
    strengths = [3.0, 700.0, np.nan, 100.0]
    assert list(laser_scan(scan([1.0] * 4, intensities=strengths), AHEAD).confidence) == [255] * 4
    assert list(laser_scan(scan([1.0] * 4, intensities=strengths), AHEAD, True).confidence) == [3, 255, 0, 100]
    with pytest.raises(ScanError, match="0 intensities for 4 ranges"):
        laser_scan(scan([1.0] * 4), AHEAD, True)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"angle_increment": 0.0}, "are no turn"),
        ({"angle_increment": math.nan}, "are no turn"),
        ({"angle_min": math.inf}, "are no turn"),
        ({"angle_increment": 3.0}, "are no turn"),
        ({"range_min": 5.0, "range_max": 5.0}, "range_min 5 is not below range_max 5"),
        ({"range_max": math.nan}, "is not below range_max nan"),
    ],
)
def test_a_scan_that_contradicts_itself_is_refused(fields: dict[str, float], words: str) -> None:
    with pytest.raises(ScanError, match=words):
        laser_scan(scan([1.0] * 6, **fields), AHEAD)
    with pytest.raises(ScanError, match="0 ranges"):
        laser_scan(Arrived(5, 7, build(SCAN, angle_increment=0.1)), AHEAD)


def test_a_wall_close_ahead_is_imminent_for_the_pipeline() -> None:
    config, angles = LidarConfig(), np.linspace(-math.pi, math.pi, 450, endpoint=False)
    pipeline, levels = LidarPipeline(config), []
    for k in range(8):
        ranges = np.where(np.abs(angles) < 0.3, 0.5 / np.cos(angles), 4.0)
        stamp_ns = (k + 1) * 100_000_000
        ours = laser_scan(Arrived(stamp_ns, stamp_ns, scan(ranges).message), config.mounting)
        levels.append(pipeline.process(stamp_ns, ours).level)
    assert levels[-1] == "IMMINENT"


def test_scans_come_from_a_driver_and_the_reason_from_its_absence(router_endpoint: str, until) -> None:
    config = LidarConfig(source="ros2:/scan", zenoh=ZenohConfig(namespace="site", connect=(router_endpoint,)))
    report, scans = Report("lidar"), list[tuple[int, LaserScan]]()
    threading.Thread(target=lambda: scans.extend(open_source(config, report)), daemon=True).start()
    until(lambda: "ROS topic /scan: nobody publishes it" in report.snapshot().reason)
    with open_session(ZenohConfig(namespace="", connect=(router_endpoint,))) as session:
        publish = Node(session, "driver").publisher("/scan", SCAN, SENSOR_DATA)
        until(lambda: publish.wanted)
        message = scan([1.0, 2.0, 3.0]).message
        message.header = header(utc_ns(), "laser")
        publish(message)
        until(lambda: scans)
    assert list(scans[0][1].ranges_m) == [1, 2, 3]


def test_a_wrong_confidence_is_refused() -> None:
    with pytest.raises(ConfigError, match="confidence=half: expected full or intensity"):
        next(open_source(LidarConfig(source="ros2:/scan?confidence=half"), Report("lidar")))
