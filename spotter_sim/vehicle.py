"""Our own vehicle in the simulated world: its size, where its sensors sit, and its pose on the ground as it drives."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from common.geometry import rotation_rpy, transform
from spotter_sim.motion import Motion

if TYPE_CHECKING:
    from spotter_sim.scene import Ground

_STEP_S = 1e-3  # backwards in time, over which the turn and the climb are taken: the future need not be known


def _at(x_m: float, z_m: float) -> np.ndarray:
    return transform(translation=np.array([x_m, 0.0, z_m]))


@dataclass(frozen=True, eq=False)
class Chassis:
    """A vehicle preset. The vehicle's origin is on the ground below the middle of its outline."""

    name: str
    size_m: tuple[float, float, float]  # length, width, height
    wheelbase_m: float
    T_vehicle_ld06: np.ndarray = field(repr=False)
    T_vehicle_radar: np.ndarray = field(repr=False)
    T_vehicle_camera: np.ndarray = field(repr=False)  # x forward: the optical axis


MODEL_CAR = Chassis("model", (0.40, 0.191, 0.25), 0.26, _at(0.10, 0.22), _at(0.20, 0.20), _at(0.16, 0.24))
# A delivery cart of one metre width: sensors at the bumper and on the bonnet, the lidar's plane at knee height.
CART = Chassis("cart", (1.60, 1.00, 1.00), 1.10, _at(0.75, 0.40), _at(0.80, 0.45), _at(0.70, 0.95))


@dataclass(frozen=True, eq=False)
class VehicleState:
    """Where the vehicle is and how it moves, map frame."""

    T_map_vehicle: np.ndarray  # (4, 4)
    velocity_mps: np.ndarray  # (3,) of the vehicle's origin
    speed_mps: float  # along the vehicle's x, negative in reverse
    yaw_rate_radps: float  # counter-clockwise positive

    def T_map_vehicle_after(self, seconds: np.ndarray) -> np.ndarray:
        """(N, 4, 4) poses so many seconds (N,) later or earlier, with speed and yaw rate unchanged."""
        yaw = self.yaw_rate_radps * seconds
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.tile(np.eye(4), (len(seconds), 1, 1))
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, -s, s, c
        # the chord of an arc lies along half of its turn; sinc is sin(pi x) / (pi x)
        chord_m = self.speed_mps * seconds * np.sinc(yaw / (2.0 * np.pi))
        turn[:, 0, 3], turn[:, 1, 3] = chord_m * np.cos(0.5 * yaw), chord_m * np.sin(0.5 * yaw)
        return np.asarray(self.T_map_vehicle @ turn)

    def velocity_of(self, T_vehicle_sensor: np.ndarray) -> np.ndarray:
        """(3,) velocity of a place on the vehicle, map frame."""
        lever = self.T_map_vehicle[:3, :3] @ T_vehicle_sensor[:3, 3]
        return self.velocity_mps + self.yaw_rate_radps * np.array([-lever[1], lever[0], 0.0])


STANDING = VehicleState(np.eye(4), np.zeros(3), 0.0, 0.0)


def driven(motion: Motion, t_s: float, ground: Ground, chassis: Chassis) -> VehicleState:
    """The state at a time of a vehicle that follows ``motion`` and stands on the ground with four wheels."""
    pose, before = motion.at(t_s), motion.at(t_s - _STEP_S)
    turn = (pose.yaw_rad - before.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
    speed = pose.vx_mps * math.cos(pose.yaw_rad) + pose.vy_mps * math.sin(pose.yaw_rad)
    T = _on_wheels((pose.x_m, pose.y_m, pose.yaw_rad), ground, chassis)
    return VehicleState(T, T[:3, 0] * speed, speed, turn / _STEP_S)


def _on_wheels(place: tuple[float, float, float], ground: Ground, chassis: Chassis) -> np.ndarray:
    """(4, 4) pose of a body whose four wheels touch the ground; ``place`` is x, y, yaw."""
    x, y, yaw = place
    along = 0.5 * chassis.wheelbase_m * np.array([math.cos(yaw), math.sin(yaw)])
    aside = 0.5 * chassis.size_m[1] * np.array([-math.sin(yaw), math.cos(yaw)])

    def height(offset: np.ndarray) -> float:
        return float(ground.height(x + offset[0], y + offset[1]))

    front, rear, left, right = (height(offset) for offset in (along, -along, aside, -aside))
    pitch = math.atan2(rear - front, chassis.wheelbase_m)
    roll = math.atan2(left - right, chassis.size_m[1])
    return transform(rotation_rpy(roll, pitch, yaw), np.array([x, y, 0.5 * (front + rear)]))
