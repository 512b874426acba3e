"""Inputs and claims that two test files build by hand."""

from __future__ import annotations

from typing import Any

from services.jetson.fusion.claims import update_claims
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import Claim, FusionInputs, FusionMemory, Place, SensorInput, Sighting

RULES = RulesConfig(clear_messages=3, decay_s=10.0, length_m=0.5, half_width_m=0.5)
CLEAR = SensorInput(state="online", level="SAFE")
EMPTY = SensorInput(state="online", level=None)
GONE = SensorInput(state="disconnected", level=None)
HERE, AT_2 = Place(1.0, 0.0, 0.0), Place(2.0, 0.0, 0.3)


def inputs(now_s: float = 10.0, moving: Any = None, **fields: Any) -> FusionInputs:
    return FusionInputs(now_s=now_s, moving=moving, **({"lidar": CLEAR, "radar": CLEAR, "camera": EMPTY} | fields))


def claim(place: Place | None = HERE, level: Any = "IMMINENT", by: str = "lidar", **more: Any) -> Claim:
    return Claim(**({"by": by, "level": level, "since_s": 9.0, "seen_s": 9.9, "place": place} | more))


def shows(level: Any, *places: Place | None, state: Any = "online", **more: Any) -> SensorInput:
    return SensorInput(state, level, sightings=tuple(Sighting(level, one) for one in places), **more)


def after(given: FusionInputs, *claims: Claim, **memory: Any) -> tuple[Claim, ...]:
    return update_claims(given, FusionMemory(at_s=9.9, claims=claims, **memory), RULES)
