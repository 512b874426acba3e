"""Alarms are claims about places: made by a sighting at once, ended by evidence, never by absence.

A claim ends when

- the sensor that raised it is online and ``clear_messages`` of its messages in a row do not show it any more, nor
  anything that it has not agreed on yet (``raw_level``);
- that sensor is out, and another one that has shown that it can see this object does not show it any more, as often;
- the vehicle has left the place behind, by its own known motion;
- a person acknowledges it, and no sensor sees it now.

A standing vehicle whose sensor stays out lowers a claim from IMMINENT to CAUTION after ``decay_s``, never to SAFE.
Nothing else lowers it: not the loss of the sensor, of its link or of its clock, nor a restart of fusion.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from common.messages import Level, worst
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import RANK, Claim, FusionInputs, FusionMemory, Place, SensorInput, Sighting
from services.jetson.fusion.places import FORGET_M, carried, gap_m, in_view, is_behind, is_beside

MAX_CLAIMS = 16  # of one sensor; the worst and nearest are kept
LONGEST_STEP_S = 1.0  # a longer gap between two verdicts is not driven blindly: the place stays nearer than it is
UNKNOWN_RADIUS_M = 0.3
SAME_OBJECT_M, SAME_OBJECT_SHARE = 0.5, 0.25  # what one sensor's object may move between messages, and of its distance
SHARED_M, SHARED_SHARE = 0.3, 0.15  # how far two sensors may disagree about one object
MOVING_ONLY = frozenset({"radar"})  # does not see what stands: of others' alarms it never says that they are over

NOBODY = SensorInput(state="disconnected", level=None)

Seen = Mapping[str, tuple[Sighting, ...]]


def update_claims(inputs: FusionInputs, memory: FusionMemory, rules: RulesConfig) -> tuple[Claim, ...]:
    """The claims after these inputs."""
    seen: Seen = {name: sightings_of(inputs, name) for name in inputs.witnesses}
    if not memory.claims and not any(seen.values()):
        return ()
    fresh = fresh_sensors(inputs, memory)
    # 1. places move as we move
    old = list(carry(inputs, memory, rules))
    # 2. every sensor about what it has claimed itself
    claims: list[Claim] = []
    for name in {**seen, **dict.fromkeys(claim.by for claim in old)}:
        own = [claim for claim in old if claim.by == name]
        claims += _own_word(inputs, name, own, seen.get(name, ()), name in fresh, rules)[:MAX_CLAIMS]
    # 3. other sensors about what a lost one has claimed
    claims = [kept for claim in claims if (kept := _others_word(inputs, claim, seen, fresh, rules)) is not None]
    # 4. who else sees it now, and what time and a person do
    claims = [_seen_by_others(claim, claims, seen, inputs.now_s) for claim in claims]
    claims = [_decayed(claim, inputs, rules) for claim in claims]
    return tuple(claim for claim in claims if not inputs.acknowledged or claim.seen_s == inputs.now_s)


def fresh_sensors(inputs: FusionInputs, memory: FusionMemory) -> frozenset[str]:
    """Whose message has not been counted yet. Without a stamp every input is a message of its own."""
    return frozenset(
        name
        for name, sensor in inputs.witnesses.items()
        if sensor.stamp_ns == 0 or sensor.stamp_ns != memory.stamps_ns.get(name)
    )


def sightings_of(inputs: FusionInputs, name: str) -> tuple[Sighting, ...]:
    """What a sensor shows now: alarms; of an online camera everything in the forward zone."""
    sensor = inputs.witnesses[name]
    if sensor.state == "disconnected" or (name == "camera" and sensor.state != "online"):
        return ()
    sightings, level = sensor.sightings, sensor.level
    if name == "radar" and inputs.abreast is not None:
        sightings, level = inputs.abreast.sightings, inputs.abreast.level
    if name != "camera" and sightings:
        sightings = tuple(one for one in sightings if RANK[one.level] >= RANK["CAUTION"])
    says = None if level == "SAFE" and name != "camera" else level
    if says is not None and all(RANK[one.level] < RANK[says] for one in sightings):
        sightings += (Sighting(says, somewhere_at(sensor.nearest_m), key="message"),)
    if name == "radar" and uses_static(inputs) and sensor.static_level in ("CAUTION", "IMMINENT"):
        sightings += (Sighting(sensor.static_level, None, "standing", key="standing"),)
    return sightings


def somewhere_at(distance_m: float | None) -> Place | None:
    """A place ahead of which only the distance is known."""
    return None if distance_m is None else Place(distance_m, 0.0, UNKNOWN_RADIUS_M)


def uses_static(inputs: FusionInputs) -> bool:
    """R9: standing tracks of a healthy radar fill in for a lidar that is degraded but there."""
    return inputs.radar.state == "online" and inputs.lidar.state == "degraded" and inputs.moving is not False


def carry(inputs: FusionInputs, memory: FusionMemory, rules: RulesConfig) -> Iterable[Claim]:
    """The claims at the places where they are now; what is left behind is gone. Unknown motion moves nothing."""
    speed_mps, yaw_rate_radps = inputs.speed_mps, inputs.yaw_rate_radps
    if memory.at_s is None or inputs.moving is not True or speed_mps is None or yaw_rate_radps is None:
        return memory.claims
    step_s = min(max(0.0, inputs.now_s - memory.at_s), LONGEST_STEP_S)
    way_m, turn_rad = speed_mps * step_s, yaw_rate_radps * step_s
    moved = []
    for claim in memory.claims:
        if claim.place is None:
            moved.append(claim)
            continue
        place, travelled_m = carried(claim.place, way_m, turn_rad, rules.half_width_m), claim.travelled_m + abs(way_m)
        far_m = abs(place.x_m) + abs(place.y_m)
        if is_behind(place, travelled_m, rules.length_m) or far_m - travelled_m > FORGET_M:
            continue
        moved.append(replace(claim, place=place, travelled_m=travelled_m))
    return moved


def is_ahead(claim: Claim, rules: RulesConfig) -> bool:
    """Whether the claim still lies on our way; one that we turned away from sleeps until we turn back."""
    return claim.place is None or not claim.travelled_m or not is_beside(
        claim.place, claim.travelled_m, rules.half_width_m
    )  # fmt: skip


def _own_word(
    inputs: FusionInputs, name: str, own: list[Claim], sightings: tuple[Sighting, ...], fresh: bool, rules: RulesConfig
) -> list[Claim]:
    """A sensor's claims after its newest message: seen ones renewed, new ones made, others counted out."""
    sensor = inputs.witnesses.get(name, NOBODY)
    online = sensor.state == "online"
    shown = match(own, sightings)
    claims = []
    for index, claim in enumerate(own):
        sighting = shown.get(index)
        if sighting is not None and _rank(sighting.level) >= _rank(claim.level):
            kept: Claim | None = _renewed(claim, sighting, inputs.now_s, lost=not online)
        elif not online:
            kept = None if name == "camera" and not claim.counted else replace(claim, lost=True)
        elif not fresh or (claim.lost and not in_view(name, claim.place)):
            kept = claim
        else:
            kept = _counted_out(claim, sighting, _shown(sensor, sighting), inputs.now_s, rules.clear_messages)
        if kept is not None:
            claims.append(kept)
    taken = {id(sighting) for sighting in shown.values()}
    claims += [
        Claim(name, one.level, inputs.now_s, inputs.now_s, one.place, one.what, one.key, lost=not online)
        for one in sightings
        if id(one) not in taken
    ]
    return sorted(claims, key=lambda claim: (-RANK[claim.level], claim.place is not None and claim.place.x_m))


def _renewed(claim: Claim, sighting: Sighting, now_s: float, *, lost: bool) -> Claim:
    return Claim(
        by=claim.by, level=sighting.level, since_s=claim.since_s, seen_s=now_s, place=sighting.place or claim.place,
        what=sighting.what, key=sighting.key, seen_by=claim.seen_by, lost=lost, counted=claim.counted,
    )  # fmt: skip


def _shown(sensor: SensorInput, sighting: Sighting | None) -> Level | None:
    """What a message shows of a claim: what its sensor agreed on, or more in this message alone, which is not free."""
    agreed = None if sighting is None else sighting.level
    return sensor.raw_level if RANK[sensor.raw_level] > RANK[sensor.level] else agreed


def _counted_out(
    claim: Claim, sighting: Sighting | None, shown: Level | None, now_s: float, clear_messages: int
) -> Claim | None:
    """One more message without it, or with less of it; None when that was the last one needed."""
    if _rank(shown) >= _rank(claim.level):
        return replace(claim, since_seen=())
    since_seen = (*claim.since_seen, shown)
    if len(since_seen) < clear_messages:
        return replace(claim, since_seen=since_seen)
    level = max(since_seen, key=_rank)
    if level is None:
        return None
    if sighting is not None and sighting.level == level:
        return _renewed(claim, sighting, now_s, lost=False)
    last = len(since_seen) - since_seen[::-1].index(level)
    return replace(claim, level=level, since_seen=since_seen[last:])


def match(claims: list[Claim], sightings: tuple[Sighting, ...]) -> dict[int, Sighting]:
    """Which sighting shows which claim (by index): the same key, else the nearest within what an object may move."""
    pairs = [
        (distance, index, order)
        for index, claim in enumerate(claims)
        for order, sighting in enumerate(sightings)
        if (distance := _unlikeness(claim, sighting)) < math.inf
    ]
    found: dict[int, Sighting] = {}
    taken: set[int] = set()
    for _, index, order in sorted(pairs):
        if index not in found and order not in taken:
            found[index] = sightings[order]
            taken.add(order)
    return found


def _unlikeness(claim: Claim, sighting: Sighting) -> float:
    """Small when the sighting is probably the claim's object, infinite when it is another."""
    if claim.key or sighting.key:
        return -math.inf if claim.key == sighting.key else math.inf
    if claim.place is None or sighting.place is None:
        return 1e3  # nothing better is known
    distance_m = gap_m(claim.place, sighting.place)
    return distance_m if distance_m <= SAME_OBJECT_M + SAME_OBJECT_SHARE * claim.place.x_m else math.inf


def _others_word(
    inputs: FusionInputs, claim: Claim, seen: Seen, fresh: frozenset[str], rules: RulesConfig
) -> Claim | None:
    """A lost sensor's claim, as those see it that have seen it before: there, counted out, or None when it is over."""
    if not claim.lost or claim.seen_s == inputs.now_s:
        return claim
    sensors = inputs.witnesses
    if claim.by in sensors and sensors[claim.by].state == "online":
        return claim  # it is back and speaks for itself
    able = [
        name
        for name in claim.seen_by
        if name in sensors and sensors[name].state == "online" and in_view(name, claim.place)
    ]
    if any(_shows(one, claim.place) for name in able for one in seen[name]):
        return replace(claim, since_seen=())
    if fresh.isdisjoint(able):
        return claim
    return _counted_out(claim, None, None, inputs.now_s, rules.clear_messages)


def _shows(sighting: Sighting, place: Place | None) -> bool:
    """Whether another sensor's sighting is this object; when a place is unknown it may be."""
    if place is None or sighting.place is None:
        return True
    return gap_m(place, sighting.place) <= SHARED_M + SHARED_SHARE * place.x_m


def _seen_by_others(claim: Claim, claims: list[Claim], seen: Seen, now_s: float) -> Claim:
    """With who has seen it, and only it, at the same time: whoever could mean another object proves nothing."""
    if claim.seen_s != now_s or claim.place is None:
        return claim
    names = set(claim.seen_by)
    for name, sightings in seen.items():
        if name in names or name == claim.by or name in MOVING_ONLY:
            continue
        near = [one for one in sightings if one.place is not None and _shows(one, claim.place)]
        rivals = [one for one in claims if one.by == claim.by and len(near) == 1 and _shows(near[0], one.place)]
        if len(near) == 1 and len(rivals) == 1:
            names.add(name)
    return claim if len(names) == len(claim.seen_by) else replace(claim, seen_by=tuple(sorted(names)))


def _decayed(claim: Claim, inputs: FusionInputs, rules: RulesConfig) -> Claim:
    """Of a standing vehicle, with its sensor out: no longer IMMINENT after a time, and never less than CAUTION."""
    if claim.level != "IMMINENT" or inputs.moving is not False or inputs.now_s - claim.seen_s < rules.decay_s:
        return claim
    sensor = inputs.witnesses.get(claim.by)
    looks = sensor is not None and sensor.state == "online"
    return claim if looks else replace(claim, level="CAUTION")


def count_camera(claims: tuple[Claim, ...], seen_by: tuple[str, ...], at_least: Level) -> tuple[Claim, ...]:
    """Note that the camera's word has counted, and whose word can end it."""
    return tuple(
        replace(claim, counted=True, seen_by=tuple(sorted({*claim.seen_by, *seen_by})))
        if claim.by == "camera" and RANK[claim.level] >= RANK[at_least]
        else claim
        for claim in claims
    )


def level_of(claims: Iterable[Claim]) -> Level | None:
    """The worst of them; None when there is none."""
    levels = [claim.level for claim in claims]
    return worst(*levels) if levels else None


def _rank(level: Level | None) -> int:
    return -1 if level is None else RANK[level]
