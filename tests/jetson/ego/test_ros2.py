"""Odometry and IMU of ROS 2: the mapping, and the service's source over a real router."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
import pytest

from common.bus.session import open_session
from common.bus.status import Report
from common.clock import utc_ns
from common.config import ZenohConfig
from common.ros2.keys import SENSOR_DATA
from common.ros2.node import Node
from common.ros2.types import build, header
from services.jetson.ego.config import EgoConfig, ImuConfig
from services.jetson.ego.measurement import Measurement, Rejected
from services.jetson.ego.pipeline import Motion
from services.jetson.ego.ros2 import IMU, ODOMETRY, imu, odometry
from services.jetson.ego.source import open_source


def odom(speed_mps: float, turn_radps: float, variances: tuple[float, float] = (0.0, 0.0), stamp_ns: int = 1) -> Any:
    message = build(ODOMETRY, header=header(stamp_ns, "odom"))
    message.twist.twist.linear.x, message.twist.twist.angular.z = speed_mps, turn_radps
    covariance = np.zeros(36)
    covariance[0], covariance[35] = variances
    message.twist.covariance = covariance
    return message


def test_odometry_gives_speed_yaw_rate_and_their_spread() -> None:
    assert odometry(odom(1.5, -0.2, (0.04, 0.01)), 7.0) == Measurement(
        7.0, "odometry", speed_mps=1.5, yaw_rate_radps=-0.2, speed_sigma_mps=0.2, yaw_rate_sigma_radps=0.1
    )


@pytest.mark.parametrize("variance", [0.0, -1.0, math.nan, math.inf])
def test_a_variance_that_is_none_is_not_known(variance: float) -> None:
    one = odometry(odom(1.0, 0.0, (variance, variance)), 7.0)
    assert isinstance(one, Measurement)
    assert (one.speed_sigma_mps, one.yaw_rate_sigma_radps) == (None, None)


def test_what_is_not_finite_is_rejected() -> None:
    assert odometry(odom(math.nan, 0.0), 7.0) == Rejected("odometry", "not finite")
    message = build(IMU)
    message.angular_velocity.z = math.inf
    assert imu(message, 7.0, ImuConfig()) == Rejected("imu", "not finite")


def test_an_imu_gives_the_rate_about_its_axis_as_it_is_mounted() -> None:
    message = build(IMU)
    message.angular_velocity.z, message.angular_velocity.x = 0.3, 0.1
    assert imu(message, 7.0, ImuConfig()) == Measurement(7.0, "imu", yaw_rate_radps=0.3)
    assert imu(message, 7.0, ImuConfig(axis="x", sign=-1)) == Measurement(7.0, "imu", yaw_rate_radps=-0.1)
    message.angular_velocity_covariance[0] = -1.0
    assert imu(message, 7.0, ImuConfig()) == Rejected("imu", "without a rate")


def test_a_driver_s_odometry_and_imu_become_motion_and_their_silence_a_reason(router_endpoint: str, until) -> None:
    config = EgoConfig(
        source=f"ros2:/odom + ros2:/imu?type={IMU}",
        zenoh=ZenohConfig(namespace="site", connect=(router_endpoint,)),
    )
    motions: list[Motion] = []
    source = open_source(config, Report("ego"))
    threading.Thread(target=lambda: motions.extend(motion for _, motion in source), daemon=True).start()
    until(lambda: motions and "ROS topic /odom: nobody publishes it" in motions[-1].reason)
    assert motions[-1].speed_mps is None
    with open_session(ZenohConfig(namespace="", connect=(router_endpoint,))) as session:
        node = Node(session, "base")
        publish = node.publisher("/odom", ODOMETRY, SENSOR_DATA)
        turn = node.publisher("/imu", IMU, SENSOR_DATA)

        def is_read() -> bool:
            publish(odom(1.25, 0.5, (0.01, 0.01), utc_ns()))
            turn(build(IMU, header=header(utc_ns(), "imu")))
            return motions[-1].speed_mps == 1.25 and motions[-1].reason == ""

        until(is_read)
        assert motions[-1].speed_origin == "odometry"
        assert motions[-1].yaw_rate_radps == 0.5
        assert motions[-1].speed_sigma_mps == pytest.approx(0.1)
    until(lambda: motions[-1].speed_mps is None and motions[-1].reason != "")
