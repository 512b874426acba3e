"""LaserScan to sensor_msgs/LaserScan. Pure."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from common import messages as m
from common.ros2.types import build, header

LASER_SCAN = "sensor_msgs/msg/LaserScan"
FARTHEST_M = 30.0  # no 2-D lidar that we read measures beyond


def laser_scan(message: m.LaserScan, host: str) -> Any:
    """A turn from -pi in even steps, as many as it has beams.

    Our beams have angles of their own: each goes to the nearest step, and of several there the nearest return counts.
    A step without a return is inf (REP-117); a return that the filters rejected is there too.
    """
    count = max(2, len(message.angles_rad))
    step_rad = 2 * math.pi / count
    ranges, strengths = np.full(count, np.inf, np.float32), np.zeros(count, np.float32)
    back = np.asarray(message.ranges_m) > 0
    places = np.round((np.asarray(message.angles_rad, float)[back] + math.pi) / step_rad).astype(int) % count
    far_first = np.argsort(-np.asarray(message.ranges_m)[back], kind="stable")
    ranges[places[far_first]] = np.asarray(message.ranges_m)[back][far_first]
    strengths[places[far_first]] = np.asarray(message.confidence)[back][far_first]
    return build(
        LASER_SCAN, header=header(message.stamp_ns, "lidar"), angle_min=-math.pi, angle_max=math.pi - step_rad,
        angle_increment=step_rad, range_min=0.0, range_max=FARTHEST_M, ranges=ranges, intensities=strengths,
    )  # fmt: skip
