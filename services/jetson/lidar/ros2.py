"""``ros2:/scan``: revolutions of any 2-D lidar with a ROS 2 driver. The mapping is pure; ``ros_scans`` opens a session.

Mounting applies as to a sensor of our own: ``upside_down`` mirrors the angles, ``yaw_deg`` turns them. Angles are
counter-clockwise already, so ``clockwise`` means nothing here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from common.bus.status import Report
from common.config import ConfigError
from common.geometry import wrap_angle
from common.messages import LaserScan
from common.ros2.reader import Arrived, TopicReader
from common.ros2.source import ros_session, ros_topic
from common.source_url import SourceUrl
from services.jetson.lidar.config import LidarConfig, MountingSection

SCAN = "sensor_msgs/msg/LaserScan"
MOST_BEAMS = 100_000
BRIGHT = 255  # confidence of a return whose strength is not known: it is believed
NODE = "spotter_lidar"


class ScanError(ValueError):
    """A scan that contradicts itself; the text says why."""


def laser_scan(arrived: Arrived, mounting: MountingSection, by_intensity: bool = False) -> LaserScan:
    """Our scan of a sensor_msgs/LaserScan (REP-117: what is not finite is no return, -inf is too near to measure).

    by_intensity: the intensities are an LD06's confidence, 0 to 255. Without it their scale is not known, and every
    return is believed: that can only raise an alarm.

    Raises:
        ScanError: no beams, angles or limits that are no numbers, or intensities of another number.
    """
    message = arrived.message
    ranges = np.asarray(message.ranges, np.float64)
    _check(message, len(ranges))
    with np.errstate(invalid="ignore"):
        within = np.isfinite(ranges) & (ranges > 0.0) & (ranges >= message.range_min) & (ranges <= message.range_max)
        at_the_lens = (ranges == -np.inf) | ((ranges > 0.0) & (ranges < message.range_min))
    confidence = np.full(len(ranges), BRIGHT, np.uint8)
    if by_intensity:
        confidence = np.clip(np.nan_to_num(np.asarray(message.intensities)), 0, 255).astype(np.uint8)
        if len(confidence) != len(ranges):
            raise ScanError(f"{len(confidence)} intensities for {len(ranges)} ranges, and ?confidence=intensity")
    confidence[~within] = np.where(at_the_lens[~within], BRIGHT, 0)  # light without a distance, or nothing
    angles = message.angle_min + np.arange(len(ranges)) * float(message.angle_increment)
    mirror = -1.0 if mounting.upside_down else 1.0
    return LaserScan(
        stamp_ns=arrived.stamp_ns,
        received_ns=arrived.received_ns,
        frame_id="lidar",
        angles_rad=wrap_angle(mirror * angles + math.radians(mounting.yaw_deg)).astype(np.float32),
        ranges_m=np.where(within, ranges, 0.0).astype(np.float32),
        confidence=confidence,
    )


def _check(message: Any, beams: int) -> None:
    if not 2 <= beams <= MOST_BEAMS:
        raise ScanError(f"{beams} ranges: expected 2 to {MOST_BEAMS}")
    step, first = float(message.angle_increment), float(message.angle_min)
    turns = abs(step) * (beams - 1) / (2 * math.pi)
    if not (math.isfinite(first) and step and turns < 1.0 + 1.0 / beams):
        raise ScanError(f"angles from {first:g} in {beams} steps of {step:g} rad are no turn")
    if not message.range_min < message.range_max:
        raise ScanError(f"range_min {message.range_min:g} is not below range_max {message.range_max:g}")


def ros_scans(url: SourceUrl, config: LidarConfig, report: Report) -> Iterator[tuple[int, LaserScan]]:
    """``(stamp_ns, scan)`` of every message that can be used.

    Raises:
        ConfigError: a wrong address.
    """
    confidence = url.params.get("confidence", "full")
    if confidence not in ("full", "intensity"):
        raise ConfigError(f"source {url}: confidence={confidence}: expected full or intensity")
    reader = TopicReader(ros_topic(url, (SCAN,)), ros_session(url, config.zenoh), report, NODE)
    return _scans(reader, config.mounting, confidence == "intensity")


def _scans(reader: TopicReader, mounting: MountingSection, by_intensity: bool) -> Iterator[tuple[int, LaserScan]]:
    with reader:
        for arrived in reader.messages():
            try:
                scan = laser_scan(arrived, mounting, by_intensity)
            except ScanError as error:
                reader.refuse(str(error), "unreadable scan")
                continue
            yield scan.stamp_ns, scan
