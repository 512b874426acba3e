"""More of the attack list, on real processes: a dashboard with a token, a blackbox with capsules, a fusion."""

from __future__ import annotations

import http.client
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import zenoh
from typer.testing import CliRunner
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from common import topics
from common.cli.__main__ import app
from common.codec import decode
from common.config import ZenohConfig
from common.messages import Verdict
from common.session import build

pytestmark = [pytest.mark.system, pytest.mark.timeout(60)]
BIN = Path(sys.executable).parent
TOKEN = "open-sesame"
CAPSULE = "20261119T010000.250Z-imminent"


@dataclass
class Vehicle:
    """A running fusion, dashboard and blackbox; ``said`` is every different verdict since the beginning."""

    session: zenoh.Session
    endpoint: str
    port: int
    folder: Path
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
    import socket

    ports = []
    for _ in range(2):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            ports.append(probe.getsockname()[1])
    folder, endpoint = tmp_path_factory.mktemp("vehicle"), f"tcp/127.0.0.1:{ports[0]}"
    for place in (folder / "incidents" / CAPSULE, folder / "secret"):
        place.mkdir(parents=True)
        (place / "jetson0.mcap").write_bytes(place.name.encode())
    settings = {
        "fusion": [],
        "dashboard": [f"server.token={TOKEN}", f"server.port={ports[1]}"],
        "blackbox": [f"folder={folder / 'incidents'}"],
    }
    with zenoh.open(build(ZenohConfig(mode="router", connect=(), listen=(endpoint,)))) as session:
        started = []
        for name, more in settings.items():
            words = [word for setting in (f'zenoh.connect=["{endpoint}"]', *more) for word in ("--set", setting)]
            started.append(subprocess.Popen([str(BIN / f"spotter-{name}"), *words], stderr=subprocess.DEVNULL))
        vehicle = Vehicle(session, endpoint, ports[1], folder)
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


@pytest.fixture(autouse=True)
def unmoved(vehicle: Vehicle) -> Iterator[None]:
    """Whatever a test tries: fusion goes on and says what it said."""
    before = set(vehicle.said)
    yield
    vehicle.next_verdict()
    assert vehicle.said == before


@pytest.mark.parametrize("path", ["/", "/api/snapshot", "/api/image/jetson0", "/static/main.js", "/anything"])
@pytest.mark.parametrize("given", ["", "?token=", "?token=wrong", f"?token={TOKEN}x", f"?TOKEN={TOKEN}"])
def test_without_the_token_the_dashboard_shows_nothing(vehicle: Vehicle, path: str, given: str) -> None:
    status, body = vehicle.get(path + given, Cookie="spotter_token=wrong")
    assert status == 401
    assert b"spotter" not in body.lower() or b"asks for a token" in body


def test_with_the_token_it_does(vehicle: Vehicle) -> None:
    assert vehicle.get(f"/?token={TOKEN}")[0] == 200
    assert vehicle.get("/api/snapshot", Cookie=f"spotter_token={TOKEN}")[0] == 200


@pytest.mark.parametrize("given", ["", "?token=wrong"])
def test_without_the_token_the_websocket_is_closed(vehicle: Vehicle, given: str) -> None:
    with pytest.raises(WebSocketException), connect(f"ws://127.0.0.1:{vehicle.port}/ws{given}") as socket:
        socket.recv(timeout=5)


def test_on_another_address_it_does_not_start_without_a_token() -> None:
    words = [str(BIN / "spotter-dashboard"), "--set", "server.address=0.0.0.0"]
    refused = subprocess.run(words, capture_output=True, text=True, timeout=30, check=False)
    assert refused.returncode == 2
    assert "token" in refused.stderr


@pytest.mark.parametrize(
    "path",
    [
        "/static/../config.py",
        "/static/..%2fconfig.py",
        "/static/%2e%2e/%2e%2e/dashboard/server.py",
        "/static/....//config.py",
        "/static//etc/passwd",
        "/static/..%2f..%2f..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
        "/static/..\\..\\config.py",
        "/api/image/..%2f..%2fetc%2fpasswd",
        "//etc/passwd",
    ],
)
def test_no_path_leads_out_of_the_page_s_files(vehicle: Vehicle, path: str) -> None:
    status, body = vehicle.get(path, Cookie=f"spotter_token={TOKEN}")
    assert status in (400, 404)
    assert b"root:" not in body
    assert b"import" not in body


@pytest.mark.parametrize(
    "parameters",
    [
        "name=../secret",
        "name=../secret;part=0",
        f"name={CAPSULE}/../../secret",
        "name=%2e%2e%2fsecret",
        "name=/etc",
        "name=secret",
        "name=.",
        "name=",
        f"name={CAPSULE};part=-1",
        f"name={CAPSULE};part=../0",
        f"name={CAPSULE};part=99999999999999",
    ],
)
def test_no_name_leads_out_of_the_recordings(vehicle: Vehicle, parameters: str) -> None:
    assert vehicle.capsule(parameters) == b""
    assert vehicle.capsule(f"name={CAPSULE}") == CAPSULE.encode()  # and it still answers


def test_a_wish_to_save_names_no_file(vehicle: Vehicle) -> None:
    for wish in ("why=../../../escape;at_ns=../../escape", "at_ns=99999999999999999999999", "why=" + "x" * 100_000):
        list(vehicle.session.get(f"jetson0/blackbox/save?{wish}", timeout=2.0))
    assert vehicle.capsule(f"name={CAPSULE}") == CAPSULE.encode()
    assert {path.name for path in vehicle.folder.iterdir()} == {"incidents", "secret"}


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "20261119T010000.250Z-imminent/../../x"])
def test_the_command_line_asks_for_no_such_name(vehicle: Vehicle, name: str, tmp_path: Path) -> None:
    words = ["incident", "open", name, "--connect", vehicle.endpoint, "--out", str(tmp_path / "x.mcap")]
    assert CliRunner().invoke(app, words).exit_code == 2
    assert not list(tmp_path.iterdir())


def test_flooding_the_dashboard_does_not_hold_up_the_verdict(vehicle: Vehicle) -> None:
    begun_s, before = time.monotonic(), vehicle.verdicts
    for _ in range(200):
        vehicle.get("/api/snapshot?token=wrong")
    assert (vehicle.verdicts - before) / (time.monotonic() - begun_s) > 5.0
