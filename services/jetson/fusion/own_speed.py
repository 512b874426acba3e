"""Whether the vehicle moves: the measured motion first, beside it what the radar's standing echoes say."""

from __future__ import annotations

import math

from common.bus.pubsub import Received
from common.messages import EgoMotion
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.dating import SenderClock
from services.jetson.fusion.vehicle import EgoWatch, Vehicle

APART_MPS = 0.3  # less is tyres, slip and curves
APART_S = 1.0  # for so long without a break before anybody is told
SIGMAS = 3.0


class OwnSpeed:
    """Takes the radar's estimate; ``judge`` lays it beside the measured motion.

    Nothing measured: the radar says whether the vehicle moves; its speed is too coarse and too seldom for more. Both,
    and for a while they disagree: ``note`` says so, and a vehicle that is measured as standing is not known to stand.
    """

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._radar = EgoWatch(config)
        self._newest: EgoMotion | None = None
        self._apart_since_s: float | None = None
        self.note = ""

    def take(self, received: Received[EgoMotion], clock: SenderClock) -> str:
        """Accept the radar's message; or say why not."""
        refused = self._radar.take(received, clock)
        if not refused:
            self._newest = received.message
        return refused

    def judge(self, now_s: float, measured: Vehicle) -> Vehicle:
        """The vehicle's motion as far as it is known at ``now_s``."""
        radar = self._radar.now(now_s)
        if radar.speed_mps is None:
            self._apart_since_s, self.note = None, ""
            return measured
        if measured.speed_mps is None:
            self._apart_since_s, self.note = None, ""
            return measured._replace(moving=radar.moving, source_kind=radar.source_kind)
        if not self._apart_for_long(now_s, measured.speed_mps, radar.speed_mps):
            return measured
        self.note = (
            f"own speed: measured {measured.speed_mps:.2f} m/s, the radar's standing echoes say "
            f"{radar.speed_mps:.2f} m/s; is the odometry plugged in, are the wheels slipping?"
        )
        return measured._replace(moving=None) if radar.moving and not measured.moving else measured

    def _apart_for_long(self, now_s: float, measured_mps: float, radar_mps: float) -> bool:
        sigma_mps = (self._newest.speed_sigma_mps if self._newest else None) or 0.0
        if abs(measured_mps - radar_mps) <= math.hypot(APART_MPS, SIGMAS * sigma_mps):
            self._apart_since_s, self.note = None, ""
            return False
        self._apart_since_s = now_s if self._apart_since_s is None else self._apart_since_s
        return now_s - self._apart_since_s >= APART_S
