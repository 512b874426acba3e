"""What fusion can be told. Every default is the one written down in ``fusion.toml``."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from common.config import Section, ServiceConfig
from common.topics import CAMERA_CONFIRM_AGE_S

HostName = Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")]
Seconds = Annotated[float, Meta(ge=0.0, le=60.0)]
Metres = Annotated[float, Meta(ge=0.0, le=500.0)]
Milliseconds = Annotated[float, Meta(ge=0.0, le=10_000.0)]


class SensorConfig(Section, frozen=True, kw_only=True):
    """One sensor that has to be there: a sensor that never appeared is disconnected, not unknown."""

    host: HostName
    budget_ms: Milliseconds = 300.0  # measurement to verdict, 99th percentile; more is named in health


class SensorsConfig(Section, frozen=True, kw_only=True):
    """Where each sensor's service runs."""

    lidar: SensorConfig = SensorConfig(host="jetson0", budget_ms=250.0)
    radar: SensorConfig = SensorConfig(host="pi0", budget_ms=250.0)
    camera: SensorConfig = SensorConfig(host="jetson0", budget_ms=500.0)
    infra_lidar: SensorConfig = SensorConfig(host="infra0", budget_ms=500.0)


class RulesConfig(Section, frozen=True, kw_only=True):
    """The numbers in the decision rules."""

    suppression: Literal["off", "limited", "full"] = "limited"  # may an empty picture silence a lidar CAUTION?
    suppression_limit_s: Seconds = 1.0  # of continuous lidar detection, in "limited"
    suppression_closing_m: Metres = 0.10  # coming nearer by this much ends it at once
    confirm_age_s: Seconds = CAMERA_CONFIRM_AGE_S  # an older picture neither confirms nor suppresses
    camera_may_raise: bool = True  # a confirmed alarm takes the worse of both bands
    hold_s: Seconds = 0.5  # an alarm outlives the sensor that raised it by this long


class HealthConfig(Section, frozen=True, kw_only=True):
    """When a sensor's state changes, and how often health is told."""

    recovery_frames: Annotated[int, Meta(ge=1, le=100)] = 3  # good frames in a row before a sensor is online again
    future_s: Seconds = 0.1  # a stamp this far ahead of our clock is a clock fault
    rate_window_s: Annotated[float, Meta(ge=0.5, le=60.0)] = 3.0
    verdict_period_s: Annotated[float, Meta(ge=0.005, le=0.05)] = 0.04  # at least this often, without any input
    health_period_s: Annotated[float, Meta(ge=0.05, le=0.5)] = 0.4


class ClocksConfig(Section, frozen=True, kw_only=True):
    """Offset between hosts, measured on the ``clock`` queryable."""

    period_s: Annotated[float, Meta(ge=0.1, le=60.0)] = 0.5
    max_bound_ms: Milliseconds = 50.0  # a wider bound is no measurement
    max_age_s: Seconds = 10.0  # without a new measurement the bound is lost
    drift_ppm: Annotated[float, Meta(ge=0.0, le=1000.0)] = 50.0  # how fast two quartz clocks may part
    step_ms: Milliseconds = 20.0  # our own clock moving this much against the monotonic one is a step
    settle_samples: Annotated[int, Meta(ge=1, le=20)] = 3  # agreeing measurements after a step


class RoadsideConfig(Section, frozen=True, kw_only=True):
    """Tracks of the lidar on the pole as a further witness: they raise a verdict, they never lower one."""

    enabled: bool = False
    pose_x_m: Annotated[float, Meta(ge=-1e5, le=1e5)] = 0.0  # the vehicle in the map when ego/motion has no pose
    pose_y_m: Annotated[float, Meta(ge=-1e5, le=1e5)] = 0.0
    pose_yaw_rad: Annotated[float, Meta(ge=-6.3, le=6.3)] = 0.0
    front_m: Metres = 0.3  # of the vehicle's outline, from its origin
    rear_m: Metres = 0.3
    half_width_m: Metres = 0.4
    sigmas: Annotated[float, Meta(ge=0.0, le=5.0)] = 1.0  # how much of the track's uncertainty widens the outline
    min_speed_mps: Annotated[float, Meta(ge=0.0, le=50.0)] = 0.3  # of the object relative to the vehicle
    caution_ttc_s: Seconds = 3.0
    imminent_ttc_s: Seconds = 1.5
    raise_messages: Annotated[int, Meta(ge=1, le=50)] = 3  # in a row before a level is raised
    clear_messages: Annotated[int, Meta(ge=1, le=50)] = 4  # in a row before it is lowered again
    acceleration_mps2: Annotated[float, Meta(ge=0.0, le=20.0)] = 2.0  # process noise while compensating latency


class FusionConfig(ServiceConfig, frozen=True, kw_only=True):
    """``services/jetson/fusion``."""

    host: HostName = "jetson0"
    ego_host: HostName = "jetson0"
    moving_mps: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.1  # slower counts as standing still
    sensors: SensorsConfig = msgspec.field(default_factory=SensorsConfig)
    rules: RulesConfig = msgspec.field(default_factory=RulesConfig)
    health: HealthConfig = msgspec.field(default_factory=HealthConfig)
    clocks: ClocksConfig = msgspec.field(default_factory=ClocksConfig)
    roadside: RoadsideConfig = msgspec.field(default_factory=RoadsideConfig)
