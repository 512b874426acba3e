"""Random worlds: never SAFE close to what was reported, no alarm without end; a restart of fusion changes nothing."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.jetson.fusion.claims import update_claims
from services.jetson.fusion.config import FusionConfig, RulesConfig
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.fusion.store import Saved
from spotter_tools.random_worlds import run
from spotter_tools.random_worlds.run import TICK_S, World

SEEDS = (*range(7), 47, 186, 405, 566)  # the last ones were the worst of a thousand before they were mended


@pytest.mark.parametrize("seed", SEEDS)
def test_what_holds_in_every_world(seed: int) -> None:
    outcome = run(seed, 60.0)
    assert outcome.wrong == 0, outcome.first
    assert outcome.steps >= 1200


def test_the_judge_notices_alarms_that_end_with_their_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    def forgetful(inputs, memory, rules):  # type: ignore[no-untyped-def]
        claims = update_claims(inputs, memory, rules)
        return tuple(claim for claim in claims if not claim.lost or claim.seen_s == inputs.now_s)

    monkeypatch.setattr("services.jetson.fusion.verdict.update_claims", forgetful)
    assert sum(run(seed, 30.0).unsafe for seed in range(30)) > 0


def test_the_judge_notices_alarms_that_last_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    def stubborn(inputs, memory, rules):  # type: ignore[no-untyped-def]
        return update_claims(inputs, memory, msgspec.structs.replace(rules, clear_messages=20))

    monkeypatch.setattr("services.jetson.fusion.verdict.update_claims", stubborn)
    assert sum(run(seed, 30.0).outlived for seed in range(10)) > 0


def test_the_judge_notices_flicker() -> None:
    hasty = FusionConfig(rules=RulesConfig(clear_messages=1))
    assert max(run(seed, 60.0, hasty).worst_changes for seed in range(121, 124)) > 2


@settings(max_examples=25, derandomize=True)
@given(st.integers(0, 10**6), st.floats(1.0, 40.0))
def test_fusion_restarted_in_any_state_agrees_with_one_that_never_stopped(seed: int, after_s: float) -> None:
    """The same observations to both; from two seconds on they say the same."""
    world = World(seed, 60.0, FusionConfig())
    while world.now_s < after_s:
        world.step()
    saved = msgspec.json.decode(msgspec.json.encode(world.pipeline.state(world.seen)), type=Saved)
    restarted = FusionPipeline(world.config, saved)
    world.restart_fusion = lambda: None  # type: ignore[method-assign]
    for step in range(round(6.0 / TICK_S)):
        verdict = world.step()
        again, _ = restarted.process(world.seen)
        if step * TICK_S >= 2.0:
            assert (again.level, again.permission) == (verdict.level, verdict.permission), (again, verdict)
