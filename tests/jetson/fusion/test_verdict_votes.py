"""Votes and demands one by one: who votes, which claim stands behind a vote, and what is held."""

from __future__ import annotations

import pytest

from common.messages import Level, SensorState
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import Claim, Demand, FusionInputs, SensorInput
from services.jetson.fusion.verdict import camera_demands, cast_votes, decide, foremost, roadside

NOW_S = 100.0
CLEAR = SensorInput("online", "SAFE")


def inputs(radar: SensorInput = CLEAR, camera: SensorInput = CLEAR, pole: SensorInput | None = None) -> FusionInputs:
    return FusionInputs(now_s=NOW_S, moving=None, lidar=CLEAR, radar=radar, camera=camera, roadside=pole)


def claim(by: str, seen_s: float = NOW_S, level: Level = "IMMINENT", key: str = "") -> Claim:
    return Claim(by=by, level=level, since_s=90.0, seen_s=seen_s, key=key, what="something")


@pytest.mark.parametrize(("state", "vote"), [("online", "SAFE"), ("degraded", None), ("disconnected", None)])
def test_only_an_online_sensor_without_a_claim_votes_safe(state: SensorState, vote: Level | None) -> None:
    assert cast_votes(inputs(radar=SensorInput(state, "SAFE")), (), RulesConfig())["radar"] == vote


def test_of_equal_claims_the_moving_one_stands_behind_the_vote() -> None:
    standing, moving = claim("radar", key="standing"), claim("radar", key="7")
    assert foremost((standing, moving), "radar", "IMMINENT") is moving
    assert foremost((moving, standing), "radar", "IMMINENT") is moving


def test_a_newer_standing_claim_stands_before_an_older_moving_one() -> None:
    standing, moving = claim("radar", key="standing"), claim("radar", seen_s=NOW_S - 0.1, key="7")
    assert foremost((moving, standing), "radar", "IMMINENT") is standing


@pytest.mark.parametrize(("seen_s", "rule", "held"), [(NOW_S, "I1-roadside", False), (99.5, "H1-held", True)])
def test_what_the_pole_does_not_see_now_is_held(seen_s: float, rule: str, held: bool) -> None:
    pole = SensorInput("online", "IMMINENT")
    (demand,) = roadside(inputs(pole=pole), {"infra_lidar": "IMMINENT"}, (claim("infra_lidar", seen_s),))
    assert (demand.level, demand.rule, demand.by, demand.held) == ("IMMINENT", rule, "infra_lidar", held)


def test_the_word_of_a_camera_that_is_gone_is_held() -> None:
    votes: dict[str, Level | None] = {"lidar": "SAFE", "radar": "SAFE", "camera": "CAUTION"}
    now = inputs(camera=SensorInput("disconnected", None))
    (demand,) = camera_demands(now, votes, (claim("camera", 99.0),), [], RulesConfig())
    assert (demand.level, demand.rule, demand.by, demand.held) == ("CAUTION", "H1-held", "camera", True)


def test_of_equal_demands_what_is_seen_now_is_told() -> None:
    held, seen = Demand("CAUTION", "H1-held", "then", "lidar", held=True), Demand("CAUTION", "R1-worst-case", "now")
    assert decide(inputs(), {}, (), [held, seen], False) is seen
    assert decide(inputs(), {}, (), [seen, held], False) is seen
