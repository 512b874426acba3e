"""What holds for every input and every history."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from common.messages import Verdict
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import RANK
from services.jetson.fusion.verdict import FusionInputs, FusionMemory, SensorInput, fuse

RULES = RulesConfig()
STATES = st.sampled_from(["online", "online", "degraded", "disconnected"])
LEVELS: st.SearchStrategy[Any] = st.sampled_from([None, "SAFE", "CAUTION", "IMMINENT"])
AGES = st.none() | st.floats(allow_nan=True, allow_infinity=True)
RANGES = st.none() | st.floats(0.0, 12.0)
ORDER = (None, "SAFE", "CAUTION", "IMMINENT")
OUT = ("degraded", "disconnected")


def sensors(static: bool = False) -> st.SearchStrategy[SensorInput]:
    return st.builds(
        SensorInput,
        state=STATES,
        level=LEVELS,
        age_s=st.sampled_from([0.02, 0.3, 0.7]) | AGES,
        static_level=LEVELS if static else st.none(),
        nearest_m=RANGES,
        reason=st.sampled_from(["", "a reason"]),
    )


def inputs(now_s: st.SearchStrategy[float] | None = None) -> st.SearchStrategy[FusionInputs]:
    return st.builds(
        FusionInputs,
        now_s=now_s if now_s is not None else st.just(100.0),
        moving=st.sampled_from([True, False, None]),
        lidar=sensors(),
        radar=sensors(static=True),
        camera=sensors(),
        roadside=st.none() | sensors(),
        distrust=st.sampled_from([(), ("radar clock",)]),
        starting=st.sampled_from([(), (), ("radar",)]),
    )


@st.composite
def histories(draw: st.DrawFn) -> list[FusionInputs]:
    """Inputs in the order of time, 0 to 0.4 s apart."""
    now_s, history = 50.0, []
    for step in draw(st.lists(st.tuples(st.floats(0.0, 0.4), inputs()), min_size=1, max_size=15)):
        now_s += step[0]
        history.append(replace(step[1], now_s=now_s))
    return history


def after(history: list[FusionInputs]) -> FusionMemory:
    memory = FusionMemory()
    for step in history:
        _, memory = fuse(step, memory)
    return memory


def run(history: list[FusionInputs]) -> list[Verdict]:
    memory, verdicts = FusionMemory(), []
    for step in history:
        verdict, memory = fuse(step, memory)
        verdicts.append(verdict)
    return verdicts


def out_of(step: FusionInputs) -> int:
    return sum(sensor.state != "online" for sensor in step.sensors.values())


@given(histories())
def test_lidar_or_radar_imminent_is_imminent_whatever_else_happens(history: list[FusionInputs]) -> None:
    for step, verdict in zip(history, run(history), strict=True):
        for sensor in (step.lidar, step.radar):
            if sensor.state != "disconnected" and sensor.level == "IMMINENT":
                assert (verdict.level, verdict.permission) == ("IMMINENT", "STOP")


@given(histories())
def test_never_safe_with_two_out_and_stop_when_blind_or_starting(history: list[FusionInputs]) -> None:
    for step, verdict in zip(history, run(history), strict=True):
        if out_of(step) >= 2 or step.starting or step.distrust:
            assert verdict.level != "SAFE"
        assert verdict.blind == (out_of(step) == 3)
        if verdict.blind or step.starting:
            assert verdict.permission == "STOP"
        assert (verdict.permission == "GO") <= (verdict.level == "SAFE")


@given(histories(), inputs(), st.sampled_from(["lidar", "radar"]), LEVELS)
def test_raising_a_band_never_lowers_the_verdict(
    history: list[FusionInputs], last: FusionInputs, name: str, higher: Any
) -> None:
    memory = after(history)
    sensor = getattr(last, name)
    if ORDER.index(higher) < ORDER.index(sensor.level):
        return
    raised = replace(last, **{name: replace(sensor, level=higher)})
    assert RANK[fuse(raised, memory)[0].level] >= RANK[fuse(last, memory)[0].level]


@given(histories(), inputs(), st.sampled_from(["lidar", "radar", "camera"]), st.sampled_from(OUT))
def test_losing_a_sensor_never_lowers_below_what_the_others_report(
    history: list[FusionInputs], last: FusionInputs, name: str, lost: Any
) -> None:
    last = replace(last, **{name: replace(getattr(last, name), state=lost, level=None)})
    verdict, _ = fuse(last, after(history))
    remaining = [s for s in (last.lidar, last.radar) if s.state == "online"]
    only_two_left = out_of(last) <= 1
    for sensor in remaining:
        if not (only_two_left and verdict.suppressed):
            assert RANK[verdict.level] >= RANK[sensor.level]
    assert not verdict.suppressed, "suppression needs all three"


@given(histories(), inputs(), LEVELS)
def test_the_camera_alone_never_changes_the_verdict_of_a_clear_lidar(
    history: list[FusionInputs], last: FusionInputs, seen: Any
) -> None:
    memory = after(history)
    clear = replace(last, lidar=replace(last.lidar, state="online", level="SAFE"))
    if clear.radar.state != "disconnected" and RANK[clear.radar.level] >= RANK["CAUTION"]:
        return
    with_camera = replace(clear, camera=replace(clear.camera, state="online", level=seen))
    empty = replace(clear, camera=replace(clear.camera, state="online", level=None))
    assert fuse(with_camera, memory)[0].level == fuse(empty, memory)[0].level


@given(histories())
def test_suppression_is_short_and_only_with_everything_in_order(history: list[FusionInputs]) -> None:
    since_s = None
    for step, verdict in zip(history, run(history), strict=True):
        if step.lidar.state == "online" and step.lidar.level in (None, "SAFE"):
            since_s = None
        elif step.lidar.state != "disconnected" and step.lidar.level in ("CAUTION", "IMMINENT") and since_s is None:
            since_s = step.now_s
        if verdict.suppressed:
            assert since_s is not None
            assert step.now_s - since_s < RULES.suppression_limit_s
            assert out_of(step) == 0
            assert step.lidar.level == "CAUTION"
            assert step.radar.level in (None, "SAFE")
            assert step.camera.level is None
            assert step.camera.age_s is not None
            assert abs(step.camera.age_s) <= RULES.confirm_age_s


@given(histories(), inputs(), LEVELS, sensors())
def test_the_roadside_only_ever_raises(
    history: list[FusionInputs], last: FusionInputs, level: Any, roadside: SensorInput
) -> None:
    memory = after(history)
    without, _ = fuse(replace(last, roadside=None), memory)
    with_it, _ = fuse(replace(last, roadside=replace(roadside, level=level)), memory)
    assert RANK[with_it.level] >= RANK[without.level]


@given(histories())
def test_the_same_inputs_give_the_same_verdict(history: list[FusionInputs]) -> None:
    """``repr``, because a NaN in an age is not equal to itself."""
    assert repr(run(history)) == repr(run(history))


@given(histories())
def test_every_verdict_explains_itself(history: list[FusionInputs]) -> None:
    for step, verdict in zip(history, run(history), strict=True):
        assert verdict.because
        assert all(told.why for told in verdict.inputs.values())
        assert bool(verdict.to_lower) == (verdict.level != "SAFE")
        assert {"lidar", "radar", "camera"} <= set(verdict.inputs)
        assert ("infra_lidar" in verdict.inputs) == (step.roadside is not None)
