"""Configuration of fusion. Every default is the one written down in ``fusion.toml``."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from common.config import Section, ServiceConfig
from common.path import PathConfig
from common.topics import CAMERA_CONFIRM_AGE_S, ONBOARD_SENSORS

HostName = Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")]
Seconds = Annotated[float, Meta(ge=0.0, le=60.0)]
Minutes = Annotated[float, Meta(ge=0.0, le=3600.0)]
Metres = Annotated[float, Meta(ge=0.0, le=500.0)]
Milliseconds = Annotated[float, Meta(ge=0.0, le=10_000.0)]


class SensorConfig(Section, frozen=True, kw_only=True):
    """One sensor that has to be there: a sensor that never appeared is disconnected, not unknown."""

    host: HostName
    expected: bool = True  # false: not fitted, so that neither bar nor floor counts it
    budget_ms: Milliseconds = 300.0  # measurement to verdict, 99th percentile; more is named in health


class SensorsConfig(Section, frozen=True, kw_only=True):
    """Where each sensor's service runs."""

    lidar: SensorConfig = SensorConfig(host="jetson0", budget_ms=250.0)
    radar: SensorConfig = SensorConfig(host="pi0", budget_ms=250.0)
    camera: SensorConfig = SensorConfig(host="jetson0", budget_ms=500.0)
    infra_lidar: SensorConfig = SensorConfig(host="infra0", budget_ms=500.0)

    def only(self, names: tuple[str, ...]) -> SensorsConfig:
        """The same for a vehicle on which no other sensor than these is fitted."""
        others = set(ONBOARD_SENSORS) - set(names)
        return msgspec.structs.replace(
            self, **{name: msgspec.structs.replace(getattr(self, name), expected=False) for name in others}
        )


class VehicleConfig(Section, frozen=True, kw_only=True):
    """Which hosts belong to fusion's own vehicle. ``spotter up`` fills it in from the site file."""

    name: str = ""
    hosts: tuple[HostName, ...] = ("jetson0", "pi0")
    roadside_hosts: tuple[HostName, ...] = ("infra0",)  # of no vehicle: their tracks only raise a verdict
    other_hosts: tuple[HostName, ...] = ()  # of other vehicles on the same bus: never listened to
    live_only: bool = False  # take no message that is recorded, emulated, simulated, or does not say what it is


class RulesConfig(Section, frozen=True, kw_only=True):
    """The numbers in the decision rules. As built here they are the written rules; the service's own default differs
    in one, ``suppression``.
    """

    suppression: Literal["off", "limited", "full"] = "limited"  # may an empty picture silence a lidar CAUTION?
    suppression_limit_s: Seconds = 1.0  # of continuous lidar detection, in "limited"
    suppression_closing_m: Metres = 0.10  # coming nearer by this much ends it at once
    suppression_refill_s: Minutes = 30.0  # the lidar clear for so long, then it may suppress anew
    confirm_age_s: Seconds = CAMERA_CONFIRM_AGE_S  # an older picture neither confirms nor suppresses
    looks_back: tuple[str, ...] = ()  # sensors that see behind the vehicle
    camera_may_raise: bool = True  # a confirmed alarm takes the worse of both bands
    clear_messages: Annotated[int, Meta(ge=1, le=100)] = 8  # in a row without the object before its alarm ends
    decay_s: Minutes = 10.0  # standing, its sensor out: an IMMINENT is a CAUTION after so long, and never less
    length_m: Metres = 0.6  # the vehicle, rear to front: a place farther behind is left behind
    half_width_m: Metres = 0.4  # the vehicle and some room: a place farther beside is off the way
    abreast: bool = True  # driving: no alarm for one echo of two things beside a way that the lidar sees free (R10)
    partial_mps: Annotated[float, Meta(gt=0.0, le=50.0)] = 1.0  # with no sensor that sees obstacles of every kind (V1)
    hidden_stop_s: Annotated[float, Meta(gt=0.0, le=10.0)] = 1.0  # to brake to rest past what may hide somebody (V1)
    coverage: Literal["off", "report", "floor"] = "floor"  # what was not seen: unsaid, said, or at least CAUTION (V1)


class HealthConfig(Section, frozen=True, kw_only=True):
    """When a sensor's state changes, and how often health is published."""

    start_s: Seconds = 10.0  # start-up waits so long for first messages; then a silent sensor is disconnected
    recovery_frames: Annotated[int, Meta(ge=1, le=100)] = 3  # good frames in a row before a sensor is online again
    flicker_frames: Annotated[int, Meta(ge=1, le=100)] = 20  # as many when two faults began within flicker_s
    flicker_s: Seconds = 4.0
    future_s: Seconds = 0.1  # a stamp this far ahead of our clock is a clock fault
    rate_window_s: Annotated[float, Meta(ge=0.5, le=60.0)] = 3.0
    verdict_period_s: Annotated[float, Meta(ge=0.005, le=0.05)] = 0.04  # at least this often, without any input
    health_period_s: Annotated[float, Meta(ge=0.05, le=0.5)] = 0.4


class ClocksConfig(Section, frozen=True, kw_only=True):
    """Offset between hosts, measured on the ``clock`` queryable."""

    period_s: Annotated[float, Meta(ge=0.1, le=60.0)] = 0.5
    max_bound_ms: Milliseconds = 100.0  # an offset that is known less well than this is not trusted
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
    own_error_m: Metres = 0.6  # how far beside our outline map and pose may put our own vehicle
    own_speed_mps: Annotated[float, Meta(ge=0.0, le=50.0)] = 0.5  # how far its motion may differ from ours
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
    expects: tuple[Annotated[str, Meta(pattern=r"^[a-z0-9_]+/[a-z0-9_]+$")], ...] = ()  # services that health misses
    store: str = ""  # folder where alarms are kept over a restart; empty = nowhere
    moving_mps: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.1  # slower counts as standing still
    vehicle: VehicleConfig = VehicleConfig()
    sensors: SensorsConfig = msgspec.field(default_factory=SensorsConfig)
    rules: RulesConfig = msgspec.field(default_factory=lambda: RulesConfig(suppression="off"))  # README, "Measured"
    health: HealthConfig = msgspec.field(default_factory=HealthConfig)
    clocks: ClocksConfig = msgspec.field(default_factory=ClocksConfig)
    path: PathConfig = PathConfig()
    roadside: RoadsideConfig = msgspec.field(default_factory=RoadsideConfig)

    def check(self) -> None:
        """Refuse a host outside the own vehicle; of the roadside only its lidar is allowed.

        Raises:
            ValueError: names key, value and the allowed hosts.
        """
        own, roadside = self.vehicle.hosts, self.vehicle.roadside_hosts
        sensors: dict[str, SensorConfig] = {
            name: getattr(self.sensors, name) for name in SensorsConfig.__struct_fields__
        }
        allowed = {
            "host": (self.host, own),
            "ego_host": (self.ego_host, own),
            **{
                f"[sensors.{name}] host": (sensor.host, (*own, *roadside) if name == "infra_lidar" else own)
                for name, sensor in sensors.items()
            },
        }
        whose = f"vehicle {self.vehicle.name!r}" if self.vehicle.name else "fusion's own vehicle"
        for key, (host, hosts) in allowed.items():
            if host not in hosts:
                raise ValueError(
                    f"{key} = {host!r}: not a host of {whose}; allowed: {', '.join(hosts) or 'none'} "
                    "(from [vehicle], which `spotter up` takes from the site file)"
                )
