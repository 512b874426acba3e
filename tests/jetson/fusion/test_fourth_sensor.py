"""Any number of on-board sensors: the bar and the verdict with a made-up fourth one, a sonar."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest

from common.messages import LEVELS, CompressedImage
from common.topics import SENSOR_TOPICS
from services.jetson.fusion.bar import bar
from services.jetson.fusion.pipeline import NOT_FITTED, Step
from services.jetson.fusion.readings import read
from services.jetson.fusion.trace import decide_again, trace_of
from services.jetson.fusion.verdict import DEFAULT_RULES, FusionInputs, FusionMemory, SensorInput, fuse
from spotter_tools.drill.monitor import broken_rules

GOLDEN = Path(__file__).parent / "golden_verdicts.csv"
FOUR = ("lidar", "radar", "camera", "sonar")
CLEAR = SensorInput(state="online", level="SAFE", age_s=0.02)
EMPTY = SensorInput(state="online", level=None, age_s=0.1)
LOST = SensorInput(state="disconnected", level=None, age_s=2.0, reason="gone")

# lidar, radar, camera, sonar: on, degraded or disconnected; colour; text. None, then 1, 2, 3 and 4 of 4 out.
BAR = """
on on on on | green | ALL VEHICLE SENSORS ONLINE
disc on on on | amber | LiDAR DISCONNECTED: no geometric range
on on on deg | amber | sonar DEGRADED: no sonar data
disc deg on on | red | LiDAR DISCONNECTED + radar DEGRADED: only camera + sonar left
on on disc disc | red | camera DISCONNECTED + sonar DISCONNECTED: only LiDAR + radar left
disc disc deg on | red | LiDAR DISCONNECTED + radar DISCONNECTED + camera DEGRADED: sonar only
on deg deg deg | red | radar DEGRADED + camera DEGRADED + sonar DEGRADED: LiDAR only, no velocity
deg disc disc deg | red | ALL VEHICLE SENSORS OUT, SYSTEM BLIND
"""
STATE = {"on": "online", "deg": "degraded", "disc": "disconnected"}


def inputs(now_s: float = 0.0, sonar: SensorInput = CLEAR, **sensors: Any) -> FusionInputs:
    three: dict[str, Any] = {"lidar": CLEAR, "radar": CLEAR, "camera": EMPTY}
    return FusionInputs(now_s=now_s, moving=None, others={"sonar": sonar}, **(three | sensors))


def seen(level: Any, state: Any = "online") -> SensorInput:
    return SensorInput(state=state, level=level, age_s=0.02, nearest_m=0.4)


def out_of_four(names: tuple[str, ...]) -> FusionInputs:
    return inputs(**dict.fromkeys(names, LOST))


@pytest.mark.parametrize("row", BAR.strip().splitlines())
def test_the_bar_of_four(row: str) -> None:
    states, colour, text = (part.strip() for part in row.split("|"))
    by_name: Any = dict(zip(FOUR, (STATE[state] for state in states.split()), strict=True))
    assert bar(by_name) == (colour, text)


@pytest.mark.parametrize(
    ("out", "level", "rule", "permission", "because", "to_lower"),
    [
        (FOUR[:1], "SAFE", "R0-clear", "GO", "radar, camera, sonar see nothing near", ""),
        (
            FOUR[:2], "CAUTION", "R7-two-out", "SLOW",
            "two of four sensors out: LiDAR disconnected, radar disconnected",
            "LiDAR online again or radar online again",
        ),
        (
            FOUR[:3], "CAUTION", "R7-two-out", "SLOW",
            "three of four sensors out: LiDAR disconnected, radar disconnected, camera disconnected",
            "two of: LiDAR online again, radar online again, camera online again",
        ),
        (
            FOUR, "CAUTION", "R7-blind", "STOP",
            "blind: LiDAR disconnected, radar disconnected, camera disconnected, sonar disconnected",
            "three of: LiDAR online again, radar online again, camera online again, sonar online again",
        ),
    ],
    ids=["1 of 4", "2 of 4", "3 of 4", "4 of 4"],
)  # fmt: skip
def test_sensors_out(out: tuple[str, ...], level: str, rule: str, permission: str, because: str, to_lower: str) -> None:
    verdict, _ = fuse(out_of_four(out), FusionMemory())
    assert (verdict.level, verdict.rule, verdict.permission) == (level, rule, permission)
    assert (verdict.because, verdict.to_lower) == (because, to_lower)
    assert verdict.blind == (out == FOUR)
    assert broken_rules(verdict, FOUR) == []


def test_the_only_sensor_out() -> None:
    only_radar = FusionInputs(now_s=0.0, moving=None, lidar=NOT_FITTED, radar=LOST, camera=NOT_FITTED)
    verdict, _ = fuse(only_radar, FusionMemory())
    assert (verdict.rule, verdict.because) == ("R7-blind", "blind: radar disconnected")
    assert verdict.to_lower == "radar online again"


@pytest.mark.parametrize(
    ("lidar", "to_lower"),
    [(NOT_FITTED, "the camera's forward zone empty"), (LOST, "LiDAR online again, or the camera's forward zone empty")],
)
def test_what_is_not_fitted_is_not_waited_for(lidar: SensorInput, to_lower: str) -> None:
    ahead = seen("CAUTION")
    verdict, _ = fuse(FusionInputs(now_s=0.0, moving=None, lidar=lidar, radar=CLEAR, camera=ahead), FusionMemory())
    assert (verdict.rule, verdict.to_lower) == ("R5-camera-stands-in", to_lower)


@pytest.mark.parametrize("state", ["online", "degraded"])
@pytest.mark.parametrize("level", ["CAUTION", "IMMINENT"])
def test_its_alarm_counts_like_lidar_and_radar(level: str, state: str) -> None:
    verdict, _ = fuse(inputs(sonar=seen(level, state)), FusionMemory())
    assert (verdict.level, verdict.rule, verdict.because) == (level, "N1-near-range", f"sonar {level} at 0.40 m")
    assert verdict.inputs["sonar"].used
    assert verdict.to_lower.startswith("sonar to report")


def test_disconnected_it_has_no_vote() -> None:
    verdict, _ = fuse(inputs(sonar=seen("IMMINENT", "disconnected")), FusionMemory())
    assert verdict.level == "SAFE"
    assert not verdict.inputs["sonar"].used


def golden_inputs(row: dict[str, str], sonar: SensorInput) -> FusionInputs:
    def level(text: str) -> Any:
        return None if text == "-" else text

    def sensor(name: str, age_s: float, static: Any = None) -> SensorInput:
        state: Any = row[name]
        return SensorInput(state=state, level=level(row[f"{name}_level"]), age_s=age_s, static_level=static)

    return FusionInputs(
        now_s=100.0,
        moving={"yes": True, "no": False, "unknown": None}[row["moving"]],
        lidar=sensor("lidar", 0.02),
        radar=sensor("radar", 0.05, level(row["radar_static"])),
        camera=sensor("camera", 0.1 if row["camera_fresh"] == "yes" else 0.7),
        others={"sonar": sonar},
    )


def test_in_every_golden_row_it_raises_and_never_lowers() -> None:
    """Clear, it changes no level and no suppression; alarming, the verdict is at least its level; lost, no lower."""
    with GOLDEN.open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        clear, _ = fuse(golden_inputs(row, CLEAR), FusionMemory())
        assert (clear.level, clear.suppressed) == (row["level"], row["suppressed"] == "1"), row
        assert not clear.blind
        caution, _ = fuse(golden_inputs(row, seen("CAUTION")), FusionMemory())
        assert LEVELS.index(caution.level) >= max(1, LEVELS.index(row["level"])), row
        imminent, _ = fuse(golden_inputs(row, seen("IMMINENT")), FusionMemory())
        assert imminent.level == "IMMINENT", row
        lost, _ = fuse(golden_inputs(row, LOST), FusionMemory())
        assert LEVELS.index(lost.level) >= LEVELS.index(row["level"]), row
        assert lost.blind == (row["blind"] == "1"), row


def test_its_alarm_ends_the_suppression_of_the_lidar_for_good() -> None:
    first, memory = fuse(inputs(0.0, lidar=seen("CAUTION")), FusionMemory())
    assert first.suppressed
    shared, memory = fuse(inputs(0.1, lidar=seen("CAUTION"), sonar=seen("CAUTION")), memory)
    assert (shared.level, shared.suppressed) == ("CAUTION", False)
    after, _ = fuse(inputs(0.2, lidar=seen("CAUTION")), memory)
    assert (after.level, after.suppressed) == ("CAUTION", False)


def test_the_camera_confirms_its_alarm() -> None:
    verdict, _ = fuse(inputs(camera=seen("IMMINENT"), sonar=seen("CAUTION")), FusionMemory())
    assert (verdict.level, verdict.rule, verdict.confirmed, verdict.advisory) == (
        "IMMINENT", "R3-confirmed", True, None,
    )  # fmt: skip


def test_the_camera_alone_is_an_advisory_against_all_three_others() -> None:
    verdict, _ = fuse(inputs(camera=seen("CAUTION")), FusionMemory())
    assert (verdict.level, verdict.advisory) == ("SAFE", "CAMERA_ONLY")
    assert verdict.because.endswith("but LiDAR and radar and sonar are clear")


def test_its_alarm_outlives_it_and_can_be_decided_again_from_the_trace() -> None:
    _, memory = fuse(inputs(0.0, sonar=seen("IMMINENT")), FusionMemory())
    lost = inputs(0.4, sonar=LOST)
    verdict, after = fuse(lost, memory)
    assert (verdict.level, verdict.rule) == ("IMMINENT", "H1-held")
    again = decide_again(trace_of(Step(lost, memory), verdict, DEFAULT_RULES))
    assert again == (verdict, after)
    later, _ = fuse(inputs(60.0, sonar=LOST), after)
    assert later.level == "IMMINENT"


@pytest.mark.parametrize("name", ["lidar", "radar", "camera", "infra_lidar"])
def test_a_sensor_with_a_field_of_its_own_is_refused_among_the_others(name: str) -> None:
    with pytest.raises(ValueError, match=f"others: {name} "):
        FusionInputs(now_s=0.0, moving=None, lidar=CLEAR, radar=CLEAR, camera=EMPTY, others={name: CLEAR})


@pytest.mark.parametrize("name", SENSOR_TOPICS)
def test_every_sensor_of_the_table_has_a_reading(name: str, build_message: Any) -> None:
    message = build_message[name](1)
    assert type(message) is SENSOR_TOPICS[name].message
    assert read(message).state == "online"


def test_a_message_without_a_reading_is_an_error_and_not_a_clear_sensor() -> None:
    picture = CompressedImage(stamp_ns=1, format="jpeg", data=b"")
    with pytest.raises(TypeError, match="no reading for CompressedImage"):
        read(picture)
