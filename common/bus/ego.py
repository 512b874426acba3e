"""The vehicle's own motion for sensor services that need it: the newest ``ego/motion``, if it is not too old."""

from __future__ import annotations

import math

from common.bus.pubsub import Latest, Received
from common.clock import monotonic_s, utc_ns
from common.messages import EgoMotion, Motion
from common.path import YAW_UNKNOWN_RADPS, PathConfig
from common.topics import EGO_MOTION

FUTURE_S = 0.1  # a stamp farther ahead of our clock is rejected
SPEED_SIGMA_MPS = 0.02  # where the source does not say how well it measures
YAW_RATE_SIGMA_RADPS = 0.02
STEERING_SIGMA_RADPS = 0.05  # of the yaw rate that a steering angle gives: tyres slip


class EgoWatch:
    """Call ``now`` once per measurement. ``latest`` is the subscription to EGO_MOTION of the vehicle's own host."""

    def __init__(self, latest: Latest[EgoMotion], config: PathConfig) -> None:
        self._latest, self._config = latest, config
        self._newest: Received[EgoMotion] | None = None

    def now(self) -> Motion | None:
        """The motion of the vehicle; None: no motion message, or too old."""
        for received in self._latest.take():
            self._newest = received
        return motion_at(self._newest, monotonic_s(), utc_ns(), self._config)


def motion_at(ego: Received[EgoMotion] | None, now_s: float, now_ns: int, config: PathConfig) -> Motion | None:
    """The motion while both its arrival and its stamp are fresh; None = unknown.

    An old message that is re-sent is rejected by its stamp. Pure.
    """
    limit_s = EGO_MOTION.age_limit_s or 0.0
    if ego is None or now_s - ego.arrived_s > limit_s:
        return None
    age_s = (now_ns - ego.message.stamp_ns) * 1e-9
    return motion_of(ego.message, config) if -FUTURE_S <= age_s <= limit_s else None


def motion_of(message: EgoMotion, config: PathConfig) -> Motion | None:
    """The motion in a message; None if it has no speed.

    Without a yaw rate, it is calculated from the steering angle (single-track model without slip). Without either, the
    yaw rate is 0 with a large standard deviation.
    """
    if message.speed_mps is None or message.state == "degraded":
        return None
    speed_sigma = SPEED_SIGMA_MPS if message.speed_sigma_mps is None else message.speed_sigma_mps
    sent_sigma = message.yaw_rate_sigma_radps
    yaw_sigma = YAW_RATE_SIGMA_RADPS if sent_sigma is None else sent_sigma
    if message.yaw_rate_radps is not None:
        return Motion(message.speed_mps, message.yaw_rate_radps, speed_sigma, yaw_sigma)
    if message.steering_rad is not None:
        steering_rad = min(max(message.steering_rad, -1.2), 1.2)
        yaw_radps = message.speed_mps * math.tan(steering_rad) / config.wheelbase_m
        return Motion(message.speed_mps, yaw_radps, speed_sigma, max(yaw_sigma, STEERING_SIGMA_RADPS))
    return Motion(message.speed_mps, 0.0, speed_sigma, YAW_UNKNOWN_RADPS)
