"""The verdict: a pure function of what the sensors say, how old it is, and what was remembered a moment ago.

The rules, each with its id (``RULES``), read from top to bottom of ``fuse``:

1. Every sensor votes by its state: an online one with its band, a degraded one only with an alarm, a disconnected one
   not at all - which is not a vote for SAFE.
2. The worst vote of lidar and radar counts. Nobody votes it down.
3. The camera stands in for a lidar that is out; otherwise it confirms, or for a moment suppresses, never alarms alone.
4. Floors: two sensors out, blind, a clock nobody can trust, still starting: never SAFE.

Time-limited state is a value (``FusionMemory``) that goes in and comes out, so the same inputs give the same verdict.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from common.messages import Level, SensorState, Verdict, worst
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import RANK, Alarm, Claim, FusionInputs, FusionMemory, SensorInput
from services.jetson.fusion.explain import explain_inputs, seen_by, way_down

RULES: dict[str, str] = {
    "R0-clear": "no sensor that can see reports an alarm",
    "R1-worst-case": "the worst of lidar and radar counts; nobody votes it down",
    "R2-camera-only": "the camera alone against a clear lidar and radar is an advisory, not an alarm",
    "R3-confirmed": "an alarm that the camera backs takes the worse of both bands",
    "R4-suppressed": "a lidar CAUTION in a fresh, empty picture is held back, with all three online, for a moment",
    "R5-camera-stands-in": "with the lidar out, anything the camera sees is at least CAUTION",
    "R7-two-out": "two of three sensors out: at least CAUTION",
    "R7-blind": "all three out: CAUTION, and the vehicle stops",
    "R9-static-radar": "with the lidar degraded and the vehicle not known to stand, standing radar tracks count",
    "A25-starting": "until every expected sensor has reported once: at least CAUTION, and the vehicle stops",
    "C1-clock": "the age of a sensor's data cannot be trusted: at least CAUTION",
    "H1-held": "an alarm outlives the sensor that raised it for a moment",
    "I1-roadside": "the roadside lidar sees something on its way to the vehicle",
}

PERMISSION: dict[Level, Literal["GO", "SLOW", "STOP"]] = {"SAFE": "GO", "CAUTION": "SLOW", "IMMINENT": "STOP"}


DEFAULT_RULES = RulesConfig()


def fuse(
    inputs: FusionInputs, memory: FusionMemory, rules: RulesConfig = DEFAULT_RULES
) -> tuple[Verdict, FusionMemory]:
    """Decide. Source: decision procedure 5.3 with resolutions A1 to A25 of the written rules (README, "Rules")."""
    # 1. votes: online = band, degraded = alarms only, disconnected = none
    lidar, radar = vote(inputs.lidar), radar_vote(inputs)
    memory = remember(inputs, lidar, radar, memory, rules)
    # 2. the worst of lidar and radar
    claims = worst_case(inputs, lidar, radar)
    # 3. the camera confirms, stands in, or holds back for a moment
    confirmed = is_confirmed(inputs, claims, rules)
    suppressed = is_suppressed(inputs, lidar, radar, memory, rules)
    if suppressed:
        claims = []
    claims += camera_claims(inputs, claims, rules)
    # 4. what was alarming a moment ago, what the roadside sees, and the floors
    claims += [*held(inputs, memory, rules), *roadside(inputs), *floors(inputs)]
    decided = decide(inputs, claims, suppressed)
    to_lower = way_down(inputs, [claim for claim in claims if claim.level == decided.level], memory.suppression_spent)
    return explain(inputs, decided, to_lower, confirmed, suppressed, rules), memory


def vote(sensor: SensorInput) -> Level | None:
    """An online sensor's band; a degraded one's alarm but not its SAFE; None = no vote."""
    if sensor.state == "online":
        return sensor.level or "SAFE"
    if sensor.state == "degraded" and RANK[sensor.level] >= RANK["CAUTION"]:
        return sensor.level
    return None


def radar_vote(inputs: FusionInputs) -> Level | None:
    """The radar's vote; standing tracks count only while the lidar is degraded and we may be moving (R9)."""
    level, static = vote(inputs.radar), inputs.radar.static_level
    if level is None or static is None or not uses_static(inputs):
        return level
    return worst(level, static)


def uses_static(inputs: FusionInputs) -> bool:
    """R9: standing tracks of a healthy radar fill in for a lidar that is degraded but there."""
    return inputs.radar.state == "online" and inputs.lidar.state == "degraded" and inputs.moving is not False


def remember(
    inputs: FusionInputs, lidar: Level | None, radar: Level | None, memory: FusionMemory, rules: RulesConfig
) -> FusionMemory:
    """The memory after these inputs: the lidar's continuous detection, and the alarms that may be held."""
    if inputs.lidar.state == "online" and lidar == "SAFE":  # its level is already debounced: truly clear
        memory = replace(memory, lidar_since_s=None, farthest_m=None, suppression_spent=False)
    elif RANK[lidar] >= RANK["CAUTION"]:
        memory = _continue_detection(inputs, radar, memory, rules)
    return replace(
        memory,
        lidar_alarm=_keep_alarm(inputs.lidar.state, lidar, memory.lidar_alarm, inputs.now_s, rules.hold_s),
        radar_alarm=_keep_alarm(inputs.radar.state, radar, memory.radar_alarm, inputs.now_s, rules.hold_s),
        camera_alarm=_keep_alarm(
            inputs.camera.state, stand_in(inputs), memory.camera_alarm, inputs.now_s, rules.hold_s
        ),
    )


def _continue_detection(
    inputs: FusionInputs, radar: Level | None, memory: FusionMemory, rules: RulesConfig
) -> FusionMemory:
    since_s = inputs.now_s if memory.lidar_since_s is None else memory.lidar_since_s
    nearest_m, farthest_m = inputs.lidar.nearest_m, memory.farthest_m
    if nearest_m is not None:
        farthest_m = nearest_m if farthest_m is None else max(farthest_m, nearest_m)
    closing = nearest_m is not None and farthest_m is not None and farthest_m - nearest_m >= rules.suppression_closing_m
    spent = memory.suppression_spent or closing or RANK[radar] >= RANK["CAUTION"]
    return replace(memory, lidar_since_s=since_s, farthest_m=farthest_m, suppression_spent=spent)


def _keep_alarm(
    state: SensorState, level: Level | None, alarm: Alarm | None, now_s: float, hold_s: float
) -> Alarm | None:
    """An online sensor's own word stands; one that is out keeps the worse of its alarms until it has expired."""
    if alarm is not None and (state == "online" or now_s - alarm.at_s >= hold_s):
        alarm = None
    if level is not None and RANK[level] >= RANK["CAUTION"] and (alarm is None or RANK[level] >= RANK[alarm.level]):
        return Alarm(level, now_s)
    return alarm


def worst_case(inputs: FusionInputs, lidar: Level | None, radar: Level | None) -> list[Claim]:
    """R1, R9: what lidar and radar demand, the worse first; empty when both are clear or out."""
    claims = []
    if lidar is not None and RANK[lidar] >= RANK["CAUTION"]:
        claims.append(Claim(lidar, "R1-worst-case", seen_by("lidar", inputs.lidar, lidar), "lidar"))
    if radar is not None and RANK[radar] >= RANK["CAUTION"]:
        static = RANK[radar] > RANK[inputs.radar.level]
        rule = "R9-static-radar" if static else "R1-worst-case"
        claims.append(Claim(radar, rule, seen_by("radar", inputs.radar, radar, standing=static), "radar"))
    return sorted(claims, key=lambda claim: -RANK[claim.level])


def camera_is_fresh(inputs: FusionInputs, rules: RulesConfig) -> bool:
    """Online, and recent enough to confirm or to suppress (A20)."""
    age_s = inputs.camera.age_s
    return inputs.camera.state == "online" and age_s is not None and abs(age_s) <= rules.confirm_age_s


def is_confirmed(inputs: FusionInputs, claims: list[Claim], rules: RulesConfig) -> bool:
    """R3: the camera reports an alarm of its own beside the lidar's or the radar's."""
    return bool(claims) and camera_is_fresh(inputs, rules) and RANK[inputs.camera.level] >= RANK["CAUTION"]


def is_suppressed(
    inputs: FusionInputs, lidar: Level | None, radar: Level | None, memory: FusionMemory, rules: RulesConfig
) -> bool:
    """R4 as limited by A1: only a lidar CAUTION, only with all three online, only for a moment."""
    if rules.suppression == "off" or lidar != "CAUTION" or radar != "SAFE":
        return False
    if any(sensor.state != "online" for sensor in inputs.sensors.values()):
        return False
    if inputs.camera.level is not None or not camera_is_fresh(inputs, rules) or memory.suppression_spent:
        return False
    if rules.suppression == "full":
        return True
    since_s = inputs.now_s if memory.lidar_since_s is None else memory.lidar_since_s
    return 0.0 <= inputs.now_s - since_s < rules.suppression_limit_s


def camera_claims(inputs: FusionInputs, claims: list[Claim], rules: RulesConfig) -> list[Claim]:
    """R3 and R5: what the camera adds to the alarms of the others, or says in the lidar's place."""
    level = inputs.camera.level
    if level is None:
        return []
    instead = stand_in(inputs)
    if instead is not None:
        text = f"{seen_by('camera', inputs.camera, instead)}; it stands in for the lidar"
        return [Claim(instead, "R5-camera-stands-in", text, "camera")]
    if rules.camera_may_raise and is_confirmed(inputs, claims, rules) and RANK[level] >= RANK[claims[0].level]:
        text = f"{seen_by('camera', inputs.camera, level)}; it confirms: {claims[0].because}"
        return [Claim(level, "R3-confirmed", text, "camera")]
    return []


def stand_in(inputs: FusionInputs) -> Level | None:
    """What the camera says in place of a lidar that is out: anything it sees is at least CAUTION."""
    if inputs.lidar.state == "online" or inputs.camera.state != "online" or inputs.camera.level is None:
        return None
    return "IMMINENT" if inputs.camera.level == "IMMINENT" else "CAUTION"


def held(inputs: FusionInputs, memory: FusionMemory, rules: RulesConfig) -> list[Claim]:
    """H1: alarms of sensors that went out while they were alarming."""
    claims = []
    alarms = {"lidar": memory.lidar_alarm, "radar": memory.radar_alarm, "camera": memory.camera_alarm}
    for name, alarm in alarms.items():
        if alarm is not None and inputs.sensors[name].state != "online":
            age_s = inputs.now_s - alarm.at_s
            text = f"{name} said {alarm.level} {age_s:.1f} s ago and went {inputs.sensors[name].state}"
            claims.append(Claim(alarm.level, "H1-held", f"{text}; held for {rules.hold_s:.1f} s", name))
    return claims


def roadside(inputs: FusionInputs) -> list[Claim]:
    """I1: what the pole sees may raise the verdict; a roadside that is clear or gone says nothing."""
    sensor = inputs.roadside
    if sensor is None or sensor.level is None or vote(sensor) in (None, "SAFE"):
        return []
    return [Claim(sensor.level, "I1-roadside", seen_by("roadside lidar", sensor, sensor.level), "roadside")]


def floors(inputs: FusionInputs) -> list[Claim]:
    """R7, A25, C1: reasons why the verdict may not be SAFE whatever the sensors say."""
    claims = []
    out = [f"{name} {sensor.state}" for name, sensor in inputs.sensors.items() if sensor.state != "online"]
    if len(out) == 3:
        claims.append(Claim("CAUTION", "R7-blind", "blind: " + ", ".join(out)))
    elif len(out) == 2:
        claims.append(Claim("CAUTION", "R7-two-out", "two of three sensors out: " + ", ".join(out)))
    if inputs.starting:
        claims.append(Claim("CAUTION", "A25-starting", "starting, waiting for " + ", ".join(inputs.starting)))
    if inputs.distrust:
        claims.append(Claim("CAUTION", "C1-clock", "; ".join(inputs.distrust)))
    return claims


def decide(inputs: FusionInputs, claims: list[Claim], suppressed: bool) -> Claim:
    """The worst claim; among equals the camera's confirmation, then the first, which is what a sensor saw."""
    if claims:
        return max(claims, key=lambda claim: (RANK[claim.level], claim.rule == "R3-confirmed"))
    if suppressed:
        text = f"{seen_by('lidar', inputs.lidar, 'CAUTION')}, but a fresh picture shows nothing there"
        return Claim("SAFE", "R4-suppressed", text, "lidar")
    if camera_alone(inputs):
        text = f"{seen_by('camera', inputs.camera, inputs.camera.level)}, but lidar and radar are clear"
        return Claim("SAFE", "R2-camera-only", text, "camera")
    online = [name for name, sensor in inputs.sensors.items() if sensor.state == "online"]
    return Claim("SAFE", "R0-clear", f"{', '.join(online)} {'see' if len(online) > 1 else 'sees'} nothing near")


def camera_alone(inputs: FusionInputs) -> bool:
    """R2: an alarm of the camera that a healthy, clear lidar does not share."""
    clear = inputs.lidar.state == "online" and vote(inputs.lidar) == "SAFE" and vote(inputs.radar) in (None, "SAFE")
    return clear and inputs.camera.state == "online" and RANK[inputs.camera.level] >= RANK["CAUTION"]


def explain(
    inputs: FusionInputs,
    decided: Claim,
    to_lower: str,
    confirmed: bool,
    suppressed: bool,
    rules: RulesConfig,
) -> Verdict:
    """The verdict as a message that says why."""
    blind = all(sensor.state != "online" for sensor in inputs.sensors.values())
    witness = inputs.roadside if decided.by == "roadside" else inputs.sensors.get(decided.by)
    return Verdict(
        stamp_ns=inputs.stamp_ns,
        frame_id="vehicle",
        level=decided.level,
        rule=decided.rule,
        because=decided.because,
        inputs=explain_inputs(inputs, suppressed, confirmed, camera_is_fresh(inputs, rules), uses_static(inputs)),
        confirmed=confirmed,
        suppressed=suppressed,
        advisory="CAMERA_ONLY" if camera_alone(inputs) else None,
        blind=blind,
        permission="STOP" if blind or inputs.starting else PERMISSION[decided.level],
        to_lower=to_lower,
        deciding=witness.deciding if witness is not None else None,
    )


__all__ = ["RULES", "FusionInputs", "FusionMemory", "SensorInput", "fuse"]
