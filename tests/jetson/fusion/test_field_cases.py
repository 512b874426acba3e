"""Cases from the field: an alarm is not talked down by a loss. The pipeline in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from common.messages import EgoMotion
from services.jetson.fusion.config import FusionConfig, RoadsideConfig

STOP = ("IMMINENT", "STOP")


def outcome(verdict: Any) -> tuple[str, str]:
    return verdict.level, verdict.permission


def cover(bench: Any, name: str) -> None:
    bench.extra[name] = {"state": "degraded", "reason": "covered"}
    bench.levels[name] = "SAFE"


LOSSES: dict[str, Callable[[Any, str], Any]] = {
    "killed": lambda bench, name: bench.kill(name),
    "silent": lambda bench, name: bench.silent.add(name),
    "unplugged": lambda bench, name: bench.status(name, "disconnected", "no device") or bench.silent.add(name),
    "late": lambda bench, name: bench.delay_s.update({name: 3.0}),
    "covered": cover,
    "link cut": lambda bench, _: setattr(bench, "isolated", True),
    "clock wrong": lambda bench, name: bench.clock_s.update({name: -7200.0}),
}


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("name", ["lidar", "radar"])
def test_losing_the_sensor_that_raised_an_alarm_does_not_end_it(bench: Any, name: str, loss: str) -> None:
    """A box at 0.40 m that only the lidar can see; a walker that only the radar sees."""
    bench.levels[name] = "IMMINENT"
    assert outcome(bench.run(0.5)) == STOP
    LOSSES[loss](bench, name)
    assert bench.outcomes(60.0) == {STOP}
    assert bench.verdict.rule == ("R1-worst-case" if loss == "clock wrong" else "H1-held")


@pytest.mark.parametrize("name", ["lidar", "radar"])
def test_it_ends_when_the_sensor_is_back_and_sees_nothing(bench: Any, name: str) -> None:
    bench.levels[name] = "IMMINENT"
    bench.run(0.5)
    bench.kill(name)
    bench.run(5.0)
    bench.start(name)
    bench.levels[name] = "SAFE"
    assert bench.until(lambda: bench.verdict.level == "SAFE", 1.3) > 0.9, "three good messages, then eight clear ones"


def test_what_comes_back_covered_or_sees_it_still_ends_nothing(bench: Any) -> None:
    bench.levels["lidar"] = "IMMINENT"
    bench.run(0.5)
    bench.kill("lidar")
    bench.run(1.0)
    bench.start("lidar")
    cover(bench, "lidar")
    assert bench.outcomes(5.0) == {STOP}
    bench.extra["lidar"], bench.levels["lidar"] = {}, "CAUTION"
    bench.run(2.0)
    assert bench.outcomes(5.0) == {("CAUTION", "SLOW")}, "it is back and sees it farther away"


def test_a_standing_vehicle_is_left_with_caution_and_never_with_less(bench: Any) -> None:
    def standing() -> None:
        still = EgoMotion(stamp_ns=bench.now_ns, speed_mps=0.0, yaw_rate_radps=0.0)
        bench.receive("jetson0/ego/motion", still)

    bench.levels["lidar"] = "IMMINENT"
    bench.run(0.5)
    bench.kill("lidar")
    levels = []
    for _ in range(2400):
        standing()
        levels.append(bench.tick().level)
    assert set(levels[:195]) == {"IMMINENT"}
    assert set(levels[205:]) == {"CAUTION"}


def test_a_person_ends_what_nobody_sees_and_nothing_else(bench: Any) -> None:
    bench.levels["lidar"] = bench.levels["radar"] = "IMMINENT"
    bench.run(0.5)
    bench.kill("lidar")
    bench.run(1.0)
    assert outcome(bench.acknowledge()) == STOP
    assert bench.verdict.because.startswith("radar IMMINENT")
    bench.kill("radar")
    bench.run(1.0)
    assert outcome(bench.verdict) == STOP
    assert outcome(bench.acknowledge()) == ("CAUTION", "SLOW"), "two sensors are out"
    bench.start("lidar")
    bench.levels["lidar"] = "SAFE"
    assert bench.run(1.0).level == "SAFE"


def test_a_restart_of_fusion_ends_nothing(bench: Any) -> None:
    bench.levels["lidar"] = "IMMINENT"
    bench.run(0.5)
    bench.kill("lidar")
    bench.run(1.0)
    for gap_s in (0.2, 3.0, 300.0):
        bench.restart_fusion(gap_s)
        assert {level for level, _ in bench.outcomes(5.0)} == {"IMMINENT"}


def test_a_roadside_alarm_outlives_the_roadside_link(new_bench: Any, messages: Any) -> None:
    bench = new_bench(FusionConfig(roadside=RoadsideConfig(enabled=True)))
    bench.run(1.0)
    bench.extra["infra_lidar"] = {"tracks": [messages.car()]}
    assert outcome(bench.run(0.5)) == STOP
    bench.kill("infra_lidar")
    assert bench.outcomes(20.0) == {STOP}
    bench.extra["infra_lidar"] = {}
    bench.start("infra_lidar")
    assert bench.run(2.0).level == "SAFE"


def test_the_camera_s_confirmation_outlives_the_camera(bench: Any) -> None:
    bench.levels["lidar"], bench.levels["camera"] = "CAUTION", "IMMINENT"
    assert bench.run(0.5).rule == "R3-confirmed"
    bench.kill("camera")
    assert bench.outcomes(20.0) == {STOP}
    bench.levels["lidar"] = "SAFE"
    assert bench.run(1.0).level == "SAFE", "the lidar had seen it, and sees that it is gone"


def test_a_place_that_we_turn_away_from_sleeps_and_is_left_behind(bench: Any) -> None:
    bench.extra["lidar"] = {"nearest_m": 1.0}
    bench.levels["lidar"] = "CAUTION"
    bench.run(1.2)
    bench.kill("lidar")
    bench.drive(0.1, 0.0, 1.0)
    assert bench.verdict.level == "CAUTION"
    bench.drive(0.1, -1.0, 1.5)
    assert bench.verdict.level == "SAFE", "it is on our left now"
    bench.drive(0.1, 1.0, 1.5)
    assert bench.verdict.level == "CAUTION", "we turned back, and nobody has seen it free"
    bench.drive(0.1, -1.0, 1.5)
    bench.drive(1.0, 0.0, 4.0)
    assert (bench.verdict.level, bench.verdict.claims) == ("SAFE", []), "left behind"


def test_driving_straight_at_it_is_no_way_to_leave_it_behind(bench: Any) -> None:
    """Either we push it along, or the motion is wrong, or it has gone: a sensor or a person has to say."""
    bench.extra["lidar"] = {"nearest_m": 0.5}
    bench.levels["lidar"] = "IMMINENT"
    bench.run(0.3)
    bench.kill("lidar")
    bench.drive(2.0, 0.0, 20.0)
    assert outcome(bench.verdict) == STOP
