"""The whole system on this machine: what it says, and what happens when a process is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from common.bus.session import open_session
from common.config import ZenohConfig
from common.messages import Message, SystemHealth, Verdict
from common.topics import SERVICES

pytestmark = [pytest.mark.system, pytest.mark.whole, pytest.mark.slow, pytest.mark.timeout(240)]
SENSOR_SERVICES = ("radar", "lidar", "camera", "infra_lidar")


def test_json_report_of_a_headless_demo(demo_json: dict[str, Any]) -> None:
    assert set(demo_json) == {"services", "verdict", "health", "latency_ms"}
    assert set(demo_json["services"]) == {row.name for row in SERVICES}
    for name, row in demo_json["services"].items():
        assert row["messages"] > 0, name
        assert row["bad_input"] == 0, name
    for name in ("radar", "lidar"):  # 10 Hz on a free machine; a shared one may be slow, never silent
        assert demo_json["services"][name]["rate_hz"] > 3.0, demo_json["services"]
    assert demo_json["verdict"]["rate_hz"] >= 20.0
    assert set(demo_json["verdict"]["levels_seen"]) == {"SAFE", "CAUTION", "IMMINENT"}
    assert 0 < demo_json["latency_ms"]["p50"] <= demo_json["latency_ms"]["p99"]


def test_the_level_rises_through_caution_and_comes_back(demo_json: dict[str, Any]) -> None:
    levels = [level for _, level, _ in demo_json["verdict"]["history"]]
    changes = [level for i, level in enumerate(levels) if i == 0 or level != levels[i - 1]]
    rising = [changes[i : i + 3] for i in range(len(changes))]
    assert ["SAFE", "CAUTION", "IMMINENT"] in rising, changes


@pytest.mark.parametrize("service", SENSOR_SERVICES)
def test_a_killed_sensor_is_disconnected_at_once_and_comes_back(
    running_demo: Any, service: str, is_all_online: Callable[[Message], bool]
) -> None:
    before = running_demo.instances()
    killed_s = time.monotonic()
    os.kill(running_demo.pid_of(service), signal.SIGKILL)
    gone_s, _ = running_demo.recorder.wait(lambda message: sensor_state(message, service) == "disconnected", killed_s)
    assert gone_s - killed_s < 1.0  # measured about 0.02 s; the target of 0.2 s is a benchmark's, not this test's
    back_s, _ = running_demo.recorder.wait(lambda message: sensor_state(message, service) == "online", gone_s, 60.0)
    running_demo.recorder.wait(is_all_online, back_s, 60.0)
    others = {instance for instance in before if instance[1] != service}
    assert others <= running_demo.instances(), "somebody else was started again"


def sensor_state(message: Message, service: str) -> str | None:
    if not isinstance(message, SystemHealth):
        return None
    if service in message.sensors:
        return message.sensors[service].state
    found = [row for key, row in message.services.items() if key.endswith(f"/{service}")]
    return ("online" if found[0].alive and found[0].state == "online" else "disconnected") if found else None


def test_a_killed_fusion_means_no_verdict_until_it_is_back(running_demo: Any) -> None:
    pid = running_demo.pid_of("fusion")
    os.kill(pid, signal.SIGSTOP)  # hold it, so that the gap is ours to measure
    command = [str(Path(sys.executable).with_name("spotter")), "health", "--connect", running_demo.endpoint]
    completed = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert completed.returncode == 1
    assert "NO VERDICT" in completed.stdout
    killed_s = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    running_demo.recorder.wait(lambda message: isinstance(message, Verdict), killed_s, 30.0)


def test_a_killed_dashboard_is_missed_by_nobody(
    running_demo: Any, is_all_online: Callable[[Message], bool], until: Callable[..., None]
) -> None:
    killed_s = time.monotonic()
    os.kill(running_demo.pid_of("dashboard"), signal.SIGKILL)
    running_demo.recorder.wait(is_all_online, killed_s, 10.0)

    pages: list[bytes] = []

    def answers() -> bool:
        with suppress(OSError):
            pages.append(urllib.request.urlopen(f"http://127.0.0.1:{running_demo.port}/", timeout=2).read())
        return bool(pages)

    until(answers, budget_s=30)
    assert b"NO VERDICT" in pages[0]  # what it says until it knows better


def test_the_demo_speaks_below_a_name_of_its_own_and_is_never_live(
    running_demo: Any, until: Callable[..., None]
) -> None:
    """A reader of the site's keys hears nothing of it, and every verdict says that it is simulated."""
    everything = ZenohConfig(connect=(running_demo.endpoint,), namespace="")
    with open_session(everything, give_up_after_s=10.0) as session:
        keys: set[str] = set()
        kept = session.declare_subscriber("**", lambda sample: keys.add(str(sample.key_expr)))
        until(lambda: {f"demo/{row.host}/{row.name}/status" for row in SERVICES} <= keys)
        assert all(key.startswith("demo/") for key in keys)
        del kept
    verdict = running_demo.recorder.last(Verdict)
    assert (verdict.source_kind, verdict.inputs["lidar"].source_kind) == ("simulated", "simulated")


def test_the_demo_keeps_incidents(running_demo: Any, until: Callable[..., None]) -> None:
    spotter = str(Path(sys.executable).with_name("spotter"))
    place = ["--connect", running_demo.endpoint]
    saved = subprocess.run(
        [spotter, "incident", "save", *place], capture_output=True, text=True, timeout=30, check=True
    )
    assert saved.stdout.startswith("jetson0: ")
    name, command = saved.stdout.split()[1], [spotter, "incident", "list", *place]

    def listed() -> str:
        return subprocess.run(command, capture_output=True, text=True, timeout=30, check=True).stdout

    until(lambda: name in listed(), budget_s=40)


def test_doctor_knows_a_demo_from_a_site(running_demo: Any) -> None:
    command = [str(Path(sys.executable).with_name("spotter")), "doctor", "--json", "--connect", running_demo.endpoint]
    completed = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    found = [json.loads(line) for line in completed.stdout.splitlines()]
    assert found[0]["what"] == f"a demo runs at {running_demo.endpoint}; no site is checked"
    assert not [row for row in found if row["grade"] == "broken"]
    assert {row["check"] for row in found} >= {f"hear {row.host}/{row.name}" for row in SERVICES}
    assert completed.returncode == 0


def test_a_laptop_needs_only_zenoh_and_msgpack(running_demo: Any, tmp_path: Path) -> None:
    environment = tmp_path / "laptop"
    uv = str(Path(sys.executable).with_name("uv"))
    constraints = Path(__file__).parents[2] / "constraints.txt"
    subprocess.run([uv, "venv", "-q", "--python", sys.executable, environment], check=True)
    install = [uv, "pip", "install", "-q", "--python", environment / "bin" / "python", "-c", constraints]
    subprocess.run([*install, "eclipse-zenoh", "msgpack"], check=True)
    script = f"""
import msgpack, zenoh
config = '{{mode: "client", namespace: "demo", connect: {{endpoints: ["{running_demo.endpoint}"]}}}}'
session = zenoh.open(zenoh.Config.from_json5(config))
for sample in (subscriber := session.declare_subscriber("jetson0/fusion/verdict")):
    verdict = msgpack.unpackb(sample.payload.to_bytes())
    print(verdict["level"], verdict["because"]); break
session.close()
"""
    completed = subprocess.run(
        [environment / "bin" / "python", "-c", script], capture_output=True, text=True, timeout=30, check=True
    )
    assert completed.stdout.split()[0] in {"SAFE", "CAUTION", "IMMINENT"}
