"""A radar by somebody else is a first-class citizen: fusion takes its word, and `spotter swap` replaces it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

from common import topics
from common.bus.session import open_session
from common.codec import decode
from common.config import ZenohConfig
from common.messages import RadarTracks, ServiceInfo, SystemHealth

pytestmark = [pytest.mark.system, pytest.mark.whole, pytest.mark.slow, pytest.mark.timeout(120)]
HERE = Path(__file__).parent
STANDIN = f"{sys.executable} {HERE / 'standin_radar.py'}"
WORSE = f"{sys.executable} {HERE / 'standin_worse.py'}"
BIN = Path(sys.executable).parent
BUDGET_S = 60.0


@pytest.fixture
def standin(router_endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    """The stand-in as the live radar."""
    process = subprocess.Popen(STANDIN.split(), env={**os.environ, "SPOTTER_CONNECT": router_endpoint})
    yield process
    process.terminate()
    process.wait(10)


@pytest.fixture
def laptop(router_endpoint: str) -> Iterator[zenoh.Session]:
    session = open_session(ZenohConfig(connect=(router_endpoint,)), give_up_after_s=10.0)
    yield session
    session.close()


@contextmanager
def swap(endpoint: str, log: Path, candidate: str, *more: str) -> Iterator[tuple[subprocess.Popen[str], Any]]:
    """The command after it has told its outcome; what it minds is stopped with it."""
    words = [str(BIN / "spotter"), "swap", "radar", "--candidate", candidate, "--json", "--log", str(log)]
    words += ["--seconds", "2", "--probation", "2", "--connect", endpoint, *more]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, json.loads(process.stdout.readline())
        finally:
            process.terminate()


def instances(session: zenoh.Session) -> set[str]:
    replies = session.liveliness().get("pi0/radar/alive/*", timeout=2.0)
    return {topics.parse_token(str(reply.ok.key_expr))[2] for reply in replies if reply.ok is not None}


def pids_of_radar(session: zenoh.Session) -> set[int]:
    answers = [reply.ok for reply in session.get(topics.info_key("pi0", "radar"), timeout=2.0) if reply.ok is not None]
    return {decode(answer.payload.to_bytes(), ServiceInfo).pid for answer in answers}


@pytest.fixture
def until(until: Callable[..., None]) -> Callable[..., None]:
    """With time for processes to start."""
    return partial(until, budget_s=BUDGET_S)


def test_the_standin_is_short_and_needs_nothing_of_ours() -> None:
    text = (HERE / "standin_radar.py").read_text()
    assert len(text.splitlines()) <= 60
    imported = {line.split()[1] for line in text.splitlines() if line.startswith(("import ", "from "))}
    assert imported - set(sys.stdlib_module_names) == {"msgpack", "zenoh"}


def test_fusion_takes_the_word_of_a_foreign_radar(
    standin: Any, laptop: zenoh.Session, router_endpoint: str, until: Callable[..., None]
) -> None:
    fusion = subprocess.Popen([str(BIN / "spotter-fusion"), "--set", f'zenoh.connect=["{router_endpoint}"]'])
    states: list[str] = []

    def note(sample: zenoh.Sample) -> None:
        states.append(decode(sample.payload.to_bytes(), SystemHealth).sensors["radar"].state)

    try:
        laptop.declare_subscriber(topics.FUSION_HEALTH.any_host, note)
        until(lambda: states and states[-1] == "online")
    finally:
        fusion.terminate()
        fusion.wait(10)


@pytest.mark.parametrize(
    ("candidate", "why"),
    [
        (f"{WORSE} slow", "Hz, the live one"),
        (f"{WORSE} late", "latency"),
        (f"{sys.executable} -c 'raise SystemExit(3)'", "ended with code 3"),
    ],
    ids=["slow", "late", "dead"],
)
def test_a_worse_candidate_is_refused(
    standin: Any,
    laptop: zenoh.Session,
    router_endpoint: str,
    tmp_path: Path,
    candidate: str,
    why: str,
    until: Callable[..., None],
) -> None:
    until(lambda: len(instances(laptop)) == 1)
    before = instances(laptop)
    with swap(router_endpoint, tmp_path / "log", candidate) as (process, outcome):
        assert process.wait(10) == 1
        assert any(why in reason for reason in outcome["reasons"]), outcome
        assert instances(laptop) == before


def test_a_swap_that_is_ended_leaves_no_candidate(
    standin: Any, laptop: zenoh.Session, router_endpoint: str, tmp_path: Path, until: Callable[..., None]
) -> None:
    words = ["swap", "radar", "--candidate", STANDIN, "--seconds", "60", "--connect", router_endpoint, "--log"]
    shadows: set[str] = set()

    def note(sample: zenoh.Sample) -> None:
        (shadows.add if sample.kind == zenoh.SampleKind.PUT else shadows.discard)(str(sample.key_expr))

    laptop.liveliness().declare_subscriber("shadow/pi0/radar/alive/*", note)
    with subprocess.Popen([str(BIN / "spotter"), *words, str(tmp_path / "log")], stdout=subprocess.PIPE) as process:
        until(lambda: shadows)
        process.terminate()
        assert process.wait(10) == 1
        until(lambda: not shadows)
    assert len(instances(laptop)) == 1


def test_an_equal_one_takes_over_and_is_minded(
    standin: subprocess.Popen[bytes],
    laptop: zenoh.Session,
    router_endpoint: str,
    tmp_path: Path,
    until: Callable[..., None],
) -> None:
    until(lambda: len(instances(laptop)) == 1)
    with swap(router_endpoint, tmp_path / "log", STANDIN) as (process, outcome):
        assert outcome["promoted"], outcome
        assert outcome["switchover"]["longest_gap_ms"] < 500.0  # the topic's age limit
        assert outcome["switchover"]["messages"] > 10
        assert standin.wait(10) == 0
        until(lambda: instances(laptop) == {outcome["new"]})
        os.kill(outcome["pid"], 9)
        until(lambda: pids_of_radar(laptop) - {outcome["pid"]})  # started again, no longer in the shadow
        assert not any("-after-" in instance for instance in instances(laptop))
        process.terminate()
        process.wait(10)
        until(lambda: not instances(laptop))


@pytest.fixture
def pi(router_endpoint: str, tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A host whose supervisor runs the stand-in as its radar."""
    code = "from common.host.supervisor import *; raise SystemExit(run_supervised(Supervisor([Child('radar', {})])))"
    environment = {**os.environ, "SPOTTER_CONNECT": router_endpoint}
    process = subprocess.Popen([sys.executable, "-c", code.format(STANDIN.split())], env=environment)
    yield process
    process.terminate()
    assert process.wait(10) == 0


def test_a_hosts_supervisor_goes_on_with_the_new_one(
    pi: Any, laptop: zenoh.Session, router_endpoint: str, tmp_path: Path, until: Callable[..., None]
) -> None:
    """The command ends, the host minds what speaks; a second swap that fails is rolled back to the first one's."""
    until(lambda: len(instances(laptop)) == 1)
    with swap(router_endpoint, tmp_path / "log", STANDIN) as (process, outcome):
        assert outcome["promoted"], outcome
        assert outcome["supervised"]
        assert process.wait(10) == 0
        until(lambda: instances(laptop) == {outcome["new"]})
    with swap(router_endpoint, tmp_path / "log", f"{WORSE} mortal") as (process, second):
        assert any("ended with code 9" in reason for reason in second["reasons"]), second
        assert "the old service runs again" in second["reasons"]
        assert process.wait(10) == 1
    until(lambda: len(pids_of_radar(laptop)) == 1)
    (back,) = pids_of_radar(laptop)
    assert back != outcome["pid"]
    os.kill(back, 9)
    until(lambda: pids_of_radar(laptop) - {back})


def test_one_that_fails_after_its_promotion_is_rolled_back(
    standin: subprocess.Popen[bytes],
    laptop: zenoh.Session,
    router_endpoint: str,
    tmp_path: Path,
    until: Callable[..., None],
) -> None:
    received: list[RadarTracks] = []
    until(lambda: len(instances(laptop)) == 1)
    before = instances(laptop)
    with swap(router_endpoint, tmp_path / "log", f"{WORSE} mortal") as (process, outcome):
        assert not outcome["promoted"]
        assert any("ended with code 9" in reason for reason in outcome["reasons"]), outcome
        assert "the old service runs again" in outcome["reasons"]
        assert standin.wait(10) == 0  # it had been stopped: what speaks now is a new process of the same command
        until(lambda: len(instances(laptop)) == 1)
        assert not instances(laptop) & before
        assert not any("-after-" in instance for instance in instances(laptop))
        laptop.declare_subscriber(
            "pi0/radar/tracks", lambda s: received.append(decode(s.payload.to_bytes(), RadarTracks))
        )
        until(lambda: received)
        process.terminate()
        assert process.wait(10) == 1
        until(lambda: not instances(laptop))
