"""More of the attack list, on real processes: a dashboard with a token, a blackbox with capsules, a fusion."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from spotter_tools.cli.__main__ import app

pytestmark = [pytest.mark.system, pytest.mark.timeout(60), pytest.mark.usefixtures("unmoved")]
BIN = Path(sys.executable).parent
TOKEN = "open-sesame"
CAPSULE = "20261119T010000.250Z-imminent"


@pytest.mark.parametrize("path", ["/", "/api/snapshot", "/api/image/jetson0", "/static/main.js", "/anything"])
@pytest.mark.parametrize("given", ["", "?token=", "?token=wrong", f"?token={TOKEN}x", f"?TOKEN={TOKEN}"])
def test_without_the_token_the_dashboard_shows_nothing(vehicle: Any, path: str, given: str) -> None:
    status, body = vehicle.get(path + given, Cookie="spotter_token=wrong")
    assert status == 401
    assert b"spotter" not in body.lower() or b"asks for a token" in body


def test_with_the_token_it_does(vehicle: Any) -> None:
    assert vehicle.get(f"/?token={TOKEN}")[0] == 200
    assert vehicle.get("/api/snapshot", Cookie=f"spotter_token={TOKEN}")[0] == 200


@pytest.mark.parametrize("given", ["", "?token=wrong"])
def test_without_the_token_the_websocket_is_closed(vehicle: Any, given: str) -> None:
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
def test_no_path_leads_out_of_the_page_s_files(vehicle: Any, path: str) -> None:
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
def test_no_name_leads_out_of_the_recordings(vehicle: Any, parameters: str) -> None:
    assert vehicle.capsule(parameters) == b""
    assert vehicle.capsule(f"name={CAPSULE}") == CAPSULE.encode()  # and it still answers


def test_a_wish_to_save_names_no_file(vehicle: Any) -> None:
    for wish in ("why=../../../escape;at_ns=../../escape", "at_ns=99999999999999999999999", "why=" + "x" * 100_000):
        list(vehicle.session.get(f"jetson0/blackbox/save?{wish}", timeout=2.0))
    assert vehicle.capsule(f"name={CAPSULE}") == CAPSULE.encode()
    assert {path.name for path in vehicle.folder.iterdir()} == {"incidents", "secret"}


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "20261119T010000.250Z-imminent/../../x"])
def test_the_command_line_asks_for_no_such_name(vehicle: Any, name: str, tmp_path: Path) -> None:
    words = ["incident", "open", name, "--connect", vehicle.endpoint, "--out", str(tmp_path / "x.mcap")]
    assert CliRunner().invoke(app, words).exit_code == 2
    assert not list(tmp_path.iterdir())


def test_flooding_the_dashboard_does_not_hold_up_the_verdict(vehicle: Any) -> None:
    begun_s, before = time.monotonic(), vehicle.verdicts
    for _ in range(200):
        vehicle.get("/api/snapshot?token=wrong")
    assert (vehicle.verdicts - before) / (time.monotonic() - begun_s) > 5.0
