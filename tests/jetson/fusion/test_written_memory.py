"""Fusion's memory beside the plain one over random histories; and the page that shows it."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.verdict import RULES, FusionInputs, FusionMemory, SensorInput, fuse
from tests.jetson.fusion import written_memory as plain

LEVELS: tuple[Any, ...] = ("SAFE", "CAUTION", "IMMINENT")
RULES_OFF = RulesConfig(suppression="off")
ONLINE = SensorInput(state="online", level="SAFE", age_s=0.02)
EMPTY = SensorInput(state="online", level=None, age_s=0.1)


# (state, level agreed on, in this message alone, how often it comes, seconds between, standing, a person at the end)
EPISODES = st.lists(
    st.tuples(
        st.sampled_from(("online", "online", "degraded", "disconnected")),
        st.integers(0, 2),
        st.integers(0, 2),
        st.integers(1, 9),
        st.sampled_from((0.1, 0.1, 2.0)),
        st.booleans(),
        st.sampled_from((False, False, False, True)),
    ),
    min_size=1,
    max_size=12,
)


@settings(max_examples=200)
@given(EPISODES)
def test_an_alarm_of_the_lidar_lives_as_written(episodes: list[tuple[Any, ...]]) -> None:
    claim, memory, now_s = plain.LidarClaim(), FusionMemory(), 100.0
    for state, level, alone, count, step_s, standing, person in episodes:
        for number in range(count):
            now_s += step_s
            acknowledged = person and number == count - 1
            lidar = SensorInput(state=state, level=LEVELS[level], age_s=0.02, raw_level=LEVELS[alone])
            inputs = FusionInputs(
                now_s=now_s, moving=not standing, lidar=lidar, radar=ONLINE, camera=EMPTY, acknowledged=acknowledged
            )
            verdict, memory = fuse(inputs, memory, RULES_OFF)
            vote = claim.step(now_s, state, (level, alone), standing, acknowledged)
            assert verdict.level == LEVELS[vote or 0], (state, level, alone, number, claim.since_seen)


def test_every_rule_that_remembers_has_its_diagram() -> None:
    text = "\n".join(plain.sections())
    for rule in ("H1-held", "R3-confirmed", "R4-suppressed", "R5-camera-stands-in", "I1-roadside", "A25-starting"):
        assert f"`{rule}`" in text
        assert rule in RULES


def test_every_state_can_be_reached_and_left() -> None:
    for machine in plain.MACHINES:
        ends = {end.partition(": ")[0] for _, _, end in machine.steps}
        begins = {begin for begin, _, _ in machine.steps}
        assert begins == ends | {"[*]"}, machine.title


def test_the_numbers_in_the_diagrams_are_the_defaults() -> None:
    rules = RulesConfig()
    assert (rules.clear_messages, rules.decay_s) == (plain.CLEAR_MESSAGES, plain.DECAY_S)
    assert (rules.suppression_limit_s, rules.suppression_refill_s) == (plain.BUDGET_S, plain.REFILL_S)
