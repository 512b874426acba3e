"""Measurements of one or more devices to how the vehicle moves, and that to a message: pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from common.messages import EgoMotion
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.gyro import GyroBias
from services.jetson.ego.measurement import Measurement
from services.jetson.ego.plausible import Limits, SignalCheck

STANDS_MPS = 0.02
SIGMA_MPS, SIGMA_RADPS = 0.05, 0.05  # of a device that does not say how well it measures
STEERING_RAD, STEERING_RADPS, BATTERY_V = 1.6, 100.0, 1000.0  # more is nonsense on any vehicle
SIMULATED = "simulated"


class Motion(NamedTuple):
    """How the vehicle moves; None = not measured. ``reason``: what is wrong with a device, empty when all is well."""

    speed_mps: float | None
    yaw_rate_radps: float | None
    T_map_vehicle: np.ndarray | None = None  # (4, 4) rigid
    speed_sigma_mps: float | None = None
    yaw_rate_sigma_radps: float | None = None
    steering_rad: float | None = None
    battery_v: float | None = None
    speed_origin: str = SIMULATED
    yaw_rate_origin: str = SIMULATED
    reason: str = ""


class Value(NamedTuple):
    """The newest good value of a signal."""

    at_s: float
    value: float
    sigma: float | None
    origin: str


class Odometer:
    """``take`` every measurement, ask for ``motion`` as often as wanted.

    Args:
        config: limits of what can be true.
        origins: the devices, the preferred ones first.
    """

    def __init__(self, config: EgoConfig, origins: Sequence[str]) -> None:
        self._config, self._origins = config, tuple(origins)
        self._values: dict[tuple[str, str], Value] = {}  # by (signal, origin)
        self._checks: dict[tuple[str, str], SignalCheck] = {}
        self._faults: dict[str, str] = {}  # by origin: the newest value could not be used
        self._heard_s: dict[str, float] = {}
        self._bias = GyroBias()

    def take(self, one: Measurement) -> list[str]:
        """Accept what can be true; returns the names of what is wrong with the rest."""
        self._heard_s[one.origin] = one.at_s
        speed = self._checked("speed", one, one.speed_mps)
        turn = self._checked("yaw_rate", one, one.yaw_rate_radps)
        steering = self._checked("steering", one, one.steering_rad)
        battery = self._checked("battery", one, one.battery_v)
        faults = [fault for fault in (speed, turn, steering, battery) if fault]
        if faults:
            self._faults[one.origin] = faults[0]
        else:
            self._faults.pop(one.origin, None)
        return faults

    def motion(self, now_s: float, lost: Mapping[str, str]) -> Motion:
        """The motion at ``now_s``; ``lost`` says by origin why a device cannot be read."""
        speed, turn = self._newest("speed", now_s), self._newest("yaw_rate", now_s)
        steering, battery = self._newest("steering", now_s), self._newest("battery", now_s)
        return Motion(
            speed_mps=speed.value if speed else None,
            yaw_rate_radps=turn.value if turn else None,
            speed_sigma_mps=(SIGMA_MPS if speed.sigma is None else speed.sigma) if speed else None,
            yaw_rate_sigma_radps=(SIGMA_RADPS if turn.sigma is None else turn.sigma) if turn else None,
            steering_rad=steering.value if steering else None,
            battery_v=battery.value if battery else None,
            speed_origin=speed.origin if speed else "",
            yaw_rate_origin=turn.origin if turn else "",
            reason=self._reason(now_s, lost),
        )

    def _checked(self, signal: str, one: Measurement, value: float | None) -> str:
        """Keep a good value; the name of the fault of a bad one."""
        if value is None:
            return ""
        key = (signal, one.origin)
        if key not in self._checks:
            self._checks[key] = SignalCheck(self._limits(signal, one.origin))
        fault = self._checks[key].fault(one.at_s, value)
        if fault:
            if fault == "stuck":
                self._values.pop(key, None)
            return f"{one.origin} {signal} {fault}"
        self._values[key] = self._value(signal, one, value)
        return ""

    def _value(self, signal: str, one: Measurement, value: float) -> Value:
        if signal == "yaw_rate" and one.origin == "imu":
            speed = self._newest("speed", one.at_s)
            standing = None if speed is None else abs(speed.value) < STANDS_MPS
            value, sigma = self._bias.correct(one.at_s, value, standing=standing)
            return Value(one.at_s, value, sigma, one.origin)
        sigmas = {"speed": one.speed_sigma_mps, "yaw_rate": one.yaw_rate_sigma_radps}
        return Value(one.at_s, value, sigmas.get(signal), one.origin)

    def _limits(self, signal: str, origin: str) -> Limits:
        limits = self._config.limits
        match signal:
            case "speed":  # an encoder turns edges into speed, and those have no value to be stuck at
                stuck_s = float("inf") if origin == "encoder" else limits.stuck_s
                return Limits(limits.max_speed_mps, limits.max_acceleration_mps2, stuck_s, tolerance=0.3)
            case "yaw_rate":
                rate = limits.max_yaw_acceleration_radps2
                return Limits(limits.max_yaw_rate_radps, rate, limits.stuck_s, noisy=origin == "imu", tolerance=0.3)
            case "steering":
                return Limits(STEERING_RAD, STEERING_RADPS, float("inf"), tolerance=0.3)
        return Limits(BATTERY_V, 1e6, float("inf"))

    def _newest(self, signal: str, now_s: float) -> Value | None:
        """Of the first device in order that has one that is fresh."""
        for origin in self._origins:
            value = self._values.get((signal, origin))
            if value is not None and now_s - value.at_s <= self._config.limits.stale_s:
                return value
        return None

    def _reason(self, now_s: float, lost: Mapping[str, str]) -> str:
        reasons = []
        for origin in self._origins:
            heard_s = self._heard_s.get(origin)
            if origin in lost:
                reasons.append(lost[origin])
            elif heard_s is None:
                reasons.append(f"{origin}: no data yet")
            elif now_s - heard_s > self._config.limits.stale_s:
                reasons.append(f"{origin}: silent for {now_s - heard_s:.1f} s, the device is there")
            elif origin in self._faults:
                reasons.append(f"{self._faults[origin]}: not used")
        return "; ".join(reasons)


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
            state="degraded" if motion.reason else "online",
            reason=motion.reason,
            speed_mps=motion.speed_mps,
            yaw_rate_radps=motion.yaw_rate_radps,
            T_map_vehicle=None if pose is None else pose.tolist(),
            speed_sigma_mps=motion.speed_sigma_mps,
            yaw_rate_sigma_radps=motion.yaw_rate_sigma_radps,
            steering_rad=motion.steering_rad,
            battery_v=motion.battery_v,
            speed_origin=motion.speed_origin if motion.speed_mps is not None else "",
            yaw_rate_origin=motion.yaw_rate_origin if motion.yaw_rate_radps is not None else "",
        )
