"""The words of the verdict: what each sensor contributed and why, and what would have to change for it to drop."""

from __future__ import annotations

from collections.abc import Mapping

from common.messages import Level, VerdictClaim, VerdictInput
from common.topics import spoken
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import RANK, Claim, Demand, FusionInputs, SensorInput

NUMBER_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")


def number_word(count: int) -> str:
    """``two`` for 2; digits beyond eight."""
    return NUMBER_WORDS[count] if count < len(NUMBER_WORDS) else str(count)


def seen_by(name: str, sensor: SensorInput, level: Level | None, *, standing: bool = False) -> str:
    """For example ``LiDAR CAUTION at 0.62 m (centre)``."""
    what = ""
    if sensor.deciding is not None:
        what = str(sensor.deciding.get("zone") or sensor.deciding.get("label") or "").replace("_", " ")
    where = f" at {sensor.nearest_m:.2f} m" if sensor.nearest_m is not None else ""
    detail = f" ({what})" if what else ""
    return f"{spoken(name)} {level}{where}{detail}{', standing' if standing else ''}"


def held_words(claim: Claim, inputs: FusionInputs) -> str:
    """For example ``LiDAR said IMMINENT at 0.40 m (centre) 3.2 s ago and went disconnected; nobody has seen ...``."""
    where = f" at {claim.place.x_m:.2f} m" if claim.place is not None else ""
    what = f" ({claim.what})" if claim.what else ""
    said = f"{spoken(claim.by)} said {claim.level}{where}{what} {inputs.now_s - claim.seen_s:.1f} s ago"
    sensor = inputs.witnesses.get(claim.by)
    state = "disconnected" if sensor is None else sensor.state
    if state != "online":
        return f"{said} and went {state}; nobody has seen the place free since"
    count = len(claim.since_seen)
    if count == 0:
        return f"{said}; nobody has seen the place free since"
    messages = "message" if count == 1 else f"{number_word(count)} messages"
    return f"{said}; less or nothing in its last {messages}, too few to lower it"


def list_claims(inputs: FusionInputs, claims: tuple[Claim, ...]) -> list[VerdictClaim]:
    """The alarms that the verdict keeps, for people and pages."""
    return [
        VerdictClaim(
            by=claim.by, level=claim.level, what=claim.what, seen=claim.seen_s == inputs.now_s,
            x_m=claim.place.x_m if claim.place else None, y_m=claim.place.y_m if claim.place else None,
            radius_m=claim.place.radius_m if claim.place else None,
            since_ms=round((inputs.now_s - claim.since_s) * 1e3), seen_ms=round((inputs.now_s - claim.seen_s) * 1e3),
        )
        for claim in claims
        if claim.counted or RANK[claim.level] >= RANK["CAUTION"]
    ]  # fmt: skip


def explain_inputs(
    inputs: FusionInputs,
    votes: Mapping[str, Level | None],
    suppressed: bool,
    confirmed: bool,
    camera_fresh: bool,
    static: bool,
) -> dict[str, VerdictInput]:
    """One record per sensor: state, level, age, whether it counted, and why."""
    used_and_why = {
        "lidar": _ranging(inputs.lidar, votes["lidar"], suppressed),
        "radar": _radar(inputs, votes["radar"], static),
        "camera": _camera(inputs, votes["camera"], suppressed, confirmed, camera_fresh),
        **{name: _ranging(sensor, votes[name]) for name, sensor in inputs.others.items()},
    }
    records = {name: _record(sensor, *used_and_why[name]) for name, sensor in inputs.fitted.items()}
    if inputs.roadside is not None:
        records["infra_lidar"] = _record(inputs.roadside, *_roadside(inputs.roadside, votes["infra_lidar"]))
    return records


def _record(sensor: SensorInput, used: bool, why: str) -> VerdictInput:
    return VerdictInput(
        state=sensor.state,
        level=sensor.level,
        age_ms=None if sensor.age_s is None else round(sensor.age_s * 1e3, 1),
        used=used,
        why=why,
        stage_ms=sensor.stage_ms,
        stamp_ns=sensor.stamp_ns,
        source_kind=sensor.source_kind,
    )


def _ranging(sensor: SensorInput, vote: Level | None, suppressed: bool = False) -> tuple[bool, str]:
    because = f": {sensor.reason}" if sensor.reason else ""
    if RANK[vote] > RANK[sensor.level] and not suppressed:
        return True, f"{sensor.state}{because}; its {vote} of before is kept: nobody has seen the place free since"
    if sensor.state == "disconnected":
        return False, f"disconnected{because}; no vote, which is not a vote for SAFE"
    alarming = RANK[sensor.level] >= RANK["CAUTION"]
    if sensor.state == "degraded":
        return alarming, f"degraded{because}; its {'alarm counts' if alarming else 'SAFE does not count'}"
    if suppressed:
        return False, f"{sensor.level} held back: the camera's fresh picture is empty there"
    return True, f"online; its {sensor.level or 'SAFE'} counts"


def _radar(inputs: FusionInputs, vote: Level | None, static: bool) -> tuple[bool, str]:
    sensor, abreast = inputs.radar, inputs.abreast
    if abreast is not None and RANK[abreast.level] < RANK[sensor.level]:
        text = f"online; of its {sensor.level} the LiDAR shows two things beside a free way: {abreast.level} is left"
        return RANK[vote] >= RANK["CAUTION"], text
    if static and RANK[sensor.static_level] > RANK[sensor.level]:
        return True, f"online; the LiDAR is degraded, so its standing tracks count: {sensor.static_level}"
    return _ranging(sensor, vote)


def _camera(
    inputs: FusionInputs, vote: Level | None, suppressed: bool, confirmed: bool, fresh: bool
) -> tuple[bool, str]:
    camera = inputs.camera
    because = f": {camera.reason}" if camera.reason else ""
    if camera.state != "online" and vote is not None:
        return True, f"{camera.state}{because}; its {vote} of before counted and is kept"
    if camera.state != "online":
        return False, f"{camera.state}{because}; neither confirms nor suppresses"
    if inputs.lidar.state != "online":
        sees = "sees nothing" if vote is None else f"sees something ({vote}), at least CAUTION"
        return True, f"stands in for the LiDAR: {sees}"
    if suppressed:
        return True, "sees nothing: holds back the LiDAR's CAUTION for a moment"
    if confirmed:
        return True, f"confirms with {vote}"
    if not fresh:
        return False, "picture too old to confirm or to suppress"
    if vote is None:
        return False, "sees nothing; that silences nobody now"
    if RANK[vote] >= RANK["CAUTION"]:
        return False, f"{vote} alone against a clear LiDAR: advisory only"
    return False, "sees something far away; that only rules out suppression"


def _roadside(sensor: SensorInput, vote: Level | None) -> tuple[bool, str]:
    raises = RANK[vote] >= RANK["CAUTION"]
    because = f" ({sensor.reason})" if sensor.reason else ""
    return raises, f"{sensor.state}{because}; {'raises' if raises else 'nothing to add'}; it never lowers"


def way_down(
    inputs: FusionInputs, demands: list[Demand], claims: tuple[Claim, ...], spent: bool, rules: RulesConfig
) -> str:
    """What would have to change for the level to drop: each of ``demands``, all at that level, has to go."""
    own = [demand for demand in demands if demand.rule != "R3-confirmed"]  # it goes with what it confirms
    ends = (
        _end_of_claim(inputs, one, claims, rules) if one.held else _end_of(inputs, one, spent) for one in own or demands
    )
    return "; and ".join(dict.fromkeys(ends))


def _end_of_claim(inputs: FusionInputs, demand: Demand, claims: tuple[Claim, ...], rules: RulesConfig) -> str:
    """Who can say that the place of a held alarm is free."""
    sensor = inputs.witnesses.get(demand.by)
    if sensor is not None and sensor.state == "online":
        free = min((len(claim.since_seen) for claim in claims if claim.by == demand.by), default=0)
        return f"{spoken(demand.by)} clear in {rules.clear_messages - free} more messages"
    able = {name for claim in claims if claim.by == demand.by for name in claim.seen_by}
    names = [demand.by, *sorted(able - {demand.by})]
    see = " or ".join(f"{spoken(name)} online and clear there" for name in names)
    return f"{see}, or the place left behind, or a person's `spotter acknowledge`"


def _end_of(inputs: FusionInputs, demand: Demand, spent: bool) -> str:
    out = [f"{spoken(name)} online again" for name, sensor in inputs.fitted.items() if sensor.state != "online"]
    lidar = "LiDAR online again, or " if inputs.lidar.fitted else ""
    match demand.rule:
        case "R7-two-out" | "R7-blind":
            needed = max(len(out) - 1, 1)  # one may stay out, if there are several
            return " or ".join(out) if needed == 1 else f"{number_word(needed)} of: {', '.join(out)}"
        case "A25-starting":
            return "a first message from " + ", ".join(map(spoken, inputs.starting))
        case "V1-uncovered":
            return "the way ahead seen as far as the vehicle needs to stop, or slower driving"
        case "M1-reversing":
            return "the vehicle standing or driving forward"
        case "C1-clock":
            return "clock offset measured again, stamps plausible"
        case "R9-static-radar":
            return f"{lidar}the vehicle known to stand, or the standing track gone"
        case "R5-camera-stands-in":
            return f"{lidar}the camera's forward zone empty"
        case "I1-roadside":
            return "the roadside object off the vehicle's path"
    quiet = f"{spoken(demand.by)} to report {'SAFE' if demand.level == 'CAUTION' else 'less than IMMINENT'}"
    if spent and demand.by == "lidar" and demand.level == "CAUTION":
        return f"{quiet} (an empty picture no longer holds it back)"
    return quiet
