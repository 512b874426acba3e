"""Whose word ends a claim, and what does not: the rules on their own, message by message."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import Place, Sighting
from services.jetson.fusion.verdict import FusionInputs, FusionMemory, SensorInput, fuse

CLEAR = SensorInput(state="online", level="SAFE", age_s=0.02)
EMPTY = SensorInput(state="online", level=None, age_s=0.1)
LOST = SensorInput(state="disconnected", level=None, reason="gone")


def sees(level: Any, *places: Place, state: Any = "online") -> SensorInput:
    """A message that shows objects at these places."""
    return SensorInput(state=state, level=level, age_s=0.02, sightings=tuple(Sighting(level, one) for one in places))


class Run:
    """Fuses message by message, a tenth of a second apart, and keeps the memory."""

    def __init__(self, **rules: Any) -> None:
        self.memory, self.rules, self.now_s = FusionMemory(), RulesConfig(suppression="off", **rules), 10.0

    def step(self, count: int = 1, **changes: Any) -> Any:
        for _ in range(count):
            self.now_s = round(self.now_s + 0.1, 6)
            sensors = {"lidar": CLEAR, "radar": CLEAR, "camera": EMPTY, "moving": None} | changes
            verdict, self.memory = fuse(FusionInputs(now_s=self.now_s, **sensors), self.memory, self.rules)
        return verdict


BOX, BESIDE = Place(0.6, 0.0, 0.1), Place(0.6, 0.8, 0.1)


@pytest.mark.parametrize(("messages", "level"), [(7, "IMMINENT"), (8, "SAFE")])
def test_another_sensor_that_had_seen_it_may_say_that_it_has_gone(messages: int, level: str) -> None:
    run = Run()
    run.step(lidar=sees("IMMINENT", BOX), camera=sees("CAUTION", BOX))
    run.step(lidar=LOST, camera=sees("CAUTION", BOX))
    assert run.step(20, lidar=LOST, camera=sees("CAUTION", BOX)).level == "IMMINENT", "it is still there"
    assert run.step(messages, lidar=LOST).level == level


def test_one_that_never_saw_it_may_not() -> None:
    run = Run()
    run.step(lidar=sees("IMMINENT", BOX))
    assert run.step(50, lidar=LOST).level == "IMMINENT"


def test_one_that_saw_something_else_may_not() -> None:
    run = Run()
    run.step(lidar=sees("IMMINENT", BOX), camera=sees("CAUTION", BESIDE))
    assert run.step(50, lidar=LOST).level == "IMMINENT"


def test_one_that_may_have_meant_another_may_not() -> None:
    run = Run()
    run.step(lidar=sees("IMMINENT", BOX, Place(0.9, 0.0, 0.1)), camera=sees("CAUTION", Place(0.75, 0.0, 0.1)))
    assert run.step(50, lidar=LOST).level == "IMMINENT"


def test_the_radar_may_not_it_does_not_see_what_stands() -> None:
    run = Run()
    run.step(lidar=sees("IMMINENT", BOX), radar=sees("IMMINENT", BOX))
    assert run.step(50, lidar=LOST).level == "IMMINENT"


def test_nor_one_that_is_out_or_looks_elsewhere() -> None:
    run = Run()
    run.step(lidar=sees("IMMINENT", BOX), camera=sees("CAUTION", BOX))
    blind = SensorInput(state="degraded", level=None, reason="dark")
    assert run.step(50, lidar=LOST, camera=blind).level == "IMMINENT"


def test_the_camera_s_word_in_the_lidar_s_place_ends_with_a_clear_lidar() -> None:
    run = Run()
    assert run.step(lidar=LOST, camera=sees("SAFE", BOX)).rule == "R5-camera-stands-in"
    verdict = run.step(lidar=CLEAR, camera=LOST)
    assert verdict.rule == "H1-held"
    assert verdict.to_lower.startswith("camera online and clear there or LiDAR online and clear there")
    assert run.step(6, lidar=CLEAR, camera=LOST).level == "CAUTION"
    assert run.step(lidar=CLEAR, camera=LOST).level == "SAFE"


def test_the_camera_s_advice_dies_with_it() -> None:
    run = Run()
    assert run.step(camera=sees("IMMINENT", BOX)).advisory == "CAMERA_ONLY"
    assert run.step(camera=LOST).level == "SAFE"
    assert run.memory.claims == ()


def test_a_confirmation_of_the_radar_is_not_ended_by_a_lidar_that_sees_nothing() -> None:
    run = Run()
    assert run.step(radar=sees("CAUTION", BOX), camera=sees("IMMINENT", BOX)).rule == "R3-confirmed"
    assert run.step(50, radar=sees("CAUTION", BOX), camera=LOST).level == "IMMINENT"


def test_what_confirms_has_counted_from_caution_on() -> None:
    run = Run()
    far = Sighting("SAFE", Place(4.0, 0.0, 0.1))
    run.step(
        lidar=sees("CAUTION", BOX), camera=replace(sees("CAUTION", BOX), sightings=(Sighting("CAUTION", BOX), far))
    )
    counted = {claim.level: claim.counted for claim in run.memory.claims if claim.by == "camera"}
    assert counted == {"CAUTION": True, "SAFE": False}


@pytest.mark.parametrize(("ranging", "may_end"), [("lidar", ("lidar",)), ("radar", ())])
def test_a_lidar_that_alarmed_as_well_may_end_what_the_camera_confirmed(ranging: str, may_end: Any) -> None:
    run, somewhere = Run(), SensorInput(state="online", level="CAUTION", age_s=0.02)
    run.step(camera=somewhere, **{ranging: somewhere})
    (confirmed,) = [claim for claim in run.memory.claims if claim.by == "camera"]
    assert (confirmed.counted, confirmed.seen_by) == (True, may_end)


def test_a_confirmation_that_may_not_raise_is_not_kept() -> None:
    run = Run(camera_may_raise=False)
    assert run.step(lidar=sees("CAUTION", BOX), camera=sees("IMMINENT", BOX)).level == "CAUTION"
    assert run.step(lidar=sees("CAUTION", BOX), camera=LOST).level == "CAUTION"


def test_each_object_has_a_claim_of_its_own() -> None:
    run = Run()
    far = Place(1.6, 0.2, 0.1)
    run.step(lidar=replace(CLEAR, level="IMMINENT", sightings=(Sighting("IMMINENT", BOX), Sighting("CAUTION", far))))
    assert {(claim.level, claim.place) for claim in run.memory.claims} == {("IMMINENT", BOX), ("CAUTION", far)}
    verdict = run.step(7, lidar=sees("CAUTION", far))
    assert (verdict.level, verdict.rule) == ("IMMINENT", "H1-held"), "of the two the one at this level is told"
    assert run.step(1, lidar=sees("CAUTION", far)).level == "CAUTION"


def test_a_repeated_message_counts_once() -> None:
    run = Run()
    run.step(lidar=replace(sees("IMMINENT", BOX), stamp_ns=1))
    assert run.step(50, lidar=replace(CLEAR, stamp_ns=2)).level == "IMMINENT"
    for stamp_ns in range(3, 9):
        assert run.step(lidar=replace(CLEAR, stamp_ns=stamp_ns)).level == "IMMINENT"
    assert run.step(lidar=replace(CLEAR, stamp_ns=9)).level == "SAFE"


@pytest.mark.parametrize(
    ("moving", "lidar", "level"),
    [
        (False, LOST, "CAUTION"),
        (None, LOST, "IMMINENT"),
        (True, LOST, "IMMINENT"),
        (False, replace(CLEAR, stamp_ns=7), "IMMINENT"),
    ],
    ids=["standing", "unknown", "driving", "looked at"],
)
def test_only_a_standing_vehicle_with_nobody_looking_has_less_after_a_time(
    moving: Any, lidar: SensorInput, level: str
) -> None:
    run = Run()
    run.step(lidar=sees("IMMINENT", BOX))
    run.step(lidar=LOST)
    run.step(lidar=lidar, moving=moving)
    assert run.step(95, lidar=lidar, moving=moving).level == "IMMINENT"
    assert run.step(5, lidar=lidar, moving=moving).level == level


def test_a_person_ends_what_is_not_seen_now() -> None:
    run = Run()
    run.step(lidar=sees("IMMINENT", BOX), radar=sees("CAUTION", BOX))
    assert run.step(lidar=LOST, radar=sees("CAUTION", BOX), acknowledged=True).level == "CAUTION"


def test_the_verdict_lists_its_claims_and_says_who_could_end_them() -> None:
    run = Run()
    run.step(lidar=sees("IMMINENT", BOX), camera=sees("CAUTION", BOX))
    verdict = run.step(5, lidar=LOST, camera=sees("CAUTION", BOX))
    (claim, *_) = [one for one in verdict.claims if one.by == "lidar"]
    assert (claim.level, claim.seen, claim.x_m, claim.y_m, claim.radius_m) == ("IMMINENT", False, 0.6, 0.0, 0.1)
    assert (claim.since_ms, claim.seen_ms) == (500, 500)
    assert "camera online and clear there" in verdict.to_lower
    assert "spotter acknowledge" in verdict.to_lower
    assert verdict.because == "LiDAR said IMMINENT at 0.60 m 0.5 s ago and went disconnected; " + (
        "nobody has seen the place free since"
    )


def test_only_known_motion_moves_a_place() -> None:
    for motion in ({"speed_mps": 1.0}, {"speed_mps": 1.0, "yaw_rate_radps": 0.0}, {"yaw_rate_radps": 0.0}):
        run = Run()
        run.step(lidar=sees("CAUTION", Place(1.5, 0.0, 0.1)))
        run.step(5, lidar=LOST, moving=None, **motion)
        (claim,) = run.memory.claims
        assert claim.place == Place(1.5, 0.0, 0.1)
    run = Run()
    run.step(lidar=sees("CAUTION", Place(1.5, 0.0, 0.1)))
    run.step(5, lidar=LOST, moving=True, speed_mps=1.0, yaw_rate_radps=0.0)
    (claim,) = run.memory.claims
    assert claim.place is not None
    assert (claim.place.x_m, claim.travelled_m) == (pytest.approx(1.0), pytest.approx(0.5))
