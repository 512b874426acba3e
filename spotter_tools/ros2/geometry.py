"""Positions and turns as geometry_msgs. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from common.ros2.types import build

MAP, VEHICLE = "map", "base_link"  # REP-105


class FrameError(ValueError):
    """A message in another frame than its topic in ROS 2 stands for."""


def vector(v: Sequence[float]) -> Any:
    """geometry_msgs/Vector3."""
    return build("geometry_msgs/msg/Vector3", x=float(v[0]), y=float(v[1]), z=float(v[2]))


def point(v: Sequence[float]) -> Any:
    """geometry_msgs/Point."""
    return build("geometry_msgs/msg/Point", x=float(v[0]), y=float(v[1]), z=float(v[2]))


def turn(yaw_rad: float, pitch_rad: float = 0.0) -> Any:
    """geometry_msgs/Quaternion of a yaw, and a pitch (nose up is positive) about the turned axis."""
    half_yaw, half_down = yaw_rad / 2, -pitch_rad / 2  # about y, left: nose down is positive
    return build(
        "geometry_msgs/msg/Quaternion",
        x=-math.sin(half_yaw) * math.sin(half_down),
        y=math.cos(half_yaw) * math.sin(half_down),
        z=math.sin(half_yaw) * math.cos(half_down),
        w=math.cos(half_yaw) * math.cos(half_down),
    )


def pose(position_m: Sequence[float], yaw_rad: float) -> Any:
    """geometry_msgs/Pose."""
    return build("geometry_msgs/msg/Pose", position=point(position_m), orientation=turn(yaw_rad))


def colour(rgb: Sequence[float], alpha: float) -> Any:
    """std_msgs/ColorRGBA."""
    return build("std_msgs/msg/ColorRGBA", r=float(rgb[0]), g=float(rgb[1]), b=float(rgb[2]), a=alpha)
