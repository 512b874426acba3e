"""What is known of the vehicle's own motion; older than the topic's age limit, by its stamp, is unknown."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from common.bus.pubsub import Received
from common.geometry import invert, pose_2d
from common.messages import EgoMotion, SourceKind
from common.topics import EGO_MOTION
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.dating import Age, SenderClock, age_of
from services.jetson.fusion.ordering import Ordering

LIMIT_S = EGO_MOTION.age_limit_s or 0.5
RIGID_TOLERANCE = 1e-3
POSES_S = 1.0  # over which the motion is taken from the poses


class Moved(NamedTuple):
    """How the vehicle has moved by its last poses; good enough to place things, too rough to say that it stands."""

    speed_mps: float
    yaw_rate_radps: float


class Vehicle(NamedTuple):
    """None = unknown."""

    moving: bool | None
    speed_mps: float | None
    yaw_rate_radps: float | None
    T_map_vehicle: np.ndarray | None
    source_kind: SourceKind | None = None  # None = nobody tells how it moves
    moved: Moved | None = None  # by its poses
    is_configured: bool = True  # its pose is the configured one, of a vehicle that stands

    @property
    def ground_motion_is_known(self) -> bool:
        """False while poses come, no speed with them, and not enough of them yet."""
        return self.speed_mps is not None or self.moved is not None or self.is_configured

    @property
    def ground_speed_mps(self) -> float:
        """The speed for geometry: measured, else by the poses, else standing."""
        if self.speed_mps is not None:
            return self.speed_mps
        return self.moved.speed_mps if self.moved else 0.0

    @property
    def ground_yaw_rate_radps(self) -> float:
        """The yaw rate for geometry: measured, else by the poses, else none."""
        if self.yaw_rate_radps is not None:
            return self.yaw_rate_radps
        return self.moved.yaw_rate_radps if self.moved else 0.0


class EgoWatch:
    """Follows ``ego/motion``: ``take`` every message, ask for ``now`` as often as needed."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._ordering = Ordering(LIMIT_S)
        self._newest: EgoMotion | None = None
        self._age = Age(0.0, 0.0)
        self._pose: np.ndarray | None = None  # of the newest message
        self._poses: deque[tuple[float, np.ndarray]] = deque()  # seconds by their stamps, oldest first
        roadside = config.roadside
        self._configured = pose_2d(roadside.pose_x_m, roadside.pose_y_m, roadside.pose_yaw_rad)

    def take(self, received: Received[EgoMotion], clock: SenderClock) -> str:
        """Accept a message; or say why not: a repetition, or older than what we have."""
        refused = self._ordering.check(received, "")
        if not refused:
            message = received.message
            self._newest, self._age = message, age_of(received, clock)
            self._pose = None if message.T_map_vehicle is None else rigid(np.array(message.T_map_vehicle, float))
            self._note_pose(message.stamp_ns * 1e-9)
        return refused

    def now(self, now_s: float) -> Vehicle:
        """From the newest message while it is fresh by its stamp; without a pose in it, the configured one counts."""
        message = self._newest
        if message is None:
            return Vehicle(None, None, None, self._configured)
        in_time = self._age.at_most(now_s) <= LIMIT_S and self._age.at_arrival_s >= -self._config.health.future_s
        if not in_time:
            return Vehicle(None, None, None, self._configured if message.T_map_vehicle is None else None)
        moving = None if message.speed_mps is None else abs(message.speed_mps) >= self._config.moving_mps
        pose = self._configured if message.T_map_vehicle is None else self._pose
        moved, is_configured = moved_by(self._poses), message.T_map_vehicle is None
        known = (moving, message.speed_mps, message.yaw_rate_radps, pose, message.source_kind)
        return Vehicle(*known, moved, is_configured)

    def _note_pose(self, at_s: float) -> None:
        if self._poses and not 0.0 < at_s - self._poses[-1][0] <= LIMIT_S:
            self._poses.clear()  # a gap, or their clock stepped
        if self._pose is not None:
            self._poses.append((at_s, self._pose))
        while self._poses and at_s - self._poses[0][0] > POSES_S:
            self._poses.popleft()


def moved_by(poses: Sequence[tuple[float, np.ndarray]]) -> Moved | None:
    """From the oldest to the newest (second, T_map_vehicle); None where they are too close in time for their noise."""
    if len(poses) < 2 or poses[-1][0] - poses[0][0] < POSES_S / 2:
        return None
    (begin_s, begin), (end_s, end) = poses[0], poses[-1]
    between = invert(begin) @ end
    turned_rad = math.atan2(between[1, 0], between[0, 0])
    chord_m = between[0, 3] * math.cos(turned_rad / 2) + between[1, 3] * math.sin(turned_rad / 2)
    arc_m = chord_m / float(np.sinc(turned_rad / (2 * math.pi)))
    return Moved(arc_m / (end_s - begin_s), turned_rad / (end_s - begin_s))


def rigid(T: np.ndarray) -> np.ndarray | None:
    """The transform when it is a rotation and a translation; None when it is anything else."""
    orthogonal = np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=RIGID_TOLERANCE)
    proper = bool(np.linalg.det(T[:3, :3]) > 0.0) and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0])
    return T if orthogonal and proper else None
