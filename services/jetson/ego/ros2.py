"""``ros2:/odom``: speed and yaw rate of a nav_msgs/Odometry, or the yaw rate of a sensor_msgs/Imu. The mapping is pure;
``RosMotion`` opens a session."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from common.bus.status import Report
from common.clock import monotonic_s, utc_ns
from common.config import ZenohConfig
from common.ros2.reader import TopicReader
from common.ros2.source import ros_session, ros_topic
from common.source_url import SourceUrl
from services.jetson.ego.config import ImuConfig
from services.jetson.ego.measurement import Measurement, Rejected

ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
TYPES = (ODOMETRY, IMU)
NODE = "spotter_ego"
SILENCE_S = 1.0
WAITING = 64  # an IMU's messages come faster than they are taken
SPEED, YAW_RATE = 0, 35  # places in the 6 x 6 covariance of a twist: x, and rotation about z


def odometry(message: Any, at_s: float) -> Measurement | Rejected:
    """Speed forward and yaw rate of the twist, which is in the vehicle's own frame (x forward, z up).

    A variance that is not positive is not known.
    """
    twist = message.twist.twist
    speed_mps, turn_radps = float(twist.linear.x), float(twist.angular.z)
    if not (math.isfinite(speed_mps) and math.isfinite(turn_radps)):
        return Rejected("odometry", "not finite")
    variances = message.twist.covariance
    return Measurement(
        at_s, "odometry", speed_mps=speed_mps, yaw_rate_radps=turn_radps,
        speed_sigma_mps=_sigma(variances[SPEED]), yaw_rate_sigma_radps=_sigma(variances[YAW_RATE]),
    )  # fmt: skip


def imu(message: Any, at_s: float, config: ImuConfig) -> Measurement | Rejected:
    """The yaw rate as measured; its bias is the pipeline's. A first variance of -1 says that there is no rate."""
    rate_radps = float(getattr(message.angular_velocity, config.axis))
    if message.angular_velocity_covariance[0] == -1.0:
        return Rejected("imu", "without a rate")
    if not math.isfinite(rate_radps):
        return Rejected("imu", "not finite")
    return Measurement(at_s, "imu", yaw_rate_radps=config.sign * rate_radps)


def _sigma(variance: float) -> float | None:
    return math.sqrt(variance) if 0.0 < variance < math.inf else None


class RosMotion:
    """A device of the service: one topic. Its session stays open while it is silent."""

    def __init__(self, url: SourceUrl, zenoh: ZenohConfig, imu_config: ImuConfig, report: Report) -> None:
        topic = ros_topic(url, TYPES)
        self.origin = "odometry" if topic.type == ODOMETRY else "imu"
        self._imu_config = imu_config
        self._reader = TopicReader(topic, ros_session(url, zenoh), report, NODE, WAITING)
        self._open = False

    def readings(self) -> Iterator[Measurement | Rejected]:
        """Raises ``OSError`` with the reason after a second without a message that can be used."""
        if not self._open:
            self._reader.__enter__()
            self._open = True
        while True:
            arrived = self._reader.next(SILENCE_S)
            if arrived is None:
                raise OSError(self._reader.why_nothing())
            at_s = monotonic_s() - (utc_ns() - arrived.stamp_ns) * 1e-9
            if self.origin == "odometry":
                yield odometry(arrived.message, at_s)
            else:
                yield imu(arrived.message, at_s, self._imu_config)
