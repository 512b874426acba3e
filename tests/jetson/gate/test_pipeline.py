"""The gate's state machine: what stops it at once, what it takes to move again, and what can never happen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import ConfigError, load
from common.messages import Verdict, WayAhead
from services.jetson.gate import config as gate_config
from services.jetson.gate.checks import GateInputs
from services.jetson.gate.config import GateConfig, LimitsConfig, ReleaseConfig
from services.jetson.gate.pipeline import STOPPED, Decision, GatePipeline

LEVEL = {"GO": "SAFE", "SLOW": "CAUTION", "STOP": "IMMINENT"}
PERIOD_S = 0.02


def verdict(permission: Any = "GO") -> Verdict:
    level: Any = LEVEL[permission]
    return Verdict(
        stamp_ns=1, level=level, rule="R0-clear", because=f"because {permission}", inputs={}, confirmed=False,
        suppressed=False, advisory=None, blind=False, permission=permission, source_kind="live",
    )  # fmt: skip


def inputs(permission: Any = "GO", **changes: Any) -> GateInputs:
    return GateInputs(verdict=verdict(permission), age_s=0.01, claimants=("a1",))._replace(**changes)


class Drive:
    """Rounds of the gate's loop, one after the other."""

    def __init__(self, acknowledge: Any = "never") -> None:
        self.config = GateConfig(release=ReleaseConfig(acknowledge=acknowledge))
        self.gate, self.now_s = GatePipeline(self.config), 100.0

    def round(self, one: GateInputs) -> Decision:
        self.now_s += PERIOD_S
        return self.gate.process(self.now_s, one)

    def rounds(self, one: GateInputs, seconds: float) -> list[Decision]:
        return [self.round(one) for _ in range(round(seconds / PERIOD_S))]

    def going(self) -> Drive:
        assert self.rounds(inputs(acknowledged=True), 2.0)[-1].permission == "GO"
        return self


FAULTS = {
    "actuator_lost": {"actuator_lost": "the cable is out"},
    "isolated": {"isolated": True},
    "fusion_gone": {"claimants": ()},
    "two_claimants": {"claimants": ("a1", "b2")},
    "two_senders": {"two_senders": True},
    "unreadable": {"refused": "Verdict.level: missing"},
    "starting": {"verdict": None},
    "stale": {"age_s": 0.2501},
    "clock": {"age_s": -0.0501},
    "not_live": {"verdict": msgspec.structs.replace(verdict(), source_kind="simulated")},
}


def test_the_file_loads_and_equals_the_defaults() -> None:
    assert load(GateConfig, Path(gate_config.__file__).parent / "gate.toml") == GateConfig()


@pytest.mark.parametrize(
    ("setting", "error_text"),
    [
        ("speed.slow_mps=9", r"\[speed\] slow_mps = 9.0: expected at most go_mps"),
        ("period_s=0.05", "pass"),
        ("limits.verdict_age_s=0.3", "verdict_age_s = 0.3"),
        ("limits.overrun_s=0.03", "two periods"),
    ],
)
def test_contradictory_settings_are_refused(setting: str, error_text: str) -> None:
    if error_text == "pass":
        load(GateConfig, None, [setting])
        return
    with pytest.raises(ConfigError, match=error_text):
        load(GateConfig, None, [setting])


@pytest.mark.parametrize("cause", FAULTS)
def test_every_fault_stops_at_once_and_is_named(cause: str) -> None:
    decision = Drive().going().round(inputs(**FAULTS[cause]))
    assert (decision.permission, decision.cause, decision.limit_mps, decision.valid_s) == ("STOP", cause, 0.0, 0.0)
    assert decision.because


def test_a_loop_that_stood_still_stops() -> None:
    drive = Drive().going()
    drive.now_s += 0.1
    assert drive.round(inputs()).cause == "overrun"


def test_fusions_own_word_counts_at_once() -> None:
    drive = Drive().going()
    assert (drive.round(inputs("SLOW")).permission, drive.round(inputs("SLOW")).limit_mps) == ("SLOW", 0.5)
    stopped = drive.round(inputs("STOP"))
    assert (stopped.permission, stopped.cause, stopped.because) == ("STOP", "verdict", "because STOP")


def test_after_a_stop_it_takes_good_verdicts_without_a_break() -> None:
    drive = Drive().going()
    drive.round(inputs("STOP"))
    assert {d.permission for d in drive.rounds(inputs(), 0.9)} == {"STOP"}
    drive.round(inputs(age_s=0.3))
    after = drive.rounds(inputs(), 2.0)
    waiting = [d for d in after if d.permission == "STOP"]
    assert len(waiting) * PERIOD_S == pytest.approx(1.0, abs=1.5 * PERIOD_S)
    assert {d.cause for d in waiting} == {"waiting"}
    assert waiting[0].left_s == pytest.approx(1.0)
    assert {d.permission for d in after[len(waiting) :]} == {"GO"}


def test_a_speed_limit_is_lifted_after_a_while_of_go() -> None:
    drive = Drive().going()
    drive.round(inputs("SLOW"))
    given = [d.permission for d in drive.rounds(inputs(), 0.8)]
    assert given.index("GO") * PERIOD_S == pytest.approx(0.5, abs=1.5 * PERIOD_S)
    drive.round(inputs("STOP"))
    drive.rounds(inputs("SLOW"), 1.2)
    assert drive.round(inputs()).permission == "SLOW"


@pytest.mark.parametrize(
    ("motion", "safe_mps", "limits_mps"),
    [
        ("driving", 0.3, (0.3, 0.3)),
        ("driving", 2.0, (2.0, 0.5)),
        ("driving", 9.0, (5.0, 0.5)),
        ("driving", None, (5.0, 0.5)),
        ("standing", 0.0, (5.0, 0.5)),  # some sensors see standing things only while it drives
        ("unknown", 0.0, (5.0, 0.5)),
    ],
)
def test_while_driving_the_limit_is_what_fusion_calls_safe(
    motion: Any, safe_mps: float | None, limits_mps: tuple[float, float]
) -> None:
    way = WayAhead(motion=motion, curvature_per_m=0.0, left_m=0.1, right_m=0.1, stopping_m=1.0)
    drive = Drive().going()
    for permission, limit_mps in zip(("GO", "SLOW"), limits_mps, strict=True):
        changed = msgspec.structs.replace(verdict(permission), way=way, max_safe_speed_mps=safe_mps)
        assert drive.round(inputs(verdict=changed)).limit_mps == limit_mps


@pytest.mark.parametrize(
    ("acknowledge", "stop", "needed"),
    [
        ("never", inputs("STOP"), False),
        ("never", inputs(age_s=1.0), False),
        ("after_fault", inputs("STOP"), False),
        ("after_fault", inputs(age_s=1.0), True),
        ("after_stop", inputs("STOP"), True),
        ("after_stop", inputs(age_s=1.0), True),
    ],
)
def test_who_has_to_acknowledge_what(acknowledge: str, stop: GateInputs, needed: bool) -> None:
    drive = Drive(acknowledge).going()
    assert drive.round(stop).acknowledge == needed
    after = drive.rounds(inputs(), 3.0)[-1]
    assert (after.permission, after.cause) == (("STOP", "acknowledge") if needed else ("GO", "verdict"))
    assert drive.round(inputs(acknowledged=True)).permission == "GO"


def test_an_acknowledgement_during_the_fault_does_not_count() -> None:
    drive = Drive("after_stop").going()
    drive.round(inputs("STOP", acknowledged=True))
    assert drive.rounds(inputs(), 3.0)[-1].cause == "acknowledge"


def test_a_permission_ends_when_its_verdict_gets_too_old() -> None:
    drive = Drive().going()
    assert drive.round(inputs(age_s=0.0)).valid_s == pytest.approx(0.2)
    assert drive.round(inputs(age_s=0.2)).valid_s == pytest.approx(0.05)


@pytest.mark.parametrize("age_s", [0.25, -0.05])
def test_a_verdict_at_the_very_limit_of_its_age_is_in_time(age_s: float) -> None:
    assert Drive().going().round(inputs(age_s=age_s)).permission == "GO"


@pytest.mark.parametrize(("kind", "words"), [("unknown", "data of unknown origin"), ("simulated", "simulated data")])
def test_what_a_refused_verdict_rests_on_is_named(kind: Any, words: str) -> None:
    changed = msgspec.structs.replace(verdict(), source_kind=kind)
    assert Drive().going().round(inputs(verdict=changed)).because == f"the verdict rests on {words}; accepted: live"


def test_every_stop_permits_nothing() -> None:
    drive = Drive("after_stop").going()
    stopped = drive.round(inputs("STOP"))
    waiting, asking = drive.round(inputs()), drive.rounds(inputs(), 2.0)[-1]
    for decision, cause in (
        (STOPPED, "starting"), (stopped, "verdict"), (waiting, "waiting"), (asking, "acknowledge"),
    ):  # fmt: skip
        assert (decision.permission, decision.cause) == ("STOP", cause)
        assert (decision.limit_mps, decision.valid_s) == (0.0, 0.0)
    assert (STOPPED.left_s, STOPPED.acknowledge) == (0.0, False)
    assert (asking.left_s, asking.acknowledge) == (0.0, True)
    moving = Drive().going().round(inputs())
    assert (moving.left_s, moving.acknowledge) == (0.0, False)


def test_times_that_are_over_to_the_moment() -> None:
    """In sixteenths of a second, which are exact: a second after a stop, half a second of GO, 0.0625 s for a round."""
    gate = GatePipeline(GateConfig(limits=LimitsConfig(overrun_s=0.0625)))

    def at(sixteenth: int, permission: str = "GO") -> Decision:
        return gate.process(8.0 + sixteenth / 16, inputs(permission))

    waiting = [at(k) for k in range(16)]
    assert {(one.permission, one.cause) for one in waiting} == {("STOP", "waiting")}
    assert waiting[-1].left_s == 1 / 16
    assert at(16).permission == "GO"
    assert at(17, "SLOW").permission == "SLOW"
    assert [at(k).permission for k in range(18, 27)] == ["SLOW"] * 8 + ["GO"]


def test_the_permission_is_no_longer_for_a_verdict_from_the_future() -> None:
    assert Drive().going().round(inputs(age_s=-0.04)).valid_s == 0.2
    assert Drive().going().round(inputs(age_s=0.15)).valid_s == pytest.approx(0.1)


anything = st.builds(
    GateInputs,
    verdict=st.sampled_from([None, verdict("GO"), verdict("GO"), verdict("GO"), verdict("SLOW"), verdict("STOP")]),
    age_s=st.sampled_from([0.0, 0.01, 0.02, 0.2, 0.24, 0.26, 5.0, -0.04, -0.06]),
    claimants=st.sampled_from([("a",), ("a",), ("a",), ("a",), (), ("a", "b")]),
    isolated=st.sampled_from([False] * 9 + [True]),
    refused=st.sampled_from([""] * 9 + ["bad"]),
    acknowledged=st.booleans(),
)
history = st.lists(st.tuples(anything, st.integers(1, 60), st.floats(0.005, 0.12)), max_size=40)


@given(history, st.sampled_from(["never", "after_fault", "after_stop"]))
def test_what_holds_for_every_history(steps: list[tuple[GateInputs, int, float]], acknowledge: str) -> None:
    """Never more than fusion allows, never on a bad verdict, never soon after a stop, never longer than it is fresh."""
    drive = Drive(acknowledge)
    bad_s, order = drive.now_s, ("STOP", "SLOW", "GO")
    for one, count, period_s in steps:
        for _ in range(count):
            drive.now_s += period_s
            decision = drive.gate.process(drive.now_s, one)
            good = one.verdict is not None and -0.05 <= one.age_s <= 0.25 and one.claimants == ("a",)
            good = good and not one.isolated and not one.refused and period_s <= 0.1
            if not good or one.verdict is None or one.verdict.permission == "STOP":
                bad_s = drive.now_s
                assert decision.permission == "STOP"
            else:
                assert order.index(decision.permission) <= order.index(one.verdict.permission)
            if decision.permission != "STOP":
                assert drive.now_s - bad_s >= 1.0 - 1e-9
                assert 0.0 <= decision.valid_s <= min(0.2, 0.25 - max(0.0, one.age_s)) + 1e-9
                assert not decision.acknowledge
            assert (decision.limit_mps == 0.0) == (decision.permission == "STOP")
