"""What holds for every input and every history."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from common.messages import Verdict
from common.topics import spoken
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import RANK
from services.jetson.fusion.verdict import FusionInputs, FusionMemory, SensorInput, fuse

RULES = RulesConfig()
LEVELS: tuple[Any, ...] = (None, "SAFE", "CAUTION", "IMMINENT")
OUT: tuple[Any, ...] = ("degraded", "disconnected")
STATES: tuple[Any, ...] = ("online", "online", *OUT)
AGES = (0.02, 0.3, 0.7, None, math.nan, math.inf, -5.0)
RANGES = (1.5, None, 0.0, 1.39, 1.61)
STEPS_S = (0.1, 0.0, 0.05, 0.4)

# One integer is one moment: a mixed-radix number whose digits choose states, levels, ages, ranges and the rest. That
# draws and shrinks (towards 0: everything online and clear) much faster than a tree of strategies.
MOMENTS = st.integers(0, 2**63 - 1)
HISTORIES = st.lists(MOMENTS, min_size=1, max_size=25)


class Digits:
    def __init__(self, number: int) -> None:
        self.number = number

    def pick(self, options: tuple[Any, ...]) -> Any:
        self.number, digit = divmod(self.number, len(options))
        return options[digit]

    def sensor(self, static: tuple[Any, ...] = (None,)) -> SensorInput:
        return SensorInput(
            state=self.pick(STATES),
            level=self.pick(LEVELS),
            age_s=self.pick(AGES),
            static_level=self.pick(static),
            nearest_m=self.pick(RANGES),
            reason=self.pick(("", "a reason")),
        )


def moment(number: int, now_s: float = 100.0) -> tuple[FusionInputs, float]:
    """The inputs that a number stands for, and the time until the next ones."""
    digits = Digits(number)
    inputs = FusionInputs(
        now_s=now_s,
        moving=digits.pick((None, True, False)),
        lidar=digits.sensor(),
        radar=digits.sensor(static=LEVELS),
        camera=digits.sensor(),
        distrust=digits.pick(((), (), ("radar clock",))),
        starting=digits.pick(((), (), (), ("radar",))),
        roadside=digits.pick((None, SensorInput("online", "CAUTION"), SensorInput("online", "IMMINENT"))),
    )
    return inputs, digits.pick(STEPS_S)


def timeline(numbers: list[int]) -> list[FusionInputs]:
    """Inputs in the order of time."""
    now_s, history = 50.0, []
    for number in numbers:
        inputs, step_s = moment(number, now_s)
        history.append(inputs)
        now_s += step_s
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


@settings(max_examples=300)
@given(HISTORIES.map(timeline))
def test_lidar_or_radar_imminent_is_imminent_whatever_else_happens(history: list[FusionInputs]) -> None:
    for step, verdict in zip(history, run(history), strict=True):
        for sensor in (step.lidar, step.radar):
            if sensor.state != "disconnected" and sensor.level == "IMMINENT":
                assert (verdict.level, verdict.permission) == ("IMMINENT", "STOP")


@settings(max_examples=300)
@given(HISTORIES.map(timeline))
def test_never_safe_with_two_out_and_stop_when_blind_or_starting(history: list[FusionInputs]) -> None:
    for step, verdict in zip(history, run(history), strict=True):
        if out_of(step) >= 2 or step.starting or step.distrust:
            assert verdict.level != "SAFE"
        assert verdict.blind == (out_of(step) == 3)
        if verdict.blind or step.starting:
            assert verdict.permission == "STOP"
        assert (verdict.permission == "GO") <= (verdict.level == "SAFE")


@settings(max_examples=300)
@given(HISTORIES.map(timeline), MOMENTS, st.sampled_from(["lidar", "radar"]), st.sampled_from(LEVELS))
def test_raising_a_band_never_lowers_the_verdict(
    history: list[FusionInputs], number: int, name: str, higher: Any
) -> None:
    memory, last = after(history), moment(number)[0]
    sensor = getattr(last, name)
    if LEVELS.index(higher) < LEVELS.index(sensor.level):
        return
    raised = replace(last, **{name: replace(sensor, level=higher)})
    assert RANK[fuse(raised, memory)[0].level] >= RANK[fuse(last, memory)[0].level]


@settings(max_examples=300)
@given(HISTORIES.map(timeline), MOMENTS, st.sampled_from(["lidar", "radar", "camera"]), st.sampled_from(OUT))
def test_losing_a_sensor_never_lowers_below_what_the_others_report(
    history: list[FusionInputs], number: int, name: str, lost: Any
) -> None:
    last = moment(number)[0]
    last = replace(last, **{name: replace(getattr(last, name), state=lost, level=None)})
    verdict, _ = fuse(last, after(history))
    remaining = [s for s in (last.lidar, last.radar) if s.state == "online"]
    only_two_left = out_of(last) <= 1
    for sensor in remaining:
        if not (only_two_left and verdict.suppressed):
            assert RANK[verdict.level] >= RANK[sensor.level]
    assert not verdict.suppressed, "suppression needs all three"


@settings(max_examples=300)
@given(HISTORIES.map(timeline), MOMENTS, st.sampled_from(LEVELS))
def test_the_camera_alone_never_changes_the_verdict_of_a_clear_lidar(
    history: list[FusionInputs], number: int, seen: Any
) -> None:
    memory, last = after(history), moment(number)[0]
    clear = replace(last, lidar=replace(last.lidar, state="online", level="SAFE"))
    if clear.radar.state != "disconnected" and RANK[clear.radar.level] >= RANK["CAUTION"]:
        return
    if any(claim.by != "camera" for claim in memory.claims):
        return  # not yet seen gone by the sensor that raised it: the camera may confirm it
    with_camera = replace(clear, camera=replace(clear.camera, state="online", level=seen))
    empty = replace(clear, camera=replace(clear.camera, state="online", level=None))
    assert fuse(with_camera, memory)[0].level == fuse(empty, memory)[0].level


@settings(max_examples=300)
@given(HISTORIES.map(timeline))
def test_suppression_is_short_and_only_with_everything_in_order(history: list[FusionInputs]) -> None:
    since_s = None
    for step, verdict in zip(history, run(history), strict=True):
        if step.lidar.state != "disconnected" and step.lidar.level in ("CAUTION", "IMMINENT") and since_s is None:
            since_s = step.now_s  # no history is long enough for the budget to come back
        if verdict.suppressed:
            assert since_s is not None
            assert step.now_s - since_s < RULES.suppression_limit_s
            assert out_of(step) == 0
            assert step.lidar.level != "IMMINENT"
            assert step.radar.level in (None, "SAFE")
            assert step.camera.level is None
            assert step.camera.age_s is not None
            assert abs(step.camera.age_s) <= RULES.confirm_age_s


@settings(max_examples=300)
@given(HISTORIES.map(timeline), MOMENTS, st.sampled_from(LEVELS), st.sampled_from(STATES))
def test_the_roadside_only_ever_raises(history: list[FusionInputs], number: int, level: Any, state: Any) -> None:
    memory, last = after([replace(step, roadside=None) for step in history]), moment(number)[0]
    without, _ = fuse(replace(last, roadside=None), memory)
    with_it, _ = fuse(replace(last, roadside=SensorInput(state, level)), memory)
    assert RANK[with_it.level] >= RANK[without.level]


@settings(max_examples=300)
@given(HISTORIES.map(timeline))
def test_the_same_inputs_give_the_same_verdict(history: list[FusionInputs]) -> None:
    """``repr``, because a NaN in an age is not equal to itself."""
    assert repr(run(history)) == repr(run(history))


@settings(max_examples=300)
@given(HISTORIES.map(timeline))
def test_every_verdict_explains_itself(history: list[FusionInputs]) -> None:
    for step, verdict in zip(history, run(history), strict=True):
        assert verdict.because
        assert all(sensor.why for sensor in verdict.inputs.values())
        assert bool(verdict.to_lower) == (verdict.level != "SAFE")
        for name, sensor in verdict.inputs.items():  # whoever holds the level up is named
            if name in ("lidar", "radar") and sensor.used and RANK[sensor.level] == RANK[verdict.level] > RANK["SAFE"]:
                assert f"{spoken(name)} to report" in verdict.to_lower
        assert {"lidar", "radar", "camera"} <= set(verdict.inputs)
        assert ("infra_lidar" in verdict.inputs) == (step.roadside is not None)
