"""The values the verdict is made from: what each sensor says now, and what the last verdict remembered.

A ``Sighting`` is one object in one message. A ``Claim`` is an alarm about a place: it is made by a sighting and lives
on until it is ended by evidence (``claims.py``). A ``Demand`` is what a rule asks of the verdict.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

from common.messages import LEVELS, Level, SensorState, SourceKind
from services.jetson.fusion.coverage import Coverage

RANK: dict[Level | None, int] = {None: LEVELS.index("SAFE"), **{level: LEVELS.index(level) for level in LEVELS}}


class Place(NamedTuple):
    """A circle on the ground in the vehicle's frame: x ahead of the vehicle's front, y to the left."""

    x_m: float
    y_m: float
    radius_m: float


class Sighting(NamedTuple):
    """One object in a sensor's message. ``key`` tells it from the sensor's other objects when the sensor does."""

    level: Level
    place: Place | None = None  # None = somewhere ahead
    what: str = ""  # for people: the zone, the label or the track
    key: str = ""


class Abreast(NamedTuple):
    """The radar's alarms without those that the lidar shows as two things beside the way (``abreast.py``)."""

    level: Level  # of what is left
    sightings: tuple[Sighting, ...]  # what is left
    aside_level: Level  # the worst of what is set aside ...
    aside_m: float  # ... and its distance


@dataclass(frozen=True, slots=True)
class SensorInput:
    """What one sensor says now. ``level`` None = nothing detected; ``age_s`` None = never seen."""

    state: SensorState
    level: Level | None
    age_s: float | None = None
    static_level: Level | None = None  # radar: what its standing tracks would say
    nearest_m: float | None = None  # distance of the object behind the level
    reason: str = ""  # why it is not online
    stamp_ns: int = 0  # UTC of the measurement; 0 = none
    stage_ms: dict[str, float] = field(default_factory=dict)  # where the age comes from
    deciding: dict[str, Any] | None = None  # the object or zone behind the level
    source_kind: SourceKind = "unknown"  # of its newest message
    fitted: bool = True  # False: the vehicle has none, so that nobody misses it
    sightings: tuple[Sighting, ...] = ()  # every object that alarms; of the camera every one in the forward zone
    raw_level: Level | None = None  # of this message alone, where the sensor counts several before it says a level


@dataclass(frozen=True)
class FusionInputs:
    """Everything the verdict depends on. ``moving`` and the speeds None = unknown; ``now_s`` is monotonic.

    Lidar, radar and camera have rules of their own; ``others`` are any further near-range sensors on the vehicle.

    Raises:
        ValueError: one of ``others`` has the name of a sensor with a field of its own.
    """

    now_s: float
    moving: bool | None
    lidar: SensorInput
    radar: SensorInput
    camera: SensorInput
    roadside: SensorInput | None = None  # None = not used
    distrust: tuple[str, ...] = ()  # sentences: whose data cannot be dated
    starting: tuple[str, ...] = ()  # expected sensors that have never reported
    stamp_ns: int = 0
    others: dict[str, SensorInput] = field(default_factory=dict)
    motion_kind: SourceKind | None = None  # of the vehicle's motion; None = not used
    speed_mps: float | None = None  # own, forward
    yaw_rate_radps: float | None = None  # own, to the left
    acknowledged: bool = False  # a person says that what nobody can see any more is gone
    coverage: Coverage | None = None  # what is seen of the way ahead; None = not looked at
    abreast: Abreast | None = None  # None = every alarm of the radar counts

    def __post_init__(self) -> None:
        taken = self.others.keys() & {"lidar", "radar", "camera", "infra_lidar"}
        if taken:
            raise ValueError(f"others: {', '.join(sorted(taken))} has a field of its own")

    @cached_property
    def sensors(self) -> dict[str, SensorInput]:
        """All sensors on the vehicle, by name."""
        return {"lidar": self.lidar, "radar": self.radar, "camera": self.camera, **self.others}

    @cached_property
    def fitted(self) -> dict[str, SensorInput]:
        """Those that the vehicle has."""
        return {name: sensor for name, sensor in self.sensors.items() if sensor.fitted}

    @cached_property
    def witnesses(self) -> dict[str, SensorInput]:
        """The sensors on the vehicle and the roadside lidar, by name."""
        return self.sensors if self.roadside is None else {**self.sensors, "infra_lidar": self.roadside}


class Demand(NamedTuple):
    """One rule's demand: the verdict is at least ``level``."""

    level: Level
    rule: str
    because: str
    by: str = ""  # the sensor that shows the object
    held: bool = False  # not seen in that sensor's newest message


@dataclass(frozen=True, slots=True)
class Claim:
    """An alarm about a place. Times are monotonic."""

    by: str  # the sensor that raised it
    level: Level
    since_s: float
    seen_s: float  # last seen; the time of this verdict while the newest message shows it
    place: Place | None = None
    what: str = ""
    key: str = ""
    seen_by: tuple[str, ...] = ()  # other sensors that have shown that they can see it
    since_seen: tuple[Level | None, ...] = ()  # what each message since showed of it: less, or nothing
    lost: bool = False  # the sensor that raised it has been out since
    counted: bool = False  # camera: it has confirmed or stood in; only then it outlives the camera
    travelled_m: float = 0.0  # own way since it was last seen


class Suppression(NamedTuple):
    """What is left of the camera's right to hold back a lidar CAUTION."""

    since_s: float | None = None  # beginning of the detection that draws on it
    farthest_m: float | None = None  # farthest the detection has been
    spent: bool = False  # for reasons other than time
    clear_s: float | None = None  # since when the lidar has been clear


FULL_BUDGET = Suppression()


@dataclass(frozen=True, slots=True)
class FusionMemory:
    """What one verdict leaves for the next. ``FusionMemory()`` is the start."""

    at_s: float | None = None  # of the last verdict
    claims: tuple[Claim, ...] = ()
    stamps_ns: dict[str, int] = field(default_factory=dict)  # by sensor: the last message that was counted
    suppression: Suppression = FULL_BUDGET
