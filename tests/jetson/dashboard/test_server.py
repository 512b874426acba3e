"""The server as a process: pages, token, strangers, slow clients, on-demand topics, a taken port, a clean end."""

from __future__ import annotations

import contextlib
import http.client
import json
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from common import topics
from common.bus.runtime import Service
from common.config import ServiceConfig, ZenohConfig
from common.messages import CompressedImage, Verdict

pytestmark = [pytest.mark.system]
Until = Callable[..., None]


def get(url: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=30) as reply:
            return reply.status, dict(reply.headers), reply.read()
    except urllib.error.HTTPError as error:
        return error.code, dict(error.headers), error.read()


def verdict(stamp_ns: int = 1) -> Verdict:
    return Verdict(
        stamp_ns=stamp_ns, level="SAFE", rule="R0", because="test", inputs={}, confirmed=False,
        suppressed=False, advisory=None, blind=False, permission="GO",
    )  # fmt: skip


@pytest.fixture(scope="module")
def dashboard(module_router: str, start_dashboard_at: Callable[..., Any]) -> Any:
    """One dashboard without a token for all tests that leave it as it was."""
    return start_dashboard_at(module_router)


@pytest.fixture(scope="module")
def on_its_router(module_router: str) -> ZenohConfig:
    return ZenohConfig(connect=(module_router,))


def test_the_page_needs_nothing_from_elsewhere(dashboard: Any) -> None:
    status, headers, page = get(f"{dashboard.url}/")
    assert status == 200
    assert "default-src 'self'" in headers["content-security-policy"]
    assert b"http://" not in page
    assert b"https://" not in page


@pytest.mark.parametrize(
    "path", ["/static/../config.py", "/static/%2e%2e/config.py", "/../../etc/passwd", "/api/image/.."]
)
def test_no_file_outside_the_page_is_given(dashboard: Any, path: str) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", dashboard.port, timeout=5)
    connection.request("GET", path)
    assert connection.getresponse().status in (400, 404)
    connection.close()


def test_without_its_token_nothing_is_told(module_router: str, start_dashboard_at: Callable[..., Any]) -> None:
    dashboard = start_dashboard_at(module_router, "server.token=open-sesame")
    for path in ("/", "/api/snapshot", "/static/main.js", "/?token=wrong"):
        assert get(dashboard.url + path)[0] == 401, path
    with pytest.raises(WebSocketException):
        connect(f"ws://127.0.0.1:{dashboard.port}/ws")
    status, headers, _ = get(f"{dashboard.url}/?token=open-sesame")
    assert status == 200
    cookie = headers["set-cookie"].split(";")[0]
    assert get(f"{dashboard.url}/api/snapshot", Cookie=cookie)[0] == 200
    with connect(f"ws://127.0.0.1:{dashboard.port}/ws?token=open-sesame") as client:
        assert "entries" in json.loads(client.recv(timeout=5))


def test_a_page_of_another_site_may_not_listen(dashboard: Any) -> None:
    with pytest.raises(WebSocketException):
        connect(f"ws://127.0.0.1:{dashboard.port}/ws", origin="http://elsewhere.example")  # type: ignore[arg-type]


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", ""])
def test_a_name_that_is_not_ours_is_refused(dashboard: Any, host: str) -> None:
    """Under DNS rebinding a foreign page has our address, and Origin and Host agree."""
    for path in ("/", "/api/snapshot", "/static/main.js"):
        assert get(dashboard.url + path, Host=host)[0] in (400, 421), path
    with pytest.raises(WebSocketException), socket.create_connection(("127.0.0.1", dashboard.port)) as raw:
        connect(f"ws://{host or 'evil.example'}/ws", sock=raw, origin=f"http://{host}")  # type: ignore[arg-type]


def test_a_malformed_name_is_refused(dashboard: Any) -> None:
    assert get(dashboard.url, Host="[::1")[0] in (400, 421)


def test_the_site_s_and_the_configured_names_are_served(
    module_router: str, start_dashboard_at: Callable[..., Any]
) -> None:
    dashboard = start_dashboard_at(module_router, 'server.allowed_hosts=["board.lan"]', 'server.site_hosts=["jetson0"]')
    for host in ("board.lan", "jetson0:8080", "LOCALHOST", "10.0.0.7:8080", "[::1]:8080"):
        assert get(dashboard.url, Host=host)[0] == 200, host
    assert get(dashboard.url, Host="jetson1")[0] == 421


def test_pictures_are_made_only_while_somebody_looks(dashboard: Any, on_its_router: ZenohConfig, until: Until) -> None:
    with Service("camera", ServiceConfig(host="jetson0", zenoh=on_its_router)) as camera:
        publish = camera.publisher(topics.CAMERA_IMAGE)
        assert not publish.wanted
        with connect(f"ws://127.0.0.1:{dashboard.port}/ws") as client:
            client.send(json.dumps({"rate_hz": 10, "products": ["camera/image"]}))
            until(lambda: publish.wanted)
            publish(CompressedImage(stamp_ns=1, format="jpeg", data=b"\xff\xd8\xff"))
            until(lambda: get(f"{dashboard.url}/api/image/jetson0")[2] == b"\xff\xd8\xff")
            for stamp, code in (("1", 200), ("2", 404), ("-5", 404), ("abc", 404), (23 * "9", 404)):
                assert get(f"{dashboard.url}/api/image/jetson0?stamp={stamp}")[0] == code, stamp
        until(lambda: not publish.wanted)


def test_a_client_that_does_not_read_delays_nobody(dashboard: Any, on_its_router: ZenohConfig, until: Until) -> None:
    stop = threading.Event()
    with Service("fusion", ServiceConfig(host="jetson0", zenoh=on_its_router)) as fusion:
        publish = fusion.publisher(topics.FUSION_VERDICT)

        def speak() -> None:
            while not stop.wait(0.02):
                publish(verdict(time.time_ns()))

        speaker = threading.Thread(target=speak)
        speaker.start()
        try:
            stuck = connect(f"ws://127.0.0.1:{dashboard.port}/ws", max_queue=1, close_timeout=0.2, legacy=True)
            stuck.send('{"rate_hz": 20}')
            with connect(f"ws://127.0.0.1:{dashboard.port}/ws") as lively:
                lively.send('{"rate_hz": 20}')
                ages_ms = []
                until(lambda: "jetson0/fusion/verdict" in json.loads(lively.recv(timeout=5))["entries"])
                for _ in range(40):
                    entries = json.loads(lively.recv(timeout=5))["entries"]
                    ages_ms.append(entries["jetson0/fusion/verdict"]["age_ms"])
            assert sorted(ages_ms)[20] < 500
            with contextlib.suppress(WebSocketException, TimeoutError):
                stuck.close()
        finally:
            stop.set()
            speaker.join()


def test_a_taken_port_is_told(on_its_router: ZenohConfig) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        script = str(Path(sys.executable).with_name("spotter-dashboard"))
        command = [script, "--set", f'zenoh.connect=["{on_its_router.connect[0]}"]', "--set", f"server.port={port}"]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert ended.returncode == 2
    assert f"[server] port = {port}: cannot listen" in ended.stderr


def test_an_open_address_without_a_token_is_refused() -> None:
    script = str(Path(sys.executable).with_name("spotter-dashboard"))
    ended = subprocess.run(
        [script, "--set", "server.address=0.0.0.0"], capture_output=True, text=True, timeout=30, check=False
    )
    assert ended.returncode == 2
    assert "set [server] token" in ended.stderr


def test_it_ends_within_a_second_with_clients_connected(
    module_router: str, start_dashboard_at: Callable[..., Any]
) -> None:
    dashboard = start_dashboard_at(module_router)
    with connect(f"ws://127.0.0.1:{dashboard.port}/ws") as client:
        client.recv(timeout=5)
        dashboard.process.send_signal(signal.SIGTERM)
        assert dashboard.process.wait(10) == 0
