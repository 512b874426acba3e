"""The values the verdict is made from: what each sensor says now, and what the last verdict remembered."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from common.messages import LEVELS, Level, SensorState

RANK: dict[Level | None, int] = {None: LEVELS.index("SAFE"), **{level: LEVELS.index(level) for level in LEVELS}}


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


@dataclass(frozen=True, slots=True)
class FusionInputs:
    """Everything the verdict depends on. ``moving`` None = unknown; ``now_s`` is monotonic."""

    now_s: float
    moving: bool | None
    lidar: SensorInput
    radar: SensorInput
    camera: SensorInput
    roadside: SensorInput | None = None  # None = not used
    distrust: tuple[str, ...] = ()  # sentences: whose data cannot be dated
    starting: tuple[str, ...] = ()  # expected sensors that have never reported
    stamp_ns: int = 0

    @property
    def sensors(self) -> dict[str, SensorInput]:
        """The three on the vehicle, by name."""
        return {"lidar": self.lidar, "radar": self.radar, "camera": self.camera}


class Claim(NamedTuple):
    """One rule's demand: the verdict is at least ``level``."""

    level: Level
    rule: str
    because: str
    by: str = ""  # the sensor that shows the object


class Alarm(NamedTuple):
    """What a sensor's vote was, and when (monotonic) it was last cast."""

    level: Level
    at_s: float


@dataclass(frozen=True, slots=True)
class FusionMemory:
    """What one verdict leaves for the next. ``FusionMemory()`` is the start."""

    lidar_since_s: float | None = None  # beginning of the lidar's present continuous detection
    farthest_m: float | None = None  # farthest it has been during that detection
    suppression_spent: bool = False  # suppression was ended for this detection
    lidar_alarm: Alarm | None = None  # last alarms that counted, to outlive their sensor
    radar_alarm: Alarm | None = None
    camera_alarm: Alarm | None = None  # while it stood in for the lidar
