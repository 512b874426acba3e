"""The drill file: faults, the health and verdict expected for each, and the time limits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from common.config import ConfigError, Section, load
from common.messages import Level, SensorState, SystemHealth, Verdict
from common.topics import OPTIONAL_SERVICES, SERVICES

DEFAULT_FILE = Path(__file__).parent / "drills.toml"

Seconds = Annotated[float, Meta(ge=0.0, le=120.0)]
SignalKind = Literal["kill", "freeze"]
RelayKind = Literal[
    "delay", "duplicate", "reorder", "stuck", "garbage", "wrong_types", "nan", "million", "future", "past", "jump",
    "foreign_host",
]  # fmt: skip
Kind = Literal[SignalKind, RelayKind, "cut", "slow", "hang", "clock", "clock_step", "sim"]

SIGNALS: frozenset[str] = frozenset({"kill", "freeze"})
RELAYED: frozenset[str] = frozenset({
    "delay", "duplicate", "reorder", "stuck", "garbage", "wrong_types", "nan", "million", "future", "past", "jump",
    "foreign_host",
})  # fmt: skip


class Fault(Section, frozen=True, kw_only=True):
    """One thing that is broken.

    ``kill``, ``freeze``: SIGKILL, SIGSTOP, also to the ``router``. ``hang``: SIGSTOP for ever, to a service under a
    supervisor as that of `spotter up`, which alone may mend it. ``cut``: the link between service and router carries
    nothing any more; ``slow``: it carries everything ``seconds`` later, each way.
    ``clock``: the process restarts with its clock off by ``seconds``. ``clock_step``: the clock of the running process
    jumps by ``seconds``. ``sim``: the simulated world's own fault at
    scenario time ``at_s``, whose moment is known within about half a second. All others: a stand-in takes the service's
    place and spoils what it publishes.
    """

    kind: Kind
    service: str
    seconds: Annotated[float, Meta(ge=-3600.0, le=3600.0)] = 0.0  # delay, clock offset, stamp offset
    at_s: Seconds = 0.0  # sim: when the fault begins in the scenario


class Expected(Section, frozen=True, kw_only=True):
    """The expected state; fields left out are not checked. The verdict has to name the same states as health."""

    health: dict[str, SensorState] = msgspec.field(default_factory=dict)
    cause: dict[str, str] = msgspec.field(default_factory=dict)
    reason: dict[str, str] = msgspec.field(default_factory=dict)  # a text that the sensor's reason contains
    colour: tuple[str, ...] = ()
    note: str = ""  # a text that one of health's notes contains
    level: tuple[Level, ...] = ()
    rule: tuple[str, ...] = ()
    permission: tuple[str, ...] = ()
    blind: bool | None = None
    unused: tuple[str, ...] = ()  # sensors whose present data the verdict does not use; a held alarm is allowed
    silent: bool = False  # no more verdicts: the last exceeds its age limit, so the actuator has to stop

    def health_fits(self, health: SystemHealth) -> bool:
        """Whether this health says all that is expected of it."""
        states = all(
            name in health.sensors and health.sensors[name].state == want for name, want in self.health.items()
        )
        causes = all(name in health.sensors and health.sensors[name].cause == want for name, want in self.cause.items())
        sensors = health.sensors
        reasons = all(name in sensors and want in sensors[name].reason for name, want in self.reason.items())
        noted = not self.note or any(self.note in note for note in health.notes)
        return states and causes and reasons and noted and (not self.colour or health.colour in self.colour)

    def verdict_fits(self, verdict: Verdict) -> bool:
        """Whether this verdict says all that is expected of it."""
        wanted = ((self.level, verdict.level), (self.rule, verdict.rule), (self.permission, verdict.permission))
        plain = all(not allowed or got in allowed for allowed, got in wanted)
        held = {claim.by for claim in verdict.claims if not claim.seen}
        unused = all(name in verdict.inputs and (not verdict.inputs[name].used or name in held) for name in self.unused)
        states = all(verdict.inputs[name].state == want for name, want in self.health.items() if name in verdict.inputs)
        return plain and unused and states and self.blind in (None, verdict.blind)

    @property
    def about_health(self) -> bool:
        """Whether anything at all is expected of health."""
        return bool(self.health or self.cause or self.reason or self.colour or self.note)


class Drill(Section, frozen=True, kw_only=True):
    """One drill: what is broken, what has to follow, and how soon."""

    name: str
    faults: Annotated[tuple[Fault, ...], Meta(min_length=1)]
    expect: Expected
    health_within_s: Seconds
    verdict_within_s: Seconds
    actuator_within_s: Seconds = 0.0  # until the actuator is at STOP; 0 = not looked at
    recovery_within_s: Seconds = 45.0  # a killed service has to start again, on a busy machine
    allowed: tuple[Level, ...] = ("SAFE", "CAUTION", "IMMINENT")  # levels that may be seen while the fault lasts
    lasts_s: Seconds = 0.0  # how long the fault is left as it is at least


class DrillPlan(Section, frozen=True, kw_only=True):
    """A drill file."""

    scenario: str = "empty"  # what the simulated sensors look at between the faults
    services: tuple[str, ...] = ()  # that run beside the sensors, fusion and gate
    before: Expected = Expected()  # what has to hold before each drill and again after it
    ready_within_s: Seconds = 60.0
    drills: Annotated[tuple[Drill, ...], Meta(min_length=1)] = msgspec.field(default_factory=tuple)


def load_plan(path: Path, only: str = "") -> DrillPlan:
    """Read a drill file; ``only`` keeps the drills whose name contains it.

    Raises:
        ConfigError: wrong key or value, an unknown service, or no drill left.
    """
    plan = load(DrillPlan, path)
    known = {"router", *(row.name for row in (*SERVICES, *OPTIONAL_SERVICES))}
    for name in plan.services:
        if name not in known:
            raise ConfigError(f"{path}: services: no service {name!r}")
    for drill in plan.drills:
        for fault in drill.faults:
            if fault.service not in known:
                raise ConfigError(f"{path}: drill {drill.name!r}: no service {fault.service!r}")
    kept = tuple(drill for drill in plan.drills if only.lower() in drill.name.lower())
    if not kept:
        raise ConfigError(f"{path}: no drill matches {only!r}")
    return msgspec.structs.replace(plan, drills=kept)


def shown(expected: Expected) -> dict[str, Any]:
    """The fields of an expectation that are set, for messages."""
    return {key: value for key, value in msgspec.to_builtins(expected).items() if value not in (None, "", [], {}, ())}
