"""What one device says of the vehicle's motion at one moment."""

from __future__ import annotations

from typing import NamedTuple


class Measurement(NamedTuple):
    """None = this device does not measure it. Speed forward along x, yaw rate and steering left positive."""

    at_s: float  # monotonic
    origin: str  # "encoder", "serial", "vesc", "can", "imu", "odometry"
    speed_mps: float | None = None
    yaw_rate_radps: float | None = None
    steering_rad: float | None = None
    battery_v: float | None = None
    speed_sigma_mps: float | None = None
    yaw_rate_sigma_radps: float | None = None


class Rejected(NamedTuple):
    """Input that is no measurement: counted under ``what``."""

    origin: str
    what: str
