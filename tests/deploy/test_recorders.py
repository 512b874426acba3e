"""Who records is told where rules are in force: a laptop says that and nothing else, seldom and in few words."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from common.bus.session import close_session, open_session
from common.config import load
from common.host.site import Site
from common.security.names import Name, Names
from common.security.router_config import WORD_BYTES, WORD_HZ
from common.security.rules import laptop_recorders

pytestmark = [pytest.mark.patient, pytest.mark.timeout(60)]
OWN = "laptop1/recorder/status"
NOT_OWN = (
    "laptop2/recorder/status",
    "pi0/recorder/status",
    "laptop1/recorder/tracks",
    "laptop1/recorder/status/more",
    "laptop1/radar/status",
    "laptop1/fusion/verdict",
    "recorder/status",
)


@pytest.fixture
def laptop(yard: Any) -> Iterator[Callable[..., zenoh.Session]]:
    """``laptop(host)``: laptop1 as a client of that host's router."""
    opened: list[zenoh.Session] = []

    def come(host: str = "jetson0") -> zenoh.Session:
        opened.append(yard.laptop(host))
        return opened[-1]

    yield come
    for session in opened:
        close_session(session)


@pytest.mark.parametrize("host", ["jetson0", "pi0"])
def test_a_laptop_s_recorder_is_heard_wherever_it_connects(
    yard: Any, laptop: Callable[..., zenoh.Session], until: Callable[..., None], host: str
) -> None:
    """On the vehicle, and by other laptops."""
    session, listener, samples = laptop(host), laptop("infra0"), []
    listener.declare_subscriber(OWN, samples.append)
    word = b"recording at " + host.encode()

    def is_heard() -> bool:
        session.put(OWN, word)
        return (OWN, word) in yard.received and word in [sample.payload.to_bytes() for sample in samples]

    until(is_heard)


@pytest.mark.parametrize("key", NOT_OWN)
def test_it_says_nothing_else(yard: Any, laptop: Callable[..., zenoh.Session], key: str) -> None:
    laptop().put(key, b"lie on " + key.encode())
    assert not yard.hears(b"lie on " + key.encode())


def test_it_has_no_token_and_answers_nothing(yard: Any, laptop: Callable[..., zenoh.Session]) -> None:
    """Tokens cannot be limited in their rate, and fusion minds every one."""
    session, asked = laptop(), []
    token = session.liveliness().declare_token("laptop1/recorder/alive/1")
    queryable = session.declare_queryable(OWN, asked.append)
    yard.settle()
    assert not list(yard.clients["jetson0"].get(OWN, timeout=0.5))
    assert not asked
    assert not yard.tokens
    token.undeclare()
    queryable.undeclare()


def test_its_flood_is_let_in_at_its_pace(yard: Any, laptop: Callable[..., zenoh.Session]) -> None:
    session, begun_s = laptop(), time.monotonic()
    for _ in range(20_000):
        session.put(OWN, b"flood", priority=zenoh.Priority.REAL_TIME)
    yard.settle()
    count = [payload for _, payload in yard.received].count(b"flood")
    assert count <= WORD_HZ * (time.monotonic() - begun_s) + 1


def test_its_words_are_short(yard: Any, laptop: Callable[..., zenoh.Session], until: Callable[..., None]) -> None:
    session = laptop()
    for size in (WORD_BYTES + 1, 5_000_000):
        session.put(OWN, b"x" * size)
    yard.settle()
    assert not any(key == OWN and len(payload) > WORD_BYTES for key, payload in yard.received)


def test_a_revoked_laptop_says_nothing(yard: Any) -> None:
    session = open_session(yard.named("thief"), give_up_after_s=20.0)
    session.put("thief/recorder/status", b"from the thief")
    assert not yard.hears(b"from the thief")
    close_session(session)


def test_a_host_s_recorder_speaks_under_its_host_s_name_only(yard: Any, until: Callable[..., None]) -> None:
    pi = yard.clients["pi0"]
    pi.put("pi0/recorder/status", b"on the pi")
    pi.put("jetson0/recorder/status", b"not on the pi")
    pi.put(OWN, b"not the laptop")
    token = pi.liveliness().declare_token("pi0/recorder/alive/1")
    vehicle = yard.clients["jetson0"].liveliness()
    until(lambda: [str(r.ok.key_expr) for r in vehicle.get("pi0/**") if r.ok] == ["pi0/recorder/alive/1"])
    assert yard.hears(b"on the pi")
    assert not yard.hears(b"not on the pi")
    assert not yard.hears(b"not the laptop")
    token.undeclare()


@pytest.mark.parametrize("name", ["**", "*", "pi0", "a/b", "Anna", "a-b", ""])
def test_a_name_that_is_no_key_or_a_host_s_says_nothing(name: str) -> None:
    names = Names(names={name: Name(kind="laptop"), "ok1": Name(kind="laptop", generation=2)})
    assert laptop_recorders(load(Site, None), names) == {"ok1": "spotter/ok1/recorder/status"}


@contextmanager
def process(*command: str, **environment: str) -> Iterator[subprocess.Popen[str]]:
    """One of our commands until the block ends."""
    script = [str(Path(sys.executable).with_name(command[0])), *command[1:]]
    with subprocess.Popen(script, stderr=subprocess.PIPE, text=True, env=os.environ | environment) as running:
        try:
            yield running
        finally:
            running.send_signal(signal.SIGINT)


def test_the_page_shows_what_a_laptop_records(
    yard: Any, free_ports: Callable[[], int], until: Callable[..., None], tmp_path: Path
) -> None:
    """The dashboard on the vehicle's loopback, `spotter record` behind the Pi's router under its certificate."""
    port = free_ports()
    to_router = f'zenoh.connect=["{yard.site.host("jetson0").loopback}"]'
    laptop = {"SPOTTER_CERTIFICATE": str(yard.keys / "laptop1.crt"), "SPOTTER_CONNECT": yard.site.endpoint("pi0")}
    with (
        process("spotter-dashboard", "--set", to_router, "--set", f"server.port={port}"),
        process("spotter", "record", str(tmp_path), "--no-foxglove", **laptop),
    ):

        def shown() -> bool:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/snapshot", timeout=5) as reply:
                    return OWN in json.load(reply)["entries"]
            except OSError:
                return False

        until(shown)


def test_a_recorder_under_another_name_warns_that_the_others_are_not_informed(yard: Any, tmp_path: Path) -> None:
    laptop = {"SPOTTER_CERTIFICATE": str(yard.keys / "laptop1.crt"), "SPOTTER_CONNECT": yard.site.endpoint("jetson0")}
    with process("spotter", "record", str(tmp_path), "--no-foxglove", "--host", "pi0", **laptop) as recorder:
        assert recorder.stderr is not None
        assert any("let no client here publish as `pi0`" in line for line in recorder.stderr)
