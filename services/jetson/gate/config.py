"""Configuration of the gate. Every default is the one written down in ``gate.toml``."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from common.config import Section, ServiceConfig

Name = Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")]
Kind = Literal["live", "recorded", "emulated", "simulated"]
Seconds = Annotated[float, Meta(ge=0.0, le=60.0)]


class LimitsConfig(Section, frozen=True, kw_only=True):
    """When a verdict or the gate itself is too late. None may be longer than what the 0.3 s to STOP allow."""

    verdict_age_s: Annotated[float, Meta(gt=0.0, le=0.25)] = 0.25  # since fusion stamped it
    permit_s: Annotated[float, Meta(ge=0.05, le=0.25)] = 0.2  # a permission ends by itself at the actuator after this
    overrun_s: Annotated[float, Meta(ge=0.03, le=0.2)] = 0.1  # between two rounds of the gate's own loop
    future_s: Annotated[float, Meta(ge=0.0, le=0.25)] = 0.05  # a verdict stamped this far ahead is a clock fault


class ReleaseConfig(Section, frozen=True, kw_only=True):
    """What it takes to move again."""

    after_stop_s: Annotated[float, Meta(ge=0.1, le=60.0)] = 1.0  # of good verdicts without a break, after any STOP
    speed_up_s: Seconds = 0.5  # of GO without a break, before a speed limit is lifted
    # by a person, after every STOP, or only after one that was a fault (not fusion's own word) and at the start
    acknowledge: Literal["never", "after_fault", "after_stop"] = "never"


class SpeedConfig(Section, frozen=True, kw_only=True):
    """Speed limits that go out with the permission."""

    slow_mps: Annotated[float, Meta(ge=0.0, le=50.0)] = 0.5  # with SLOW
    keep_safe: bool = True  # while driving never more than the verdict's max_safe_speed_mps, whatever the permission
    go_mps: Annotated[float, Meta(ge=0.0, le=50.0)] = 5.0  # with GO: what the vehicle may do at all


class GateConfig(ServiceConfig, frozen=True, kw_only=True):
    """``services/jetson/gate``."""

    host: Name = "jetson0"
    fusion_host: Name = "jetson0"
    outputs: tuple[str, ...] = ()
    accept: tuple[Kind, ...] = ("live",)
    period_s: Annotated[float, Meta(ge=0.005, le=0.05)] = 0.02
    limits: LimitsConfig = LimitsConfig()
    release: ReleaseConfig = ReleaseConfig()
    speed: SpeedConfig = msgspec.field(default_factory=SpeedConfig)

    def check(self) -> None:
        """Refuse numbers that contradict each other.

        Raises:
            ValueError: names key, value and what is allowed.
        """
        if self.speed.slow_mps > self.speed.go_mps:
            raise ValueError(f"[speed] slow_mps = {self.speed.slow_mps}: expected at most go_mps = {self.speed.go_mps}")
        if self.limits.overrun_s < 2 * self.period_s:
            raise ValueError(
                f"[limits] overrun_s = {self.limits.overrun_s}: expected at least two periods of {self.period_s} s"
            )
