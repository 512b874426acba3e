"""Fusion over real Zenoh: sensor services in this process, verdict and health as a laptop sees them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from common import topics
from common.bus.presence import Presence
from common.bus.pubsub import Latest
from common.bus.runtime import Service
from common.bus.session import build, open_session
from common.bus.status import Report
from common.clock import utc_ns
from common.config import ServiceConfig, ZenohConfig
from common.messages import SystemHealth, Verdict
from common.topics import SENSOR_TOPICS
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.fusion.source import observe

BUDGET_S = 60.0
HOSTS = {"lidar": "jetson0", "radar": "pi0", "camera": "jetson0", "infra_lidar": "infra0"}


class Laptop:
    """Follows verdict and health."""

    def __init__(self, config: ZenohConfig) -> None:
        self.session = open_session(config)
        self._wake = threading.Event()
        report = Report("laptop")
        self._verdict = Latest(self.session, topics.FUSION_VERDICT, Verdict, "*/fusion/verdict", report, self._wake)
        self._health = Latest(self.session, topics.FUSION_HEALTH, SystemHealth, "*/fusion/health", report, self._wake)
        self.verdict: Verdict | None = None
        self.health: SystemHealth | None = None

    def until(self, condition: Callable[[], object]) -> None:
        deadline_s = time.monotonic() + BUDGET_S
        while not (self.verdict and self.health and condition()):
            assert time.monotonic() < deadline_s, f"not in time: {self.verdict} {self.health}"
            self._wake.wait(0.05)
            self._wake.clear()
            for received in self._verdict.take():
                self.verdict = received.message
            for health in self._health.take():
                self.health = health.message

    def state(self, sensor: str) -> str:
        assert self.health is not None
        return self.health.sensors[sensor].state


@pytest.fixture
def laptop(zenoh_config: ZenohConfig) -> Iterator[Laptop]:
    one = Laptop(zenoh_config)
    yield one
    one.session.close()


@pytest.fixture
def fusion(zenoh_config: ZenohConfig) -> Iterator[None]:
    """The service's own loop in a thread."""
    config = FusionConfig(zenoh=zenoh_config)
    stop = threading.Event()

    def run() -> None:
        pipeline = FusionPipeline(config)
        with Service("fusion", config) as service:
            verdicts, healths = service.publisher(topics.FUSION_VERDICT), service.publisher(topics.FUSION_HEALTH)
            for observation in observe(service, config):
                if stop.is_set():
                    return
                verdict, health = pipeline.process(observation)
                verdicts(verdict)
                if health is not None:
                    healths(health)

    thread = threading.Thread(target=run)
    thread.start()
    yield
    stop.set()
    thread.join(BUDGET_S)
    assert not thread.is_alive()


class Sensor:
    """A sensor service that publishes the same level ten times a second until it is closed."""

    def __init__(self, name: str, zenoh_config: ZenohConfig, build: Callable[..., Any], level: Any) -> None:
        self.level = level
        self._name, self._build = name, build
        self._config = ServiceConfig(host=HOSTS[name], zenoh=zenoh_config)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(BUDGET_S)

    def _run(self) -> None:
        with Service(self._name, self._config) as service:
            publish = service.publisher(SENSOR_TOPICS[self._name])
            while not self._stop.wait(0.05):
                publish(self._build(utc_ns(), *([] if self._name == "infra_lidar" else [self.level])))


@pytest.fixture
def sensors(zenoh_config: ZenohConfig, build_message: dict[str, Callable[..., Any]]) -> Iterator[dict[str, Sensor]]:
    levels = {"lidar": "SAFE", "radar": "SAFE", "camera": None, "infra_lidar": None}
    running = {name: Sensor(name, zenoh_config, build_message[name], level) for name, level in levels.items()}
    yield running
    for sensor in running.values():
        sensor.close()


def test_it_waits_for_every_sensor_and_then_follows_the_levels(
    fusion: None, laptop: Laptop, zenoh_config: ZenohConfig, build_message: dict[str, Callable[..., Any]]
) -> None:
    laptop.until(lambda: True)
    assert laptop.verdict
    assert laptop.health
    assert (laptop.verdict.level, laptop.verdict.permission, laptop.verdict.blind) == ("CAUTION", "STOP", True)
    assert laptop.health.summary == "ALL VEHICLE SENSORS OUT, SYSTEM BLIND"
    assert laptop.health.sensors["radar"].cause == "waiting"

    running = {
        name: Sensor(name, zenoh_config, build_message[name], level)
        for name, level in (("lidar", "SAFE"), ("radar", "SAFE"), ("camera", None))
    }
    laptop.until(lambda: laptop.health.colour == "green" and laptop.verdict.level == "SAFE")  # type: ignore[union-attr]
    assert laptop.verdict.permission == "GO"

    running["radar"].level = "IMMINENT"
    laptop.until(lambda: laptop.verdict.level == "IMMINENT")  # type: ignore[union-attr]
    assert laptop.verdict.inputs["radar"].used
    assert laptop.verdict.deciding is not None
    assert laptop.verdict.deciding["track_id"] == 7

    running["radar"].close()
    laptop.until(lambda: laptop.state("radar") == "disconnected" and laptop.verdict.rule == "H1-held")  # type: ignore[union-attr]
    assert (laptop.verdict.level, laptop.verdict.permission) == ("IMMINENT", "STOP"), "its death ends no alarm"
    (reply,) = laptop.session.get("jetson0/fusion/acknowledge", timeout=BUDGET_S)
    assert reply.ok is not None
    assert reply.ok.payload.to_string() == "taken: alarms that no sensor sees now are ended"
    laptop.until(lambda: laptop.verdict.level == "SAFE")  # type: ignore[union-attr]
    assert laptop.health.summary == "radar DISCONNECTED: no velocity / no TTC"
    assert laptop.health.sensors["radar"].cause == "service_gone"
    for sensor in running.values():
        sensor.close()


def test_a_sensor_that_comes_back_is_online_again(
    fusion: None,
    laptop: Laptop,
    sensors: dict[str, Sensor],
    zenoh_config: ZenohConfig,
    build_message: dict[str, Callable[..., Any]],
) -> None:
    laptop.until(lambda: all(laptop.state(name) == "online" for name in HOSTS))
    sensors["lidar"].close()
    laptop.until(lambda: laptop.state("lidar") == "disconnected")
    sensors["lidar"] = Sensor("lidar", zenoh_config, build_message["lidar"], "SAFE")
    laptop.until(lambda: laptop.state("lidar") == "online")
    presence = Presence(laptop.session)
    laptop.until(lambda: presence.instances("jetson0", "lidar"))
    presence.close()


def test_fusion_without_a_router_says_that_it_is_isolated_and_comes_back(
    free_ports: Callable[[], int], until: Callable[..., None]
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_ports()}"
    router_config = build(ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace=""))
    config = FusionConfig(zenoh=ZenohConfig(connect=(endpoint,)))
    reports: list[SystemHealth] = []
    stop = threading.Event()

    def run() -> None:
        pipeline = FusionPipeline(config)
        with Service("fusion", config) as service:
            for observation in observe(service, config):
                if stop.is_set():
                    return
                _, health = pipeline.process(observation)
                if health is not None:
                    reports.append(health)

    def isolated() -> bool:
        return reports[-1].summary.startswith("I AM ISOLATED")

    router = zenoh.open(router_config)
    thread = threading.Thread(target=run)
    thread.start()
    try:
        until(lambda: reports and not isolated())
        router.close()
        until(isolated)
        assert {sensor.cause for sensor in reports[-1].sensors.values()} == {"isolated"}
        router = zenoh.open(router_config)
        until(lambda: not isolated())
    finally:
        stop.set()
        thread.join(BUDGET_S)
        router.close()
    assert not thread.is_alive()
