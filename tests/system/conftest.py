"""A running demo for the tests that pull its plugs: real processes, real Zenoh, free ports on loopback."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from common import topics
from common.bus.session import open_session
from common.codec import DecodeError, decode
from common.config import ZenohConfig
from common.messages import Message, ServiceInfo, SystemHealth, Verdict
from spotter_tools.ports import free_port

SPOTTER = str(Path(sys.executable).with_name("spotter"))


class Recorder:
    """Everything that was published, with the monotonic time it arrived; ``wait`` for what has to come."""

    def __init__(self, session: zenoh.Session) -> None:
        self.seen: list[tuple[float, str, Message]] = []
        self._changed = threading.Condition()
        self._subscribers = [
            session.declare_subscriber(topic.any_host, self._note)
            for topic in (topics.FUSION_VERDICT, topics.FUSION_HEALTH, topics.RADAR_TRACKS, topics.INFRA_TRACKS)
        ]

    def _note(self, sample: zenoh.Sample) -> None:
        topic = topics.find_topic(str(sample.key_expr))
        assert topic is not None
        try:
            message = decode(sample.payload.to_bytes(), topic.message)
        except DecodeError:
            return
        with self._changed:
            self.seen.append((time.monotonic(), str(sample.key_expr), message))
            self._changed.notify_all()

    def wait(
        self, wanted: Callable[[Message], object], since_s: float = 0.0, budget_s: float = 40.0
    ) -> tuple[float, Message]:
        """The first message since ``since_s`` for which ``wanted`` holds, with its arrival time."""
        deadline_s = time.monotonic() + budget_s
        checked = 0
        with self._changed:
            while True:
                for arrived_s, _, message in self.seen[checked:]:
                    if arrived_s >= since_s and wanted(message):
                        return arrived_s, message
                checked = len(self.seen)
                left_s = deadline_s - time.monotonic()
                assert left_s > 0, f"nothing like it within {budget_s} s; last: {self.seen[-1:]}"
                self._changed.wait(left_s)

    def last(self, kind: type[Message]) -> Message | None:
        with self._changed:
            return next((message for _, _, message in reversed(self.seen) if isinstance(message, kind)), None)


class Demo:
    """A demo process and a laptop's session to it."""

    def __init__(self, process: subprocess.Popen[bytes], endpoint: str, port: int, log: Path) -> None:
        self.process = process
        self.endpoint = endpoint
        self.port = port
        self.log = log
        self.session = open_session(ZenohConfig(connect=(endpoint,), namespace="demo"), give_up_after_s=60.0)
        self.recorder = Recorder(self.session)

    def pid_of(self, service: str) -> int:
        """Process id of a service's newest instance."""
        row = topics.service_row(service)
        newest: ServiceInfo | None = None
        for reply in self.session.get(topics.info_key(row.host, service), timeout=5.0):
            info = decode(reply.ok.payload.to_bytes(), ServiceInfo)
            newest = info if newest is None or info.started_ns > newest.started_ns else newest
        assert newest is not None, f"{service} does not answer; {self.log.read_text()[-3000:]}"
        return newest.pid

    def instances(self) -> set[tuple[str, str, str]]:
        replies = self.session.liveliness().get(topics.ANY_TOKEN, timeout=5.0)
        return {topics.parse_token(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None}


def start_demo(tmp_path: Path, *arguments: str) -> Demo:
    port, endpoint, log = free_port(), f"tcp/127.0.0.1:{free_port()}", tmp_path / "demo.log"
    command = [SPOTTER, "demo", "--listen", endpoint, "--port", str(port), *arguments]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True)
    return Demo(process, endpoint, port, log)


def stop_demo(demo: Demo) -> int:
    demo.session.close()
    demo.process.send_signal(signal.SIGINT)
    try:
        return demo.process.wait(15)
    except subprocess.TimeoutExpired:
        os.killpg(demo.process.pid, signal.SIGKILL)
        raise


@pytest.fixture(scope="module")
def running_demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    """One demo of `crossing` for a module's tests, up and with every sensor online."""
    demo = start_demo(tmp_path_factory.mktemp("demo"))
    try:
        try:
            demo.recorder.wait(all_online, budget_s=110.0)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{demo.log.read_text()[-4000:]}") from None
        yield demo
    finally:
        stop_demo(demo)


def all_online(message: Message) -> bool:
    return (
        isinstance(message, SystemHealth)
        and bool(message.sensors)
        and all(sensor.state == "online" for sensor in message.sensors.values())
    )


@pytest.fixture(scope="session")
def is_all_online() -> Callable[[Message], bool]:
    return all_online


@pytest.fixture(scope="session")
def demo_json(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What ``spotter demo --seconds 20 --json`` prints."""
    import socket

    ports = []
    for _ in range(2):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            ports.append(probe.getsockname()[1])
    command = [
        SPOTTER,
        "demo",
        "--seconds",
        "20",
        "--json",
        "--listen",
        f"tcp/127.0.0.1:{free_port()}",
        "--port",
        str(free_port()),
    ]
    log = tmp_path_factory.mktemp("json") / "log"
    with log.open("wb") as output:
        finished = subprocess.run(command, stdout=subprocess.PIPE, stderr=output, timeout=150, check=False)
    assert finished.returncode == 0, log.read_text()[-4000:]
    result: dict[str, Any] = json.loads(finished.stdout)
    return result


def no_verdict_since(recorder: Recorder, since_s: float) -> bool:
    return not any(arrived_s > since_s and isinstance(message, Verdict) for arrived_s, _, message in recorder.seen)
