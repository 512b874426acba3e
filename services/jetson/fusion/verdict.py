"""The verdict: a pure function of what the sensors say, how old it is, and what was remembered a moment ago.

The rules, each with its id (``RULES``), read from top to bottom of ``fuse``:

0. What a sensor alarms about becomes a claim, and a claim is ended by evidence, never by absence (``claims.py``).
1. Every sensor votes with its claims: an online one without any for SAFE, one that is out without any not at all -
   which is not a vote for SAFE.
2. The worst vote of lidar, radar and any further near-range sensor counts. Nobody votes it down.
3. The camera stands in for a lidar that is out; otherwise it confirms, or for a moment suppresses, never alarms alone.
4. Floors: more than one sensor out, blind, reversing unseen, a clock not trusted, still starting: never SAFE.

All memory is a value (``FusionMemory``) that goes in and comes out, so the same inputs give the same verdict.
"""

from __future__ import annotations

from typing import Literal

from common.messages import Level, Verdict, worst
from common.topics import spoken
from services.jetson.fusion.claims import count_camera, is_ahead, level_of, update_claims, uses_static
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.coverage import Coverage
from services.jetson.fusion.evidence import RANK, Abreast, Claim, Demand, FusionInputs, FusionMemory, SensorInput
from services.jetson.fusion.explain import explain_inputs, held_words, list_claims, number_word, seen_by, way_down
from services.jetson.fusion.origin import rests_on
from services.jetson.fusion.suppression import camera_is_fresh, draw_on, is_suppressed

RULES: dict[str, str] = {
    "R0-clear": "no sensor that can see reports an alarm",
    "R1-worst-case": "the worst of LiDAR and radar counts; nobody votes it down",
    "R2-camera-only": "the camera alone against a clear LiDAR and radar is an advisory, not an alarm",
    "R3-confirmed": "an alarm that the camera backs takes the worse of both bands",
    "R4-suppressed": "a LiDAR CAUTION in a fresh, empty picture is held back, with all three online, for a moment",
    "R5-camera-stands-in": "with the LiDAR out, anything the camera sees is at least CAUTION",
    "R7-two-out": "more than one of the vehicle's sensors out (two of three): at least CAUTION",
    "R7-blind": "all of the vehicle's sensors out: CAUTION, and the vehicle stops",
    "R9-static-radar": "with the LiDAR degraded and the vehicle not known to stand, standing radar tracks count",
    "R10-abreast": "a radar alarm that the LiDAR shows as two things beside a free way, one on either side, is none",
    "V1-uncovered": "the vehicle would not stop within the part of its way that its sensors see: at least CAUTION",
    "M1-reversing": "reversing, and no sensor that can see looks back: at least CAUTION",
    "A25-starting": "until every expected sensor has reported once: at least CAUTION, and the vehicle stops",
    "C1-clock": "the age of a sensor's data cannot be trusted: at least CAUTION",
    "H1-held": "an alarm is not ended by absence: it stays until somebody who can see the place has seen it free",
    "N1-near-range": "a further near-range sensor on the vehicle counts like LiDAR and radar; nobody votes it down",
    "I1-roadside": "the roadside LiDAR sees something on its way to the vehicle",
}

PERMISSION: dict[Level, Literal["GO", "SLOW", "STOP"]] = {"SAFE": "GO", "CAUTION": "SLOW", "IMMINENT": "STOP"}


DEFAULT_RULES = RulesConfig()

Votes = dict[str, Level | None]  # by sensor; None = no vote


def fuse(
    inputs: FusionInputs, memory: FusionMemory, rules: RulesConfig = DEFAULT_RULES
) -> tuple[Verdict, FusionMemory]:
    """Decide. Source: decision procedure 5.3 with resolutions A1 to A25 of the written rules (README, "Rules")."""
    # 1. what was claimed and nobody has refuted; votes: online = claims or SAFE, out = claims or none
    claims = update_claims(inputs, memory, rules)
    votes = cast_votes(inputs, claims, rules)
    # 2. the worst of lidar, radar and further near-range sensors
    demands = worst_case(inputs, votes, claims)
    # 3. the camera confirms, stands in, or holds back for a moment
    confirmed = is_confirmed(inputs, votes, demands, rules)
    budget = draw_on(inputs, votes, memory.suppression, rules)
    suppressed = is_suppressed(inputs, votes, budget, rules)
    if suppressed:
        demands = []
    demands += camera_demands(inputs, votes, claims, demands, rules)
    claims = note_use_of_camera(inputs, votes, claims, confirmed, rules)
    # 4. what the roadside sees, and the floors
    demands += [*roadside(inputs, votes, claims), *floors(inputs, rules)]
    decided = decide(inputs, votes, claims, demands, suppressed)
    worst_ones = [demand for demand in demands if demand.level == decided.level]
    to_lower = way_down(inputs, worst_ones, claims, budget.spent, rules)
    verdict = explain(inputs, votes, decided, confirmed, suppressed, rules)
    verdict.source_kind = rests_on(inputs, claims)
    if inputs.coverage is not None:
        covered = inputs.coverage
        verdict.way, verdict.covered_m, verdict.uncovered = covered.way, covered.covered_m, list(covered.uncovered)
        verdict.max_safe_speed_mps = covered.max_safe_speed_mps
    verdict.to_lower, verdict.claims = to_lower, list_claims(inputs, claims)
    stamps_ns = {name: sensor.stamp_ns for name, sensor in inputs.witnesses.items()}
    return verdict, FusionMemory(inputs.now_s, claims, stamps_ns, budget)


def cast_votes(inputs: FusionInputs, claims: tuple[Claim, ...], rules: RulesConfig) -> Votes:
    """By sensor: the worst of its claims that lie on our way. The camera's None means that it sees nothing."""
    votes: Votes = {}
    for name, sensor in inputs.witnesses.items():
        level = level_of(claim for claim in claims if claim.by == name and is_ahead(claim, rules))
        if name != "camera":
            level = "SAFE" if level is None and sensor.state == "online" else level
        elif level is not None and sensor.state != "online":
            level = worst(level, "CAUTION")  # it stood in or confirmed, and is gone
        votes[name] = level
    return votes


def ranging(votes: Votes) -> Votes:
    """The votes of the vehicle's sensors that measure range; camera and roadside have rules of their own."""
    return {name: level for name, level in votes.items() if name not in ("camera", "infra_lidar")}


def worst_case(inputs: FusionInputs, votes: Votes, claims: tuple[Claim, ...]) -> list[Demand]:
    """R1, R9, N1, H1: what the votes demand, the worst first; empty when all are clear or out."""
    demands = []
    for name, level in ranging(votes).items():
        if level is None or level == "SAFE":
            continue
        claim = foremost(claims, name, level)
        standing = claim.key == "standing"
        if claim.seen_s != inputs.now_s:
            demands.append(Demand(level, "H1-held", held_words(claim, inputs), name, held=True))
            continue
        rule = "R9-static-radar" if standing else "N1-near-range" if name in inputs.others else "R1-worst-case"
        demands.append(Demand(level, rule, seen_by(name, inputs.sensors[name], level, standing=standing), name))
    return sorted(demands, key=lambda demand: -RANK[demand.level])


def foremost(claims: tuple[Claim, ...], name: str, level: Level) -> Claim:
    """The claim behind a sensor's vote: the last seen of those at this level, or of all when the vote is raised."""
    own = [claim for claim in claims if claim.by == name]
    at_level = [claim for claim in own if claim.level == level] or own
    return max(at_level, key=lambda claim: (claim.seen_s, claim.key != "standing"))


def is_confirmed(inputs: FusionInputs, votes: Votes, demands: list[Demand], rules: RulesConfig) -> bool:
    """R3: the camera reports an alarm of its own beside that of a sensor that measures range."""
    return bool(demands) and camera_is_fresh(inputs, rules) and RANK[votes["camera"]] >= RANK["CAUTION"]


def camera_words(inputs: FusionInputs, claims: tuple[Claim, ...], level: Level) -> str:
    """What the camera sees now; or what it saw, where an alarm of an earlier picture counts on."""
    of_camera = [claim for claim in claims if claim.by == "camera" and claim.level == level]
    if RANK[inputs.camera.level] >= RANK[level] or not of_camera:
        return seen_by("camera", inputs.camera, level)
    return held_words(max(of_camera, key=lambda claim: claim.seen_s), inputs)


def camera_demands(
    inputs: FusionInputs, votes: Votes, claims: tuple[Claim, ...], demands: list[Demand], rules: RulesConfig
) -> list[Demand]:
    """R3 and R5: what the camera adds to the alarms of the others, or says in the lidar's place."""
    level, camera = votes["camera"], inputs.camera
    if level is None:
        return []
    if camera.state != "online":
        text = (
            f"camera said {level} before it went {camera.state}, and it counted; nobody has seen the place free since"
        )
        return [Demand(level, "H1-held", text, "camera", held=True)]
    if inputs.lidar.state != "online":
        level = worst(level, "CAUTION")
        text = f"{camera_words(inputs, claims, level)}; it stands in for the LiDAR"
        return [Demand(level, "R5-camera-stands-in", text, "camera")]
    confirmed = is_confirmed(inputs, votes, demands, rules)
    if rules.camera_may_raise and confirmed and RANK[level] >= RANK[demands[0].level]:
        text = f"{camera_words(inputs, claims, level)}; it confirms: {demands[0].because}"
        return [Demand(level, "R3-confirmed", text, "camera")]
    return []


def note_use_of_camera(
    inputs: FusionInputs, votes: Votes, claims: tuple[Claim, ...], confirmed: bool, rules: RulesConfig
) -> tuple[Claim, ...]:
    """A word of the camera that has counted outlives the camera. A lidar that is clear may end it, as by R2."""
    if inputs.camera.state != "online":
        return claims
    if inputs.lidar.state != "online":
        return count_camera(claims, ("lidar",), "SAFE")
    if confirmed and rules.camera_may_raise:
        return count_camera(claims, ("lidar",) if RANK[votes["lidar"]] >= RANK["CAUTION"] else (), "CAUTION")
    return claims


def roadside(inputs: FusionInputs, votes: Votes, claims: tuple[Claim, ...]) -> list[Demand]:
    """I1: what the pole sees may raise the verdict; a roadside that is clear or gone lowers nothing."""
    level, sensor = votes.get("infra_lidar"), inputs.roadside
    if sensor is None or level is None or level == "SAFE":
        return []
    claim = foremost(claims, "infra_lidar", level)
    if claim.seen_s != inputs.now_s:
        return [Demand(level, "H1-held", held_words(claim, inputs), "infra_lidar", held=True)]
    return [Demand(level, "I1-roadside", seen_by("infra_lidar", sensor, level), "infra_lidar")]


def floors(inputs: FusionInputs, rules: RulesConfig) -> list[Demand]:
    """R7, M1, A25, C1: reasons why the verdict may not be SAFE whatever the sensors say."""
    demands = []
    out = [f"{spoken(name)} {sensor.state}" for name, sensor in inputs.fitted.items() if sensor.state != "online"]
    count = len(inputs.fitted)
    if len(out) == count:
        demands.append(Demand("CAUTION", "R7-blind", blind_words(inputs)))
    elif len(out) > 1:
        text = f"{number_word(len(out))} of {number_word(count)} sensors out: {', '.join(out)}"
        demands.append(Demand("CAUTION", "R7-two-out", text))
    if reverses_unseen(inputs, rules):
        text = f"reversing at {-(inputs.speed_mps or 0.0):.1f} m/s, and no sensor looks back"
        demands.append(Demand("CAUTION", "M1-reversing", text))
    if rules.coverage == "floor" and inputs.coverage is not None and inputs.coverage.falls_short:
        demands.append(Demand("CAUTION", "V1-uncovered", uncovered_words(inputs.coverage)))
    if inputs.starting:
        demands.append(
            Demand("CAUTION", "A25-starting", "starting, waiting for " + ", ".join(map(spoken, inputs.starting)))
        )
    if inputs.distrust:
        demands.append(Demand("CAUTION", "C1-clock", "; ".join(inputs.distrust)))
    return demands


def uncovered_words(coverage: Coverage) -> str:
    """Where nothing was seen and why, and at which speed it would not matter."""
    if coverage.covered_m is None or coverage.covered_m >= coverage.way.stopping_m:
        return f"{coverage.limited_by}; safe up to {coverage.max_safe_speed_mps:.1f} m/s"
    gap = coverage.uncovered[0]
    return (
        f"nobody sees the way beyond {coverage.covered_m:.1f} m ({gap.why}), and stopping takes "
        f"{coverage.way.stopping_m:.1f} m; safe up to {coverage.max_safe_speed_mps:.1f} m/s"
    )


def reverses_unseen(inputs: FusionInputs, rules: RulesConfig) -> bool:
    """M1: known to drive backwards, where only the sensors of ``looks_back`` see anything."""
    backwards = inputs.moving is True and inputs.speed_mps is not None and inputs.speed_mps < 0.0
    sensors = inputs.fitted
    return backwards and not any(name in sensors and sensors[name].state == "online" for name in rules.looks_back)


def blind_words(inputs: FusionInputs) -> str:
    """``blind: LiDAR disconnected, ...``: the vehicle's own sentence."""
    states = [f"{spoken(name)} {sensor.state}" for name, sensor in inputs.fitted.items()]
    return "blind: " + (", ".join(states) or "no sensor is fitted")


def decide(
    inputs: FusionInputs, votes: Votes, claims: tuple[Claim, ...], demands: list[Demand], suppressed: bool
) -> Demand:
    """The worst demand; among equals the camera's confirmation, then what is seen now, then the first."""
    if demands:
        return max(demands, key=lambda one: (RANK[one.level], one.rule == "R3-confirmed", not one.held))
    if suppressed:
        text = f"{seen_by('lidar', inputs.lidar, 'CAUTION')}, but a fresh picture shows nothing there"
        return Demand("SAFE", "R4-suppressed", text, "lidar")
    if inputs.abreast is not None and inputs.abreast.level == "SAFE":
        return Demand("SAFE", "R10-abreast", abreast_words(inputs.abreast), "radar")
    level = votes["camera"]
    if level is not None and camera_alone(inputs, votes):
        clear = " and ".join(map(spoken, ranging(votes)))
        text = f"{camera_words(inputs, claims, level)}, but {clear} are clear"
        return Demand("SAFE", "R2-camera-only", text, "camera")
    online = [spoken(name) for name, sensor in inputs.sensors.items() if sensor.state == "online"]
    return Demand("SAFE", "R0-clear", f"{', '.join(online)} {'see' if len(online) > 1 else 'sees'} nothing near")


def abreast_words(abreast: Abreast) -> str:
    """What was set aside, and why."""
    return (
        f"radar {abreast.aside_level} at {abreast.aside_m:.2f} m, but the LiDAR sees the way there: by its speed the "
        "echo is of what stands beside it, or it can wait"
    )


def camera_alone(inputs: FusionInputs, votes: Votes) -> bool:
    """R2: an alarm of the camera that a healthy, clear lidar does not share, nor any other sensor."""
    clear = inputs.lidar.state == "online" and all(level in (None, "SAFE") for level in ranging(votes).values())
    return clear and inputs.camera.state == "online" and RANK[votes["camera"]] >= RANK["CAUTION"]


def explain(
    inputs: FusionInputs, votes: Votes, decided: Demand, confirmed: bool, suppressed: bool, rules: RulesConfig
) -> Verdict:
    """The verdict as a message that says why."""
    blind = all(sensor.state != "online" for sensor in inputs.fitted.values())
    because = decided.because
    if blind and decided.rule != "R7-blind":  # its own sentence first, what others tell it second
        because = f"{blind_words(inputs)}; {because}"
    witness = None if decided.held else inputs.witnesses.get(decided.by)
    return Verdict(
        stamp_ns=inputs.stamp_ns,
        frame_id="vehicle",
        level=decided.level,
        rule=decided.rule,
        because=because,
        inputs=explain_inputs(
            inputs, votes, suppressed, confirmed, camera_is_fresh(inputs, rules), uses_static(inputs)
        ),
        confirmed=confirmed,
        suppressed=suppressed,
        advisory="CAMERA_ONLY" if camera_alone(inputs, votes) else None,
        blind=blind,
        permission="STOP" if blind or inputs.starting else PERMISSION[decided.level],
        deciding=witness.deciding if witness is not None else None,
    )


__all__ = ["RULES", "FusionInputs", "FusionMemory", "SensorInput", "fuse"]
