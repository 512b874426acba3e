"""A radar by somebody else is a first-class citizen: fusion takes its word, and `spotter swap` replaces it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from common import topics
from common.codec import decode
from common.config import ZenohConfig
from common.messages import SystemHealth
from common.session import open_session

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(120)]
STANDIN = str(Path(__file__).with_name("standin_radar.py"))
BIN = Path(sys.executable).parent


@pytest.fixture
def standin(router_endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    """The stand-in as the live radar, and whatever takes its place is stopped as well."""
    environment = {**os.environ, "SPOTTER_CONNECT": router_endpoint}
    process = subprocess.Popen([sys.executable, STANDIN], env=environment)
    yield process
    process.terminate()
    process.wait(10)


def swap(endpoint: str, log: Path, candidate: str, *more: str) -> tuple[int, dict[str, Any]]:
    words = [str(BIN / "spotter"), "swap", "radar", "--candidate", candidate, "--json", "--log", str(log)]
    words += ["--seconds", "2", "--probation", "2", "--connect", endpoint, *more]
    finished = subprocess.run(words, capture_output=True, text=True, timeout=100, check=False)
    assert finished.stdout, finished.stderr
    return finished.returncode, json.loads(finished.stdout)


def instances(session: zenoh.Session) -> set[str]:
    replies = session.liveliness().get("pi0/radar/alive/*", timeout=2.0)
    return {topics.parse_token(str(reply.ok.key_expr))[2] for reply in replies if reply.ok is not None}


def eventually(reached: Callable[[], object], budget_s: float = 30.0) -> None:
    deadline_s = time.monotonic() + budget_s
    while not reached():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def test_fusion_takes_the_word_of_a_foreign_radar(standin: Any, router_endpoint: str) -> None:
    where = [f'zenoh.connect=["{router_endpoint}"]']
    fusion = subprocess.Popen([str(BIN / "spotter-fusion"), *(w for s in where for w in ("--set", s))])
    session = open_session(ZenohConfig(connect=(router_endpoint,)), give_up_after_s=10.0)
    states: list[str] = []

    def note(sample: zenoh.Sample) -> None:
        states.append(decode(sample.payload.to_bytes(), SystemHealth).sensors["radar"].state)

    try:
        session.declare_subscriber(topics.FUSION_HEALTH.any_host, note)
        eventually(lambda: states and states[-1] == "online")
    finally:
        session.close()
        fusion.terminate()
        fusion.wait(10)


def test_a_worse_candidate_is_refused_and_an_equal_one_takes_over(
    standin: subprocess.Popen[bytes], router_endpoint: str, tmp_path: Path
) -> None:
    session = open_session(ZenohConfig(connect=(router_endpoint,)), give_up_after_s=10.0)
    eventually(lambda: len(instances(session)) == 1)
    before = instances(session)
    for worse, why in (("slow", "Hz, the live one"), ("late", "latency")):
        code, outcome = swap(router_endpoint, tmp_path / "log", f"{sys.executable} {STANDIN} {worse}")
        assert code == 1
        assert any(why in reason for reason in outcome["reasons"]), outcome
        assert instances(session) == before
    code, outcome = swap(router_endpoint, tmp_path / "log", f"{sys.executable} -c 'raise SystemExit(3)'")
    assert code == 1
    assert "ended with code 3" in outcome["reasons"][0]
    code, outcome = swap(router_endpoint, tmp_path / "log", f"{sys.executable} {STANDIN}")
    try:
        assert code == 0, outcome
        assert outcome["handover"]["longest_gap_ms"] < 500.0  # the topic's age limit
        assert outcome["handover"]["messages"] > 10
        assert standin.wait(10) == 0
        eventually(lambda: instances(session) == {outcome["new"]})
    finally:
        session.close()
        if outcome["pid"]:
            os.kill(outcome["pid"], 15)
