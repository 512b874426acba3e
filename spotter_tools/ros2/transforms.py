"""Where the vehicle is and where its sensors sit, as tf2_msgs/TFMessage. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from common import messages as m
from common.ros2.types import build, header
from spotter_tools.ros2.geometry import MAP, VEHICLE, turn, vector

TF = "tf2_msgs/msg/TFMessage"


def vehicle_transform(message: m.EgoMotion, host: str) -> Any | None:
    """map to base_link; None while the pose is not known."""
    if message.T_map_vehicle is None:
        return None
    T = np.asarray(message.T_map_vehicle)
    yaw_rad = math.atan2(T[1, 0], T[0, 0])
    return build(TF, transforms=[_transform(message.stamp_ns, (MAP, VEHICLE), T[:3, 3], turn(yaw_rad))])


def sensor_transform(service: str, config: Mapping[str, Any], stamp_ns: int) -> Any | None:
    """base_link to a sensor of the vehicle, from the configuration that its service tells.

    None for other services, and for a program of another maker without this configuration. The lidar's angles
    are the vehicle's already, so its frame is not turned.
    """
    try:
        at_m, facing = _PLACES[service](config)
    except (KeyError, TypeError):
        return None
    return build(TF, transforms=[_transform(stamp_ns, (VEHICLE, service), at_m, facing)])


def _lidar(config: Mapping[str, Any]) -> tuple[Sequence[float], Any]:
    mounting = config["mounting"]
    return (config["path"]["front_m"] - mounting["front_m"], mounting["left_m"], 0.0), turn(0.0)


def _radar(config: Mapping[str, Any]) -> tuple[Sequence[float], Any]:
    mounting = config["mounting"]
    return (mounting["x_m"], mounting["y_m"], 0.0), turn(math.radians(mounting["yaw_deg"]))


def _camera(config: Mapping[str, Any]) -> tuple[Sequence[float], Any]:
    zone, mount = config["zone"], config["mount"]
    return (zone["camera_x_m"], zone["camera_y_m"], mount["height_m"]), turn(0.0, mount["pitch_rad"])


_PLACES = {"lidar": _lidar, "radar": _radar, "camera": _camera}


def _transform(stamp_ns: int, frames: tuple[str, str], at_m: Any, facing: Any) -> Any:
    parent, child = frames
    return build(
        "geometry_msgs/msg/TransformStamped", header=header(stamp_ns, parent), child_frame_id=child,
        transform=build("geometry_msgs/msg/Transform", translation=vector(at_m), rotation=facing),
    )  # fmt: skip
