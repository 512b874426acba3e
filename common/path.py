"""The way ahead: where the vehicle's outline will pass, how far it needs to stop, and what will meet it there.

One model for every sensor, fusion, the simulator's truth and the proving ground. The vehicle keeps its speed and its
yaw rate: its origin runs along an arc of curvature yaw rate over speed (constant turn rate and velocity; Schubert,
Richter and Wanielik 2008). Frame: the vehicle's, x forward, y left, metres; the origin is the point that does not slip
sideways, the middle of the rear axle of a car that steers in front. Pure functions of their arguments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from common.config import Section
from common.message_types import Motion

STRAIGHT_PER_M = 1e-6  # a smaller curvature is a straight line
TIGHTEST_PER_M = 4.0  # a greater one turns on the spot
STEP_S = 0.025  # of the look ahead in time
YAW_UNKNOWN_RADPS = 0.2  # standard deviation if the yaw rate is not measured: a gentle curve is possible

Metres = Annotated[float, Meta(gt=0.0, le=50.0)]
NotNegative = Annotated[float, Meta(ge=0.0, le=50.0)]


class PathConfig(Section, frozen=True, kw_only=True):
    """The vehicle as its path needs it. The defaults are those of a model car of 0.19 m width on a hard floor.

    Measure them on the vehicle: the outline with a tape, ``brake_mps2`` from the braking distance at a known speed.
    """

    width_m: Metres = 0.191
    front_m: NotNegative = 0.20  # from the origin to the front bumper
    rear_m: NotNegative = 0.20  # and to the rear one
    wheelbase_m: Metres = 0.26  # turns a steering angle into a yaw rate where none is measured
    brake_mps2: Annotated[float, Meta(gt=0.0, le=20.0)] = 3.0  # what the brakes do for certain
    reaction_s: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.5  # until they bite: a scan, three to agree, bus, actuator
    side_margin_m: NotNegative = 0.05  # free room that is wanted on each side ...
    stop_margin_m: NotNegative = 0.10  # ... and ahead of the bumper after a stop
    moving_mps: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.1  # slower counts as standing still


class Mount(NamedTuple):
    """Where a sensor sits in the vehicle's frame, and which way it looks."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True)
class MovingPoint:
    """Something in the plane: where it is now and its velocity over ground, both along the vehicle's axes of now."""

    position_m: np.ndarray  # (2,)
    velocity_mps: np.ndarray  # (2,)
    covariance: np.ndarray  # (4, 4) of position and velocity


def is_driving(motion: Motion | None, config: PathConfig) -> bool:
    """Forward, and known. Standing, reversing and unknown motion have no path ahead that a sensor could judge."""
    return motion is not None and motion.speed_mps >= config.moving_mps


def stopping_m(speed_mps: float, config: PathConfig) -> float:
    """Metres from the bumper that have to be free at this speed: reaction, braking and margin; 0 while standing."""
    speed = abs(speed_mps)
    if speed < config.moving_mps:
        return 0.0
    return speed * config.reaction_s + speed**2 / (2.0 * config.brake_mps2) + config.stop_margin_m


def safe_speed_mps(free_m: float, config: PathConfig) -> float:
    """The greatest speed from which the vehicle stops within ``free_m``: the inverse of ``stopping_m``."""
    room_m = max(0.0, free_m - config.stop_margin_m)
    lost_mps = config.brake_mps2 * config.reaction_s
    return math.sqrt(lost_mps**2 + 2.0 * config.brake_mps2 * room_m) - lost_mps


class Path:
    """The strip that the vehicle's outline sweeps if it keeps its motion."""

    def __init__(self, config: PathConfig, motion: Motion | None = None) -> None:
        """``motion`` None: straight ahead, as for a vehicle of which nothing is known."""
        motion = motion or Motion(0.0)
        self.config, self.motion = config, motion
        speed = max(abs(motion.speed_mps), config.moving_mps)
        curvature = math.copysign(1.0, motion.speed_mps) * motion.yaw_rate_radps / speed
        driving = abs(motion.speed_mps) >= config.moving_mps
        self.curvature_per_m = min(max(curvature, -TIGHTEST_PER_M), TIGHTEST_PER_M) if driving else 0.0
        self.curvature_sigma_per_m = motion.yaw_rate_sigma_radps / speed if driving else 0.0
        self.stopping_m = stopping_m(motion.speed_mps, config)

    @property
    def left_m(self) -> float:
        """How far the swept outline reaches to the left of the origin's track; in a right turn the front swings out."""
        return self._reach_m(outer=self.curvature_per_m < -STRAIGHT_PER_M)

    @property
    def right_m(self) -> float:
        """The same to the right."""
        return self._reach_m(outer=self.curvature_per_m > STRAIGHT_PER_M)

    def _reach_m(self, *, outer: bool) -> float:
        half_m = self.config.width_m / 2
        if not outer:
            return half_m
        radius_m = 1.0 / abs(self.curvature_per_m)
        return math.hypot(radius_m + half_m, max(self.config.front_m, self.config.rear_m)) - radius_m

    def locate(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where points (N, 2) are along the path.

        Returns:
            ahead_m (N,): how far the vehicle drives until its front is level with the point; negative when it is
            abreast or behind. beside_m (N,): left of the origin's track.
        """
        x, y = points_m[:, 0], points_m[:, 1]
        if abs(self.curvature_per_m) < STRAIGHT_PER_M:
            return x - self.config.front_m, y
        radius_m = 1.0 / abs(self.curvature_per_m)
        side = math.copysign(1.0, self.curvature_per_m)
        to_centre = radius_m - side * y
        distance_m = np.hypot(x, to_centre)
        front_rad = np.arcsin(np.minimum(self.config.front_m / np.maximum(distance_m, 1e-9), 1.0))
        return radius_m * (np.arctan2(x, to_centre) - front_rad), side * (radius_m - distance_m)

    def towards(self, point_m: np.ndarray) -> np.ndarray:
        """(2,) direction from a place (2,) square to the middle of the way."""
        if abs(self.curvature_per_m) < STRAIGHT_PER_M:
            return np.array([0.0, -1.0 if point_m[1] > 0.0 else 1.0])
        to_centre = np.array([0.0, 1.0 / self.curvature_per_m]) - point_m
        distance_m = max(float(np.hypot(*to_centre)), 1e-9)
        outside = distance_m > 1.0 / abs(self.curvature_per_m)
        return np.asarray((to_centre if outside else -to_centre) / distance_m)

    def place(self, ahead_m: np.ndarray, beside_m: np.ndarray) -> np.ndarray:
        """(N, 2) points of given places along the path: the inverse of ``locate``."""
        if abs(self.curvature_per_m) < STRAIGHT_PER_M:
            return np.column_stack([ahead_m + self.config.front_m, beside_m])
        radius_m = 1.0 / abs(self.curvature_per_m)
        side = math.copysign(1.0, self.curvature_per_m)
        distance_m = radius_m - side * beside_m
        front_rad = np.arcsin(np.minimum(self.config.front_m / np.maximum(distance_m, 1e-9), 1.0))
        angle_rad = ahead_m / radius_m + front_rad
        return np.column_stack([distance_m * np.sin(angle_rad), side * (radius_m - distance_m * np.cos(angle_rad))])

    def spread_m(self, ahead_m: np.ndarray) -> np.ndarray:
        """(N,) standard deviation of where the path runs so far ahead, from that of the curvature."""
        along_m = np.maximum(ahead_m + self.config.front_m, 0.0)
        return 0.5 * self.curvature_sigma_per_m * along_m**2

    def contains(self, ahead_m: np.ndarray, beside_m: np.ndarray, sigma_m: np.ndarray | float = 0.0) -> np.ndarray:
        """(N,) bool: not behind the bumper, and within the swept outline, the side margin and ``sigma_m`` beyond it."""
        room_m = self.config.side_margin_m + sigma_m
        return (ahead_m >= 0.0) & (beside_m <= self.left_m + room_m) & (beside_m >= -self.right_m - room_m)

    def time_to_contact_s(
        self, point: MovingPoint, horizon_s: float, sigmas: float = 1.0, widest_m: float = math.inf
    ) -> float | None:
        """Seconds until the outline, widened by the side margin and ``sigmas`` of the uncertainty, holds the point.

        The uncertainty widens it by ``widest_m`` at the most: a poorly known object must not fill the whole plane.

        Both keep their velocities. Only sideways uncertainty widens it: a range that is not known well must not move
        the moment of contact. None = not within the horizon; 0 = it is inside already.
        """
        config, t = self.config, np.arange(0.0, horizon_s + STEP_S, STEP_S)
        turned, place = pose_after(self.motion, t)
        cos, sin = np.cos(turned), np.sin(turned)
        x, y = (point.position_m[:, None] + point.velocity_mps[:, None] * t) - place
        ahead, left = cos * x + sin * y - config.front_m, cos * y - sin * x
        across = np.stack([-sin, cos], axis=1)
        P = point.covariance
        spread = P[:2, :2] + t[:, None, None] * (P[:2, 2:] + P[2:, :2]) + (t**2)[:, None, None] * P[2:, 2:]
        variance = np.einsum("ti,tij,tj->t", across, spread, across)
        variance = variance + (0.5 * self.curvature_sigma_per_m * (self.motion.speed_mps * t) ** 2) ** 2
        doubt = np.minimum(sigmas * np.sqrt(np.maximum(variance, 0.0)), widest_m)
        half = config.width_m / 2 + config.side_margin_m + doubt
        length = config.front_m + config.rear_m
        inside = np.flatnonzero((ahead <= 0.0) & (ahead >= -length) & (np.abs(left) <= half))
        if not len(inside):
            return None
        first = int(inside[0])
        if first == 0 or ahead[first - 1] <= 0.0:
            return float(t[first])
        share = ahead[first - 1] / (ahead[first - 1] - ahead[first])
        return float(t[first - 1] + share * STEP_S)


def pose_after(motion: Motion, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heading (N,) and place (2, N) of the vehicle after so many seconds, in its frame of now."""
    turned = motion.yaw_rate_radps * t_s
    half = turned / 2
    chord_m = motion.speed_mps * t_s * np.sinc(half / np.pi)
    return turned, np.stack([chord_m * np.cos(half), chord_m * np.sin(half)])


def carried(points_m: np.ndarray, motion: Motion, t_s: np.ndarray) -> np.ndarray:
    """(N, 2) standing points as the vehicle sees them ``t_s`` (N,) seconds after each was measured."""
    turned, place = pose_after(motion, t_s)
    x, y = points_m.T - place
    return np.column_stack([np.cos(turned) * x + np.sin(turned) * y, np.cos(turned) * y - np.sin(turned) * x])
