"""The words of the verdict: what each sensor contributed and why, and what would have to change for it to drop."""

from __future__ import annotations

from common.messages import Level, VerdictInput
from services.jetson.fusion.evidence import RANK, Claim, FusionInputs, SensorInput


def seen_by(name: str, sensor: SensorInput, level: Level | None, *, standing: bool = False) -> str:
    """For example ``lidar CAUTION at 0.62 m (centre)``."""
    what = ""
    if sensor.deciding is not None:
        what = str(sensor.deciding.get("zone") or sensor.deciding.get("label") or "")
        track = sensor.deciding.get("track_id")
        what = f"{what} track {track}".strip() if track is not None else what
    where = f" at {sensor.nearest_m:.2f} m" if sensor.nearest_m is not None else ""
    detail = f" ({what})" if what else ""
    return f"{name} {level}{where}{detail}{', standing' if standing else ''}"


def explain_inputs(
    inputs: FusionInputs, suppressed: bool, confirmed: bool, camera_fresh: bool, static: bool
) -> dict[str, VerdictInput]:
    """One record per sensor: state, level, age, whether it counted, and why."""
    told = {
        "lidar": _ranging(inputs.lidar, suppressed),
        "radar": _radar(inputs.radar, static),
        "camera": _camera(inputs, suppressed, confirmed, camera_fresh),
    }
    records = {name: _record(sensor, *told[name]) for name, sensor in inputs.sensors.items()}
    if inputs.roadside is not None:
        records["infra_lidar"] = _record(inputs.roadside, *_roadside(inputs.roadside))
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
    )


def _ranging(sensor: SensorInput, suppressed: bool = False) -> tuple[bool, str]:
    because = f": {sensor.reason}" if sensor.reason else ""
    if sensor.state == "disconnected":
        return False, f"disconnected{because}; no vote, which is not a vote for SAFE"
    alarming = RANK[sensor.level] >= RANK["CAUTION"]
    if sensor.state == "degraded":
        return alarming, f"degraded{because}; its {'alarm counts' if alarming else 'SAFE does not count'}"
    if suppressed:
        return False, f"{sensor.level} held back: the camera's fresh picture is empty there"
    return True, f"online; its {sensor.level or 'SAFE'} counts"


def _radar(sensor: SensorInput, static: bool) -> tuple[bool, str]:
    if static and RANK[sensor.static_level] > RANK[sensor.level]:
        return True, f"online; the lidar is degraded, so its standing tracks count: {sensor.static_level}"
    return _ranging(sensor)


def _camera(inputs: FusionInputs, suppressed: bool, confirmed: bool, fresh: bool) -> tuple[bool, str]:
    camera = inputs.camera
    because = f": {camera.reason}" if camera.reason else ""
    if camera.state != "online":
        return False, f"{camera.state}{because}; neither confirms nor suppresses"
    if inputs.lidar.state != "online":
        sees = "sees nothing" if camera.level is None else f"sees something ({camera.level}), at least CAUTION"
        return True, f"stands in for the lidar: {sees}"
    if suppressed:
        return True, "sees nothing: holds back the lidar's CAUTION for a moment"
    if confirmed:
        return True, f"confirms with {camera.level}"
    if not fresh:
        return False, "picture too old to confirm or to suppress"
    if camera.level is None:
        return False, "sees nothing; that silences nobody now"
    if RANK[camera.level] >= RANK["CAUTION"]:
        return False, f"{camera.level} alone against a clear lidar: advisory only"
    return False, "sees something far away; that only rules out suppression"


def _roadside(sensor: SensorInput) -> tuple[bool, str]:
    raises = sensor.state != "disconnected" and RANK[sensor.level] >= RANK["CAUTION"]
    because = f" ({sensor.reason})" if sensor.reason else ""
    return raises, f"{sensor.state}{because}; {'raises' if raises else 'nothing to add'}; it never lowers"


def way_down(inputs: FusionInputs, claims: list[Claim], spent: bool) -> str:
    """What would have to change for the level to drop: each of ``claims``, all at that level, has to go."""
    own = [claim for claim in claims if claim.rule != "R3-confirmed"]  # a confirmation goes with what it confirms
    return "; and ".join(dict.fromkeys(_end_of(inputs, claim, spent) for claim in own or claims))


def _end_of(inputs: FusionInputs, claim: Claim, spent: bool) -> str:
    out = [f"{name} online again" for name, sensor in inputs.sensors.items() if sensor.state != "online"]
    match claim.rule:
        case "R7-two-out":
            return " or ".join(out)
        case "R7-blind":
            return "two of: " + ", ".join(out)
        case "A25-starting":
            return "a first message from " + ", ".join(inputs.starting)
        case "C1-clock":
            return "clock offset measured again, stamps plausible"
        case "H1-held":
            return f"{claim.by} online and clear, or the hold over"
        case "R9-static-radar":
            return "lidar online again, or the vehicle known to stand, or the standing track gone"
        case "R5-camera-stands-in":
            return "lidar online again, or the camera's forward zone empty"
        case "I1-roadside":
            return "the roadside object off the vehicle's path"
    quiet = f"{claim.by} to report {'SAFE' if claim.level == 'CAUTION' else 'less than IMMINENT'}"
    if spent and claim.by == "lidar" and claim.level == "CAUTION":
        return f"{quiet} (an empty picture no longer holds it back)"
    return quiet
