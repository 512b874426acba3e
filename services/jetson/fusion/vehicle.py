"""What is known of the vehicle's own motion; older than the topic's age limit is unknown."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.geometry import pose_2d
from common.messages import EgoMotion
from common.pubsub import Received
from common.topics import EGO_MOTION
from services.jetson.fusion.config import FusionConfig

RIGID_TOLERANCE = 1e-3


class Vehicle(NamedTuple):
    """None = unknown."""

    moving: bool | None
    speed_mps: float | None
    yaw_rate_radps: float | None
    T_map_vehicle: np.ndarray | None


def vehicle_now(ego: Received[EgoMotion] | None, now_s: float, config: FusionConfig) -> Vehicle:
    """From the newest EgoMotion; a vehicle that never told its pose stands where the configuration says."""
    limit_s = EGO_MOTION.age_limit_s or 0.5
    configured = pose_2d(config.roadside.pose_x_m, config.roadside.pose_y_m, config.roadside.pose_yaw_rad)
    if ego is None:
        return Vehicle(None, None, None, configured)
    if now_s - ego.arrived_s > limit_s:
        had_pose = ego.message.T_map_vehicle is not None
        return Vehicle(None, None, None, None if had_pose else configured)
    message = ego.message
    moving = None if message.speed_mps is None else abs(message.speed_mps) >= config.moving_mps
    pose = configured if message.T_map_vehicle is None else rigid(np.array(message.T_map_vehicle, float))
    return Vehicle(moving, message.speed_mps, message.yaw_rate_radps, pose)


def rigid(T: np.ndarray) -> np.ndarray | None:
    """The transform when it is a rotation and a translation; None when it is anything else."""
    orthogonal = np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=RIGID_TOLERANCE)
    proper = bool(np.linalg.det(T[:3, :3]) > 0.0) and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0])
    return T if orthogonal and proper else None
