"""The vehicle's own motion for a sensor that has to know it: the newest ``ego/motion``, aged by its stamp."""

from __future__ import annotations

import math

from common.bus.pubsub import Latest, Received
from common.clock import monotonic_s, utc_ns
from common.messages import EgoMotion, Motion
from common.path import YAW_UNKNOWN_RADPS, PathConfig
from common.topics import EGO_MOTION

FUTURE_S = 0.1  # a stamp farther ahead of our clock is no stamp
SPEED_SIGMA_MPS = 0.02  # where the source does not say how well it measures
YAW_RATE_SIGMA_RADPS = 0.02
STEERING_SIGMA_RADPS = 0.05  # of the yaw rate that a steering angle gives: tyres slip


class EgoWatch:
    """``now`` is asked once per measurement. ``latest`` is the subscription to EGO_MOTION of the vehicle's own host."""

    def __init__(self, latest: Latest[EgoMotion], config: PathConfig) -> None:
        self._latest, self._config = latest, config
        self._newest: Received[EgoMotion] | None = None

    def now(self) -> Motion | None:
        """How the vehicle moves; None = nobody tells, or what was told is too old."""
        for received in self._latest.take():
            self._newest = received
        return motion_at(self._newest, monotonic_s(), utc_ns(), self._config)


def motion_at(ego: Received[EgoMotion] | None, now_s: float, now_ns: int, config: PathConfig) -> Motion | None:
    """The motion while both its arrival and its stamp are fresh; None = unknown.

    A message of an hour ago that is sent again is not fresh. Pure.
    """
    limit_s = EGO_MOTION.age_limit_s or 0.0
    if ego is None or now_s - ego.arrived_s > limit_s:
        return None
    age_s = (now_ns - ego.message.stamp_ns) * 1e-9
    return motion_of(ego.message, config) if -FUTURE_S <= age_s <= limit_s else None


def motion_of(message: EgoMotion, config: PathConfig) -> Motion | None:
    """What a message says; None when it does not know the speed.

    Without a yaw rate that of the steering counts (single-track model without slip), without either a straight line
    that may as well be a gentle curve.
    """
    if message.speed_mps is None or message.state == "degraded":
        return None
    speed_sigma = SPEED_SIGMA_MPS if message.speed_sigma_mps is None else message.speed_sigma_mps
    told_sigma = message.yaw_rate_sigma_radps
    yaw_sigma = YAW_RATE_SIGMA_RADPS if told_sigma is None else told_sigma
    if message.yaw_rate_radps is not None:
        return Motion(message.speed_mps, message.yaw_rate_radps, speed_sigma, yaw_sigma)
    if message.steering_rad is not None:
        steering_rad = min(max(message.steering_rad, -1.2), 1.2)
        yaw_radps = message.speed_mps * math.tan(steering_rad) / config.wheelbase_m
        return Motion(message.speed_mps, yaw_radps, speed_sigma, max(yaw_sigma, STEERING_SIGMA_RADPS))
    return Motion(message.speed_mps, 0.0, speed_sigma, YAW_UNKNOWN_RADPS)
