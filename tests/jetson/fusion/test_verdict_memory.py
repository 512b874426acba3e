"""What time does to the verdict: suppression, hold, and the numbers in the rules."""

from __future__ import annotations

from typing import Any

import pytest

from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.verdict import FusionInputs, FusionMemory, SensorInput, fuse

ONLINE = SensorInput(state="online", level="SAFE", age_s=0.02)
EMPTY = SensorInput(state="online", level=None, age_s=0.1)
LOST = SensorInput(state="disconnected", level=None, age_s=2.0, reason="gone")


def detected(level: Any = "CAUTION", nearest_m: float | None = None) -> SensorInput:
    return SensorInput(state="online", level=level, age_s=0.02, nearest_m=nearest_m)


class Run:
    """Fuses step by step and keeps the memory."""

    def __init__(self, rules: RulesConfig | None = None) -> None:
        self.memory, self.rules = FusionMemory(), rules or RulesConfig()

    def at(self, now_s: float, **sensors: Any) -> Any:
        inputs = {"lidar": ONLINE, "radar": ONLINE, "camera": EMPTY, "moving": None} | sensors
        verdict, self.memory = fuse(FusionInputs(now_s=now_s, **inputs), self.memory, self.rules)
        return verdict


def test_suppression_lasts_less_than_a_second_and_then_it_is_caution() -> None:
    run = Run()
    for step in range(10):
        verdict = run.at(step * 0.1, lidar=detected())
        assert (verdict.level, verdict.rule, verdict.suppressed) == ("SAFE", "R4-suppressed", True)
    verdict = run.at(1.0, lidar=detected())
    assert (verdict.level, verdict.suppressed, verdict.confirmed) == ("CAUTION", False, False)
    assert (verdict.rule, verdict.permission) == ("R1-worst-case", "SLOW")


def test_the_second_begins_with_the_detection_not_with_the_suppression() -> None:
    run = Run()
    old = SensorInput(state="online", level=None, age_s=0.7)
    assert run.at(0.0, lidar=detected(), camera=old).level == "CAUTION"
    assert run.at(0.9, lidar=detected()).level == "SAFE"
    assert run.at(1.0, lidar=detected()).level == "CAUTION"


def test_gaps_do_not_refill_the_budget() -> None:
    """The lidar sees something for 0.9 s, misses it for a second, and so on."""
    run, levels = Run(), []
    for step in range(100):
        seen = step % 19 < 9
        levels.append(run.at(step * 0.1, lidar=detected() if seen else ONLINE).level)
    assert set(levels[:10]) == {"SAFE"}
    assert all(level == "CAUTION" for step, level in enumerate(levels) if step >= 19 and step % 19 < 9)


@pytest.mark.parametrize("refill_s", [30.0, 5.0])
def test_only_a_long_clear_time_refills_it(refill_s: float) -> None:
    rules = RulesConfig(suppression_refill_s=refill_s, clear_messages=1)
    for clear_s, suppressed in ((refill_s - 0.01, False), (refill_s, True)):
        run = Run(rules)
        run.at(0.0, lidar=detected())
        run.at(2.0, lidar=ONLINE)
        run.at(2.0 + clear_s / 2, lidar=ONLINE)
        run.at(2.0 + clear_s, lidar=ONLINE)
        assert run.at(2.1 + clear_s, lidar=detected()).suppressed is suppressed


def test_only_a_clear_lidar_refills_it() -> None:
    run = Run(RulesConfig(clear_messages=1))
    run.at(0.0, lidar=detected())
    run.at(1.0, lidar=ONLINE)
    run.at(20.0, lidar=SensorInput(state="degraded", level="SAFE"))
    run.at(25.0, lidar=ONLINE)
    run.at(40.0, lidar=ONLINE)
    assert run.at(40.1, lidar=detected()).level == "CAUTION"


@pytest.mark.parametrize(
    "spender",
    [
        {"lidar": detected("IMMINENT")},
        {"camera": detected("SAFE")},
        {"camera": detected("CAUTION")},
        {"radar": detected()},
    ],
    ids=["imminent", "anything in the picture", "confirmed", "radar"],
)
def test_what_was_confirmed_once_is_never_held_back(spender: dict[str, Any]) -> None:
    run = Run(RulesConfig(clear_messages=1))
    assert run.at(0.0, lidar=detected()).suppressed
    run.at(0.1, **({"lidar": detected()} | spender))
    for now_s in (0.2, 0.3):
        assert run.at(now_s, lidar=detected()).level == "CAUTION"


def test_closing_by_ten_centimetres_ends_it_for_good() -> None:
    run = Run()
    assert run.at(0.0, lidar=detected(nearest_m=1.50)).suppressed
    assert run.at(0.1, lidar=detected(nearest_m=1.60)).suppressed
    assert run.at(0.2, lidar=detected(nearest_m=1.51)).suppressed
    assert run.at(0.3, lidar=detected(nearest_m=1.50)).level == "CAUTION"
    verdict = run.at(0.4, lidar=detected(nearest_m=1.60))
    assert verdict.level == "CAUTION"
    assert "no longer holds it back" in verdict.to_lower


def test_closing_by_exactly_the_limit_is_closing() -> None:
    run = Run(RulesConfig(suppression_closing_m=0.25))
    assert run.at(0.0, lidar=detected(nearest_m=1.5)).suppressed
    assert run.at(0.1, lidar=detected(nearest_m=1.25)).level == "CAUTION"


def test_the_radar_leaving_safe_ends_it_for_good() -> None:
    run = Run()
    assert run.at(0.0, lidar=detected()).suppressed
    assert run.at(0.1, lidar=detected(), radar=detected()).level == "CAUTION"
    assert run.at(0.2, lidar=detected()).level == "CAUTION"


@pytest.mark.parametrize("lost", ["radar", "camera"])
def test_losing_a_sensor_ends_it_at_once(lost: str) -> None:
    run = Run()
    assert run.at(0.0, lidar=detected()).suppressed
    assert run.at(0.1, lidar=detected(), **{lost: LOST}).level == "CAUTION"


@pytest.mark.parametrize(("age_s", "level"), [(0.5, "SAFE"), (0.51, "CAUTION"), (None, "CAUTION"), (-0.6, "CAUTION")])
def test_an_old_or_undated_picture_suppresses_nothing(age_s: float | None, level: str) -> None:
    picture = SensorInput(state="online", level=None, age_s=age_s)
    assert Run().at(0.0, lidar=detected(), camera=picture).level == level


@pytest.mark.parametrize(("age_s", "level"), [(0.5, "IMMINENT"), (0.51, "CAUTION")])
def test_an_old_picture_confirms_nothing(age_s: float, level: str) -> None:
    picture = SensorInput(state="online", level="IMMINENT", age_s=age_s)
    verdict = Run().at(0.0, lidar=detected(), camera=picture)
    assert (verdict.level, verdict.confirmed) == (level, age_s <= 0.5)


def test_imminent_is_never_suppressed() -> None:
    for suppression in ("off", "limited", "full"):
        run = Run(RulesConfig(suppression=suppression))  # type: ignore[arg-type]
        assert run.at(0.0, lidar=detected("IMMINENT")).level == "IMMINENT"


@pytest.mark.parametrize(("level", "permission"), [("SAFE", "GO"), ("CAUTION", "SLOW"), ("IMMINENT", "STOP")])
def test_what_each_level_permits(level: str, permission: str) -> None:
    verdict = Run(RulesConfig(suppression="off")).at(0.0, lidar=detected(level))
    assert (verdict.level, verdict.permission) == (level, permission)


@pytest.mark.parametrize(("speed_mps", "rule"), [(0.0, "R0-clear"), (-0.01, "M1-reversing")])
def test_only_backwards_is_reversing(speed_mps: float, rule: str) -> None:
    assert Run().at(0.0, moving=True, speed_mps=speed_mps, yaw_rate_radps=0.0).rule == rule


def test_suppression_can_be_off_or_without_limit() -> None:
    assert Run(RulesConfig(suppression="off")).at(0.0, lidar=detected()).level == "CAUTION"
    run = Run(RulesConfig(suppression="full"))
    assert all(run.at(now_s, lidar=detected()).suppressed for now_s in (0.0, 1.0, 60.0))
    assert run.at(61.0, lidar=detected(), radar=detected()).level == "CAUTION"


def test_the_camera_may_be_forbidden_to_raise() -> None:
    picture = SensorInput(state="online", level="IMMINENT", age_s=0.1)
    verdict = Run(RulesConfig(camera_may_raise=False)).at(0.0, lidar=detected(), camera=picture)
    assert (verdict.level, verdict.confirmed) == ("CAUTION", True)


def test_time_running_backwards_suppresses_nothing() -> None:
    run = Run()
    run.at(100.0, lidar=detected())
    assert run.at(50.0, lidar=detected()).level == "CAUTION"


def test_the_verdict_names_the_object_and_what_would_lower_it() -> None:
    zone = {"zone": "centre", "nearest_m": 0.62}
    lidar = SensorInput(state="online", level="IMMINENT", age_s=0.02, nearest_m=0.62, deciding=zone)
    verdict = Run().at(0.0, lidar=lidar, radar=LOST)
    assert verdict.because == "LiDAR IMMINENT at 0.62 m (centre)"
    assert verdict.deciding == zone
    assert verdict.to_lower == "LiDAR to report less than IMMINENT"
    assert verdict.inputs["lidar"].used
    assert verdict.inputs["radar"].why == "disconnected: gone; no vote, which is not a vote for SAFE"
    assert not verdict.inputs["radar"].used
    assert (verdict.stamp_ns, verdict.inputs["lidar"].stamp_ns) == (0, 0), "nobody told"


@pytest.mark.parametrize(
    ("sensors", "rule", "to_lower"),
    [
        ({"radar": LOST, "camera": LOST}, "R7-two-out", "radar online again or camera online again"),
        ({"lidar": LOST, "radar": LOST, "camera": LOST}, "R7-blind", "two of:"),
        ({"starting": ("radar",), "radar": LOST}, "A25-starting", "a first message from radar"),
        ({"distrust": ("pi0 stepped",)}, "C1-clock", "clock offset"),
        ({"lidar": LOST, "camera": detected("SAFE")}, "R5-camera-stands-in", "LiDAR online again"),
        ({"radar": detected()}, "R1-worst-case", "radar to report SAFE"),
        ({"roadside": detected("CAUTION")}, "I1-roadside", "the roadside object off the vehicle's path"),
        ({"lidar": detected(), "camera": detected()}, "R3-confirmed", "LiDAR to report SAFE"),
        (
            {"lidar": detected(), "radar": detected()},
            "R1-worst-case",
            "LiDAR to report SAFE (an empty picture no longer holds it back); and radar to report SAFE",
        ),
    ],
)
def test_the_deciding_rule_and_the_way_down(sensors: dict[str, Any], rule: str, to_lower: str) -> None:
    verdict = Run().at(0.0, **sensors)
    assert (verdict.level, verdict.rule) == ("CAUTION", rule)
    assert verdict.to_lower.startswith(to_lower)


def test_a_clear_verdict_names_who_can_see() -> None:
    assert Run().at(0.0).because == "LiDAR, radar, camera see nothing near"
    assert Run().at(0.0, radar=LOST).because == "LiDAR, camera see nothing near"


def test_standing_radar_tracks_count_with_a_degraded_lidar_unless_the_vehicle_stands() -> None:
    degraded = SensorInput(state="degraded", level=None, age_s=0.02, reason="37 scans blocked")
    radar = SensorInput(state="online", level="SAFE", age_s=0.02, static_level="IMMINENT")
    for moving, level in ((True, "IMMINENT"), (None, "IMMINENT"), (False, "SAFE")):
        verdict = Run().at(0.0, lidar=degraded, radar=radar, moving=moving)
        assert verdict.level == level
        assert (verdict.rule == "R9-static-radar") == (level == "IMMINENT")


def test_an_earlier_pictures_alarm_is_not_told_with_the_distance_of_this_one() -> None:
    """A person at 0.4 m, and in the next picture a car far off: what was alarming is told as something of the past."""
    run = Run()
    near = SensorInput(state="online", level="IMMINENT", age_s=0.1, nearest_m=0.4, deciding={"label": "person"})
    far = SensorInput(state="online", level="SAFE", age_s=0.1, nearest_m=8.9, deciding={"label": "car"})
    assert "camera IMMINENT at 0.40 m (person)" in run.at(0.0, lidar=detected("IMMINENT", 0.4), camera=near).because
    verdict = run.at(0.1, lidar=detected("IMMINENT", 0.4), camera=far)
    assert "8.9" not in verdict.because
    assert verdict.because.startswith("camera said IMMINENT at 0.40 m 0.1 s ago"), "its own word, not the lidar's"
    alone = Run()
    assert alone.at(0.0, camera=near).because == "camera IMMINENT at 0.40 m (person), but LiDAR and radar are clear"
    assert alone.at(0.1, camera=far).because == (
        "camera said IMMINENT at 0.40 m 0.1 s ago; less or nothing in its last message, too few to lower it, "
        "but LiDAR and radar are clear"
    )
    assert "in its last two messages" in alone.at(0.2, camera=far).because
