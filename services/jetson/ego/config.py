"""Configuration of the vehicle's own motion. Every default is the one written down in ``ego.toml``."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from common.config import Section, ServiceConfig

Seconds = Annotated[float, Meta(gt=0.0, le=60.0)]


class LimitsConfig(Section, frozen=True, kw_only=True):
    """What cannot be true of this vehicle, and when a value is too old."""

    max_speed_mps: Annotated[float, Meta(gt=0.0, le=100.0)] = 15.0
    max_yaw_rate_radps: Annotated[float, Meta(gt=0.0, le=50.0)] = 8.0
    max_acceleration_mps2: Annotated[float, Meta(gt=0.0, le=1000.0)] = 30.0  # more is a jump
    max_yaw_acceleration_radps2: Annotated[float, Meta(gt=0.0, le=5000.0)] = 200.0
    stuck_s: Seconds = 3.0  # the same value for longer is a stuck one; zero speed is not
    stale_s: Seconds = 0.3  # a value that is older is unknown


class EncoderConfig(Section, frozen=True, kw_only=True):
    """``gpio:``: a wheel encoder."""

    pulses_per_m: Annotated[float, Meta(gt=0.0, le=1e6)] = 100.0  # of one channel; count them over ten metres
    zero_after_s: Seconds = 0.5  # without a pulse: the vehicle stands
    window_s: Seconds = 0.1  # the speed is the mean over this
    max_speed_mps: Annotated[float, Meta(gt=0.0, le=100.0)] = 15.0  # edges that come faster are contact bounce
    scale_error: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.03  # of the speed: tyres, slip


class VescConfig(Section, frozen=True, kw_only=True):
    """``vesc:``: the motor controller."""

    erpm_per_mps: Annotated[float, Meta(gt=0.0, le=1e6)] = 4600.0  # electrical rpm at 1 m/s: measure it
    period_s: Annotated[float, Meta(ge=0.005, le=1.0)] = 0.02  # between two questions


class CanConfig(Section, frozen=True, kw_only=True):
    """``can:``: signals as ``Message.Signal`` of a DBC file; empty = not there."""

    dbc: str = ""
    interface: str = "socketcan"  # of python-can
    speed: str = ""
    yaw_rate: str = ""
    steering: str = ""
    battery: str = ""


class ImuConfig(Section, frozen=True, kw_only=True):
    """``imu:``: how the chip is mounted."""

    axis: Literal["x", "y", "z"] = "z"  # the chip's axis that points up or down
    sign: Literal[1, -1] = 1  # 1 = it points up: turning left is positive


class EgoConfig(ServiceConfig, frozen=True, kw_only=True):
    """``services/jetson/ego``."""

    host: Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"
    rate_hz: Annotated[float, Meta(ge=1.0, le=200.0)] = 20.0
    has_pose: bool = True  # publish where the vehicle is in the map, not only how it moves
    limits: LimitsConfig = msgspec.field(default_factory=LimitsConfig)
    encoder: EncoderConfig = msgspec.field(default_factory=EncoderConfig)
    vesc: VescConfig = msgspec.field(default_factory=VescConfig)
    can: CanConfig = msgspec.field(default_factory=CanConfig)
    imu: ImuConfig = msgspec.field(default_factory=ImuConfig)

    def check(self) -> None:
        """Refuse a CAN bus of which nothing is known. Raises ``ValueError``."""
        if any(part.strip().startswith("can:") for part in self.source.split("+")) and not self.can.dbc:
            raise ValueError("[can] dbc = '': expected the file with the bus's signals, e.g. dbc = \"car.dbc\"")
