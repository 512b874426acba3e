"""The building blocks of every message: bounded scalars, levels and states, the header, the check of a shape."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

Level = Literal["SAFE", "CAUTION", "IMMINENT"]
LEVELS: tuple[Level, ...] = ("SAFE", "CAUTION", "IMMINENT")
SensorState = Literal["online", "degraded", "disconnected"]
SelfReport = Literal["online", "degraded"]
SourceKind = Literal["live", "recorded", "emulated", "simulated", "unknown"]  # from the most to the least trusted
SOURCE_KINDS: tuple[SourceKind, ...] = ("live", "recorded", "emulated", "simulated", "unknown")
ServiceState = Literal["starting", "online", "degraded", "disconnected"]

Finite = Annotated[float, Meta(ge=-1e12, le=1e12)]  # NaN and infinity fail both comparisons
Milliseconds = Annotated[float, Meta(ge=-1e15, le=1e15)]  # a clock that begins in 1970 is 1.8e12 ms behind
NotNegative = Annotated[float, Meta(ge=0.0, le=1e12)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Count = Annotated[int, Meta(ge=0)]
Text = Annotated[str, Meta(max_length=2000)]
Name = Annotated[str, Meta(max_length=100)]
Vector3 = tuple[Finite, Finite, Finite]
Matrix6 = Annotated[
    list[Annotated[list[Finite], Meta(min_length=6, max_length=6)]],
    Meta(min_length=6, max_length=6),
]
Matrix4 = Annotated[
    list[Annotated[list[Finite], Meta(min_length=4, max_length=4)]],
    Meta(min_length=4, max_length=4),
]
StageMs = dict[Name, Milliseconds]

MAX_OBJECTS = 2000


def worst(*levels: Level) -> Level:
    """The most serious of the levels; SAFE of none."""
    return max(levels, key=LEVELS.index, default="SAFE")


def least_live(kinds: Iterable[SourceKind]) -> SourceKind:
    """What a thing is that rests on all of these: "live" only if nothing else is among them, "unknown" of none."""
    return max(kinds, key=SOURCE_KINDS.index, default="unknown")


def check_shape(owner: object, name: str, value: np.ndarray, *shape: int | None) -> None:
    """Raise ``ValueError`` unless ``value`` has this shape; ``None`` stands for any length."""
    fits = value.ndim == len(shape) and all(
        want is None or want == got for want, got in zip(shape, value.shape, strict=True)
    )
    if not fits:
        expected = "(" + ", ".join("N" if want is None else str(want) for want in shape) + ")"
        raise ValueError(f"{type(owner).__name__}.{name}: expected shape {expected}, got {value.shape}")


class Message(msgspec.Struct, kw_only=True):
    """The header of every message. The publisher fills in ``seq``, ``sent_ns`` and, of a service with a source,
    ``source_kind``.
    """

    stamp_ns: Count  # UTC ns of the measurement, read where the device is read
    seq: Count = 0  # counts this topic's messages since the process started
    frame_id: Name = ""
    received_ns: Count = 0  # UTC ns when the measurement was complete in the service (0 = unknown)
    sent_ns: Count = 0  # UTC ns when the message was handed to the network
    source_kind: SourceKind = "unknown"  # where it comes from in the end; what rests on several has the least live


class SensorMessage(Message, kw_only=True):
    """A sensor's data with the sensor's own state: whether it can see."""

    state: SelfReport = "online"
    reason: Text = ""  # why it is degraded; for a person
    stage_ms: StageMs = {}


class Motion(msgspec.Struct, frozen=True):
    """How the vehicle moves, with standard deviations. Speed is forward, negative in reverse; yaw rate is left."""

    speed_mps: Finite
    yaw_rate_radps: Finite = 0.0
    speed_sigma_mps: NotNegative = 0.02
    yaw_rate_sigma_radps: NotNegative = 0.02

    def straight(self) -> Motion:
        """The same without its turn."""
        return Motion(self.speed_mps, 0.0, self.speed_sigma_mps, self.yaw_rate_sigma_radps)


class Cover(msgspec.Struct, kw_only=True):
    """Where a sensor could have seen an obstacle at this moment: sectors around its place, vehicle's frame.

    Sector i reaches from ``first_rad + i * step_rad`` counter-clockwise to the next one.
    """

    x_m: Finite
    y_m: Finite
    first_rad: Finite
    step_rad: NotNegative
    far_m: list[NotNegative]  # how far it could have seen in each sector; 0 = not at all
    near_m: NotNegative = 0.0  # nearer than this it sees nothing
    standing: bool = True  # what stands too; False = only what moves over ground
    only: Text = ""  # the obstacles it sees where it sees not all, such as "what crosses its plane"
    why: Text = ""  # the reason for a part in which it sees less than it should
