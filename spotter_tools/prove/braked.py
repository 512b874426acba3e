"""The vehicle of the proving ground: it follows a planned motion and can be braked along the same path."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

from spotter_sim.motion import Motion, Pose
from spotter_tools.prove.case import Preset

_STEP_S = 0.01
_STANDS_MPS = 1e-6


@dataclass(frozen=True)
class Order:
    """The command to the actuator: the speed limit, and the deceleration down to it."""

    limit_mps: float
    brake_mps2: float


FREE = Order(math.inf, 0.0)


class Braked:
    """A motion that follows a plan and can be braked; past poses do not change.

    It runs through ``plan`` at a pace of 0 to 1: at pace 1 it moves as planned, at 0 it stands. So it always brakes
    along the planned path.
    """

    def __init__(self, plan: Motion, preset: Preset) -> None:
        self._plan, self._preset = plan, preset
        first = plan.at(0.0)
        self._times, self._phases, self._speeds = [0.0], [0.0], [_speed(first)]

    @property
    def now_s(self) -> float:
        """The time up to which the poses are calculated."""
        return self._times[-1]

    @property
    def speed_mps(self) -> float:
        """Present speed, without sign."""
        return self._speeds[-1]

    @property
    def planned_mps(self) -> float:
        """The speed of the plan at this place."""
        return _speed(self._plan.at(self._phases[-1]))

    def advance(self, to_s: float, order: Order) -> None:
        """Drive until ``to_s`` under one order."""
        while self.now_s < to_s - 1e-9:
            step_s = min(_STEP_S, to_s - self.now_s)
            planned = self.planned_mps
            speed = self._next_speed(planned, order, step_s)
            pace = 1.0 if planned < _STANDS_MPS else speed / planned
            self._times.append(self.now_s + step_s)
            self._phases.append(self._phases[-1] + pace * step_s)
            self._speeds.append(min(speed, _speed(self._plan.at(self._phases[-1]))))

    def _next_speed(self, planned: float, order: Order, step_s: float) -> float:
        now, goal = self.speed_mps, min(planned, order.limit_mps)
        if now > goal and order.limit_mps < planned:
            return max(goal, now - order.brake_mps2 * step_s)
        if now < goal:
            return min(goal, now + self._preset.accel_mps2 * step_s)
        return goal

    def at(self, t_s: float) -> Pose:
        """The pose at any past time; a little into the future at the speed of now."""
        i = min(max(bisect_right(self._times, t_s) - 1, 0), max(len(self._times) - 2, 0))
        if len(self._times) == 1:
            return self._plan.at(t_s)
        span_s = self._times[i + 1] - self._times[i]
        share = (t_s - self._times[i]) / span_s
        phase = self._phases[i] + share * (self._phases[i + 1] - self._phases[i])
        speed = self._speeds[i] + min(max(share, 0.0), 1.0) * (self._speeds[i + 1] - self._speeds[i])
        pose = self._plan.at(phase)
        planned = _speed(pose)
        pace = speed / planned if planned > _STANDS_MPS else 0.0
        return Pose(pose.x_m, pose.y_m, pose.yaw_rad, pace * pose.vx_mps, pace * pose.vy_mps, pose.travelled_m)


def _speed(pose: Pose) -> float:
    return math.hypot(pose.vx_mps, pose.vy_mps)
