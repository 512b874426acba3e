"""`spotter gate`: its words, and the wiring on trial against an emulated actuator."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import zenoh
from typer.testing import CliRunner

from common.bus.session import build
from common.codec import encode
from common.config import ZenohConfig
from common.messages import GateState
from services.jetson.gate.emulator import EmulatedActuator
from services.jetson.gate.trial import Finding
from spotter_tools.cli.gate import app, lines_of, outcome

STATE = GateState(
    stamp_ns=1, permission="STOP", limit_mps=0.0, cause="waiting", because="good verdicts again", left_s=0.4,
    acknowledge=True, verdict_seq=7, verdict_age_s=0.012, outputs={"sim:": "STOP"}, state="degraded", reason="alone",
    source_kind="live",
)  # fmt: skip


def test_the_state_in_words() -> None:
    assert lines_of("jetson0", STATE) == [
        "jetson0: STOP (waiting): good verdicts again",
        "  needs 0.4 s of good verdicts",
        "  a person has to acknowledge: spotter gate acknowledge, or the button",
        "  verdict 7, 12 ms old, live data",
        "  sim:: STOP",
        "  degraded: alone",
    ]


@pytest.mark.parametrize(
    ("finding", "text", "miss"),
    [
        (Finding("GO", "x", "GO (as told)", 0.02, ""), "the actuator says GO (as told), after 0.02 s", False),
        (Finding("GO", "x", "STOP (as told)", None, ""), "MISS: the actuator says STOP (as told)", True),
        (Finding("GO", "x", "", None, "no port"), "MISS: no port", True),
        (Finding("GO", "x", "", None, ""), "this output has no way to answer: believe your eyes", False),
    ],
)
def test_outcomes(finding: Finding, text: str, miss: bool) -> None:
    assert outcome(finding) == (text, miss)


def test_the_trial_goes_through_all_steps(tmp_path: Path) -> None:
    with EmulatedActuator() as actuator:
        arguments = ["try", "--output", f"serial:{actuator.device}", "--yes", "--json", "--seconds", "1"]
        done = CliRunner().invoke(app, arguments)
        assert actuator.permission == "STOP"
    findings = [json.loads(line) for line in done.stdout.splitlines()]
    assert [one["name"] for one in findings] == ["STOP", "SLOW", "STOP", "GO", "silence", "STOP"]
    silence = findings[4]
    assert silence["words"] == "STOP (frames stopped coming)"
    assert silence["after_s"] > 0.1
    assert done.exit_code == 0, done.stdout


def test_an_actuator_that_is_not_there_is_a_miss(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["try", "--output", f"serial:{tmp_path / 'no'}", "--yes", "--seconds", "1"])
    assert done.exit_code == 1
    assert "MISS" in done.stdout
    assert "does not exist yet" in done.stdout


def test_nothing_turns_without_a_yes(tmp_path: Path) -> None:
    with EmulatedActuator() as actuator:
        done = CliRunner().invoke(app, ["try", "--output", f"serial:{actuator.device}"], input="n\n")
        assert (done.exit_code, actuator.accepted_s) == (1, [])
    assert CliRunner().invoke(app, ["try"]).exit_code == 2
    assert CliRunner().invoke(app, ["try", "--output", "bell:"]).exit_code == 2


def test_status_over_the_bus(zenoh_config: ZenohConfig) -> None:
    (endpoint,) = zenoh_config.connect
    with zenoh.open(build(zenoh_config)) as session:
        assert CliRunner().invoke(app, ["status", "--connect", endpoint]).exit_code == 1
        assert CliRunner().invoke(app, ["acknowledge", "--connect", endpoint]).exit_code == 1
        querying: list[CliRunner] = []
        answer = session.declare_queryable(
            "jetson0/gate/acknowledge",
            lambda query: query.reply(
                "jetson0/gate/acknowledge",
                json.dumps({"counts": bool(querying), "permission": "STOP", "cause": "stale", "because": "old"}),
            ),
        )
        said = CliRunner().invoke(app, ["acknowledge", "--connect", endpoint]).stdout
        assert said == "jetson0: does not count now: STOP (stale): old\n"
        answer.undeclare()
        with zenoh.open(build(zenoh_config)) as other:
            publisher = other.declare_publisher("jetson0/gate/state")
            stop = _repeat(publisher, encode(STATE))
            done = CliRunner().invoke(app, ["status", "--connect", endpoint, "--json"])
            stop()
    assert json.loads(done.stdout)["cause"] == "waiting"


def _repeat(publisher: zenoh.Publisher, payload: bytes):  # type: ignore[no-untyped-def]
    import threading

    end = threading.Event()

    def put() -> None:
        while not end.wait(0.05):
            publisher.put(payload)

    thread = threading.Thread(target=put, daemon=True)
    thread.start()

    def stop() -> None:
        end.set()
        thread.join()

    return stop
