"""What a wheel encoder and a gyroscope on the simulated vehicle say: the true motion, with their errors.

A standing vehicle gives no pulse and its gyroscope is zeroed: exactly zero.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spotter_sim.model import WorldState, noise_rng

SPEED_SCALE = 1.01  # tyres wear: the circumference is one per cent off
SPEED_NOISE_MPS, SPEED_STEP_MPS = 0.01, 0.005  # and pulses are counted
YAW_RATE_NOISE_RADPS, YAW_RATE_BIAS_RADPS = 0.01, 0.004
STANDS_MPS = 0.01  # slower gives no pulse within the encoder's time-out


class Odometry(NamedTuple):
    """As measured, with what a calibrated device would state as its standard deviation."""

    speed_mps: float
    yaw_rate_radps: float
    T_map_vehicle: np.ndarray  # (4, 4); exact: where a vehicle knows its pose, it is not from its wheels alone
    speed_sigma_mps: float
    yaw_rate_sigma_radps: float


def measure(world: WorldState) -> Odometry:
    """The measurement of this moment: a pure function of scenario and time."""
    speed, turn = world.vehicle_speed_mps, world.vehicle_yaw_rate_radps
    if not world.drives or (abs(speed) < STANDS_MPS and abs(turn) < STANDS_MPS):
        return Odometry(0.0, 0.0, world.T_map_vehicle, STANDS_MPS, YAW_RATE_NOISE_RADPS)
    rng = noise_rng(world.scenario, world.t_s, "odometry")
    noisy = SPEED_SCALE * speed + SPEED_NOISE_MPS * rng.standard_normal()
    counted = SPEED_STEP_MPS * round(noisy / SPEED_STEP_MPS)
    turning = turn + YAW_RATE_BIAS_RADPS + YAW_RATE_NOISE_RADPS * rng.standard_normal()
    scale_mps = (SPEED_SCALE - 1.0) * abs(speed)
    speed_sigma_mps = math.hypot(scale_mps, SPEED_NOISE_MPS, SPEED_STEP_MPS / math.sqrt(12.0))
    turn_sigma_radps = math.hypot(YAW_RATE_BIAS_RADPS, YAW_RATE_NOISE_RADPS)
    return Odometry(counted, float(turning), world.T_map_vehicle, speed_sigma_mps, turn_sigma_radps)
