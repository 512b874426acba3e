"""A running fusion, dashboard and blackbox to be attacked, and the check that none of it moves the verdict."""

from __future__ import annotations

import http.client
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import zenoh

from common import topics
from common.bus.session import build
from common.codec import decode
from common.config import ZenohConfig
from common.messages import Verdict
from spotter_tools.ports import free_port

BIN = Path(sys.executable).parent
TOKEN = "open-sesame"
CAPSULE = "20261119T010000.250Z-imminent"
REQUEST_WITHIN_S = 3.0


@dataclass
class Vehicle:
    """A running fusion, dashboard and blackbox; ``said`` is every different verdict since the beginning."""

    session: zenoh.Session
    endpoint: str
    port: int
    folder: Path
    pids: dict[str, int] = field(default_factory=dict)
    said: set[tuple[str, str, str]] = field(default_factory=set)
    verdicts: int = 0
    news: threading.Condition = field(default_factory=threading.Condition)

    def note(self, sample: zenoh.Sample) -> None:
        verdict = decode(sample.payload.to_bytes(), Verdict)
        with self.news:
            self.said.add((verdict.level, verdict.permission, verdict.rule))
            self.verdicts += 1
            self.news.notify_all()

    def next_verdict(self) -> None:
        """A few more have come."""
        with self.news:
            wanted = self.verdicts + 3
            assert self.news.wait_for(lambda: self.verdicts >= wanted, 20.0)

    def get(self, path: str, **headers: str) -> tuple[int, bytes]:
        """The path as it is: nothing is normalised on the way."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=5)
        connection.putrequest("GET", path, skip_host=False)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        reply = connection.getresponse()
        status, body = reply.status, reply.read()
        connection.close()
        return status, body

    def capsule(self, parameters: str) -> bytes:
        """What the blackbox gives for this question; empty when it refuses."""
        replies = self.session.get(f"jetson0/blackbox/capsule?{parameters}", timeout=2.0)
        return b"".join(reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None)


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory, until: Callable[..., None]) -> Iterator[Vehicle]:
    folder, endpoint, page = tmp_path_factory.mktemp("vehicle"), f"tcp/127.0.0.1:{free_port()}", free_port()
    for place in (folder / "incidents" / CAPSULE, folder / "secret"):
        place.mkdir(parents=True)
        (place / "jetson0.mcap").write_bytes(place.name.encode())
    settings = {
        "fusion": [],
        "dashboard": [
            f"server.token={TOKEN}",
            f"server.port={page}",
            f"server.request_within_s={REQUEST_WITHIN_S}",
        ],
        "blackbox": [f"folder={folder / 'incidents'}"],
    }
    with zenoh.open(build(ZenohConfig(mode="router", connect=(), listen=(endpoint,)))) as session:
        started = []
        for name, more in settings.items():
            words = [word for setting in (f'zenoh.connect=["{endpoint}"]', *more) for word in ("--set", setting)]
            started.append(subprocess.Popen([str(BIN / f"spotter-{name}"), *words], stderr=subprocess.DEVNULL))
        pids = {name: process.pid for name, process in zip(settings, started, strict=True)}
        vehicle = Vehicle(session, endpoint, page, folder, pids)
        kept = session.declare_subscriber(topics.FUSION_VERDICT.any_host, vehicle.note)
        try:
            vehicle.next_verdict()
            until(lambda: vehicle.capsule(f"name={CAPSULE}") == CAPSULE.encode())
            until(lambda: _answers(vehicle))
            yield vehicle
        finally:
            kept.undeclare()
            for process in started:
                process.terminate()
            for process in started:
                process.wait(10)


def _answers(vehicle: Vehicle) -> bool:
    try:
        return vehicle.get("/")[0] == 401
    except OSError:
        return False


@pytest.fixture
def unmoved(vehicle: Vehicle) -> Iterator[None]:
    """Whatever a test tries: fusion goes on and says what it said."""
    before = set(vehicle.said)
    yield
    vehicle.next_verdict()
    assert vehicle.said == before
