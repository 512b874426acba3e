"""A measured motion to a message: pure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.messages import EgoMotion
from services.jetson.ego.config import EgoConfig


class Motion(NamedTuple):
    """How the vehicle moves; None = not measured."""

    speed_mps: float | None
    yaw_rate_radps: float | None
    T_map_vehicle: np.ndarray | None  # (4, 4) rigid


class EgoPipeline:
    """Odometry to EgoMotion."""

    def __init__(self, config: EgoConfig) -> None:
        self._config = config

    def process(self, stamp_ns: int, motion: Motion) -> EgoMotion:
        """The message for one measurement at ``stamp_ns`` (UTC)."""
        pose = motion.T_map_vehicle if self._config.has_pose else None
        return EgoMotion(
            stamp_ns=stamp_ns,
            frame_id="map",
            received_ns=stamp_ns,
            speed_mps=motion.speed_mps,
            yaw_rate_radps=motion.yaw_rate_radps,
            T_map_vehicle=None if pose is None else pose.tolist(),
        )
