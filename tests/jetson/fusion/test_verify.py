"""A recording that is true is found identical; one field changed anywhere is found, and named."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.codec import decode, encode
from common.messages import FusionTrace, LidarZone, LidarZones, Message, Verdict
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import FusionInputs, FusionMemory, SensorInput
from services.jetson.fusion.pipeline import Step
from services.jetson.fusion.readings import read
from services.jetson.fusion.trace import decide_again, inputs_of, memory_of, trace_of
from services.jetson.fusion.verdict import fuse
from services.jetson.fusion.verify import verify

Recording = list[tuple[str, bytes]]
LEVELS = ("SAFE", "CAUTION", "IMMINENT")


def zones(stamp_ns: int, level: str) -> LidarZones:
    far = LidarZone(nearest_m=None, points=0, level="SAFE")
    near = LidarZone(nearest_m=None if level == "SAFE" else 1.0, points=9, level=level)  # type: ignore[arg-type]
    return LidarZones(stamp_ns=stamp_ns, left=far, centre=near, right=far, level=level, raw_level=level)  # type: ignore[arg-type]


def recording(levels: str) -> Recording:
    """A lidar that says S, C or I, one verdict a tenth of a second, each with its trace."""
    memory, rules, recorded = FusionMemory(), RulesConfig(), []
    for seq, letter in enumerate(levels):
        message = zones(1000 + seq, {"S": "SAFE", "C": "CAUTION", "I": "IMMINENT"}[letter])
        reading = read(message)
        lidar = SensorInput(
            state="online", level=reading.level, age_s=0.02, nearest_m=reading.nearest_m, stamp_ns=message.stamp_ns,
            static_level=reading.static_level, deciding=reading.deciding, sightings=reading.sightings,
            raw_level=reading.raw_level,
        )  # fmt: skip
        radar = SensorInput(state="online", level="SAFE", age_s=0.05)
        camera = SensorInput(state="online", level=None, age_s=0.1)
        step = Step(FusionInputs(now_s=seq / 10, moving=None, lidar=lidar, radar=radar, camera=camera), memory)
        verdict, memory = fuse(step.inputs, step.memory, rules)
        verdict.seq = seq
        trace = trace_of(step, verdict, rules)
        recorded += [
            ("jetson0/lidar/zones", encode(message)),
            ("jetson0/fusion/verdict", encode(verdict)),
            ("jetson0/fusion/trace", encode(trace)),
        ]
    return recorded


def tamper(
    recorded: Recording, key: str, index: int, change: Callable[[Message], None], kind: type[Message]
) -> Recording:
    places = [i for i, (name, _) in enumerate(recorded) if name.endswith(key)]
    message = decode(recorded[places[index]][1], kind)
    change(message)
    changed = list(recorded)
    changed[places[index]] = (recorded[places[index]][0], encode(message))
    return changed


@given(st.text(alphabet="SCI", min_size=1, max_size=40))
def test_a_true_recording_is_identical(levels: str) -> None:
    report = verify(recording(levels))
    assert report.difference == ""
    assert report.decided_again == report.verdicts == len(levels)
    assert report.inputs_checked == len(levels)


def test_a_trace_survives_the_wire() -> None:
    payload = recording("SC")[5][1]
    trace = decode(payload, FusionTrace)
    assert isinstance(inputs_of(trace), FusionInputs)
    assert isinstance(memory_of(trace), FusionMemory)
    verdict, _ = decide_again(trace)
    assert verdict.suppressed


def test_a_changed_verdict_is_found() -> None:
    def change(message: Message) -> None:
        assert isinstance(message, Verdict)
        message.level = "SAFE"

    report = verify(tamper(recording("SSIII"), "verdict", 3, change, Verdict))
    assert report.difference == "verdict 3: level was 'SAFE', the rules now give 'IMMINENT'"


def test_a_changed_sensor_message_is_found() -> None:
    def change(message: Message) -> None:
        assert isinstance(message, LidarZones)
        message.level = message.centre.level = "SAFE"

    report = verify(tamper(recording("SSIII"), "zones", 2, change, LidarZones))
    assert "verdict 2: lidar said" in report.difference


def test_a_changed_memory_is_found() -> None:
    def change(message: Message) -> None:
        assert isinstance(message, FusionTrace)
        message.memory["suppression"] = [None, None, True, None]

    report = verify(tamper(recording("SCCC"), "trace", 2, change, FusionTrace))
    assert "verdict 2: began with" in report.difference


def test_changed_rules_are_found() -> None:
    def change(message: Message) -> None:
        assert isinstance(message, FusionTrace)
        message.rules["suppression"] = "off"

    report = verify(tamper(recording("SC"), "trace", 1, change, FusionTrace))
    assert "verdict 1" in report.difference


@pytest.mark.parametrize("field", ["inputs", "memory", "rules"])
def test_a_trace_that_is_none_is_told(field: str) -> None:
    def change(message: Message) -> None:
        setattr(message, field, {"now_s": "yesterday", "suppression": 3, "lidar_since_s": "x"})

    report = verify(tamper(recording("S"), "trace", 0, change, FusionTrace))
    assert "its trace cannot be read" in report.difference


def test_a_recording_may_begin_in_the_middle() -> None:
    report = verify(recording("SSCCIISS")[7:])
    assert report.difference == ""
    assert report.decided_again == 6


def test_rules_travel_with_the_trace() -> None:
    trace = decode(recording("S")[2][1], FusionTrace)
    assert msgspec.convert(trace.rules, RulesConfig) == RulesConfig()
