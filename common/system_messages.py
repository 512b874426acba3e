"""The messages about the whole: fusion's verdict and health, and what every service reports of itself."""

from __future__ import annotations

from typing import Literal

import msgspec

from common.message_types import (
    Count,
    Finite,
    Level,
    Message,
    Milliseconds,
    Name,
    NotNegative,
    SensorMessage,
    SensorState,
    ServiceState,
    SourceKind,
    StageMs,
    Text,
)

# --- fusion -----------------------------------------------------------------------------------------------------


class VerdictInput(msgspec.Struct, kw_only=True):
    """What one sensor contributed, and why it did or did not count."""

    state: SensorState
    level: Level | None
    age_ms: Milliseconds | None  # None = never seen
    used: bool
    why: Text
    stage_ms: StageMs = {}  # capture, processing, transport, fusion
    stamp_ns: Count = 0  # of the measurement that was used; 0 = none
    source_kind: SourceKind = "unknown"  # of its newest message


class VerdictClaim(msgspec.Struct, kw_only=True):
    """An alarm about a place, in the vehicle's frame, that no sensor has seen free yet; None = somewhere ahead."""

    by: Name  # the sensor that raised it
    level: Level
    what: Text
    seen: bool  # in that sensor's newest message
    x_m: Finite | None
    y_m: Finite | None
    radius_m: NotNegative | None
    since_ms: Milliseconds
    seen_ms: Milliseconds  # since it was last seen


class Uncovered(msgspec.Struct, frozen=True, kw_only=True):
    """A part of the way ahead, from the bumper, in which no sensor could have seen an obstacle."""

    from_m: NotNegative
    to_m: NotNegative
    why: Text


class WayAhead(msgspec.Struct, frozen=True, kw_only=True):
    """The path of the vehicle if it keeps its motion, and its stopping distance."""

    motion: Literal["driving", "standing", "reversing", "unknown"]  # unknown and standing: straight ahead
    curvature_per_m: Finite  # of the origin's track, left positive
    left_m: NotNegative  # how far the swept outline reaches beside it
    right_m: NotNegative
    stopping_m: NotNegative  # from the bumper: reaction, braking, margin


class Verdict(Message, kw_only=True):
    """Fusion's result: the danger level, the rule that decided, and the inputs. Missing data never gives SAFE.

    ``source_kind`` is "live" only if every input used is live. Actuators must ignore verdicts that are not "live".
    """

    level: Level
    rule: Name  # id of the rule that decided
    because: Text  # a sentence for people
    inputs: dict[Name, VerdictInput]
    confirmed: bool
    suppressed: bool
    advisory: Name | None
    blind: bool
    permission: Literal["GO", "SLOW", "STOP"]
    to_lower: Text = ""  # what would have to change for the level to drop
    deciding: dict[str, object] | None = None  # the object or zone behind it, in its message's own fields
    claims: list[VerdictClaim] = msgspec.field(default_factory=list)  # alarms that are kept, seen now or not
    covered_m: NotNegative | None = None  # of the way ahead seen, from the bumper; None = no sensor says what it covers
    uncovered: list[Uncovered] = msgspec.field(default_factory=list)
    max_safe_speed_mps: NotNegative | None = None  # stops within ``covered_m``; less past hidden places
    way: WayAhead | None = None


class GateState(SensorMessage, kw_only=True):
    """The gate's output to the actuator, and why; ``state`` and ``reason`` concern the connection to the actuator."""

    permission: Literal["GO", "SLOW", "STOP"]
    limit_mps: NotNegative  # speed limit, 0 with STOP
    cause: Name  # "verdict", or the fault that stops, or "waiting", "acknowledge"
    because: Text
    left_s: NotNegative  # of good verdicts until it may move again
    acknowledge: bool  # a person has to acknowledge first
    verdict_seq: Count | None  # of the newest verdict that could be read
    verdict_age_s: NotNegative | None
    outputs: dict[Name, Text]  # by URL: what the actuator says that it does, or what is wrong with it


class FusionTrace(Message, kw_only=True):
    """All inputs of one verdict, so that it can be computed again."""

    verdict_seq: Count
    inputs: dict[Name, object]  # services.jetson.fusion.evidence.FusionInputs
    memory: dict[Name, object]  # FusionMemory before the verdict
    rules: dict[Name, object]  # RulesConfig in force


class SensorHealth(msgspec.Struct, kw_only=True):
    """Whether fusion can rely on a sensor, since when, and why not."""

    state: SensorState
    reason: Text
    since_ns: Count
    age_ms: Milliseconds | None
    rate_hz: NotNegative
    # host_unreachable | not_answering | service_gone | device_lost | stale | impaired | clock | certificate | waiting |
    # recovering | isolated | two_claimants; empty when online
    cause: Name = ""
    source_kind: SourceKind = "unknown"  # of its newest message: measured now, replayed or made up


class ServiceHealth(msgspec.Struct, kw_only=True):
    """Whether a process is there, by its liveliness tokens, and its own status."""

    alive: bool
    instances: Count
    state: ServiceState
    reason: Text
    since_ns: Count


class ClockHealth(msgspec.Struct, kw_only=True):
    """Offset of another host's clock from ours: their time minus our time, true within ``bound_ms``."""

    offset_ms: Milliseconds
    bound_ms: NotNegative
    age_s: NotNegative
    trusted: bool


class SystemHealth(Message, kw_only=True):
    """The health of everything that one host's fusion depends on."""

    sensors: dict[Name, SensorHealth]
    colour: Literal["green", "amber", "red"]
    summary: Text  # the health bar's text
    services: dict[Name, ServiceHealth]  # by "<host>/<service>"
    clocks: dict[Name, ClockHealth] = msgspec.field(default_factory=dict)  # by "<host>/<service>"
    vehicle: Name = ""  # whose fusion this is, where the site's vehicles have names
    notes: list[Text] = msgspec.field(default_factory=list)  # for a person: isolation, start-up, latency budget


# --- every service ----------------------------------------------------------------------------------------------


class ServiceStatus(Message, kw_only=True):
    """The status of a service, every second: its state, and what it counted since it began."""

    state: ServiceState
    reason: Text
    published: Count
    dropped: Count
    bad_input: Count
    rate_hz: NotNegative
    last_frame_age_s: NotNegative | None
    stage_ms: StageMs
    rss_mb: NotNegative
    instance: Name = ""
    cpu_s: NotNegative = 0.0
    counters: dict[Name, Count] = msgspec.field(default_factory=dict)  # what was rejected and why, by name


class ServiceInfo(Message, kw_only=True):
    """Who a service is: asked for, not sent."""

    service: Name
    host: Name
    instance: Name
    version: Name
    config_hash: Name
    topics: list[Name]
    started_ns: Count
    pid: Count
    source: Text = ""
    config: dict[Name, object] = msgspec.field(default_factory=dict)  # the effective configuration, without secrets


class LinkFault(msgspec.Struct, kw_only=True):
    """Why another host cannot be linked: ``clock`` or ``certificate``, and a sentence."""

    cause: Name
    why: Text


class RouterLinks(Message, kw_only=True):
    """What a host's router answers to that host's own services; hosts that it does not name are linked, or silent."""

    faults: dict[Name, LinkFault]


class ClockReply(Message, kw_only=True):
    """NTP-style echo: ``stamp_ns`` is the asker's own time stamp, given back."""

    request_received_ns: Count
    reply_sent_ns: Count
