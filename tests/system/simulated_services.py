"""The services on a simulated clock: each one's own source, parser and pipeline, and what it would publish."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from common import clock as clocks
from common import pacing, topics
from common.bus.status import Report
from common.path import Motion
from services.infra_lidar.config import InfraLidarConfig, VisibilityConfig
from services.infra_lidar.input import source as infra_source
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.jetson.camera import source as camera_source
from services.jetson.camera.config import CameraConfig, CaptureConfig
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.ego import source as ego_source
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.pipeline import EgoPipeline
from services.jetson.lidar import source as lidar_source
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.pipeline import LidarPipeline
from services.radar_pi import source as radar_source
from services.radar_pi.config import RadarConfig
from services.radar_pi.pipeline import RadarPipeline
from spotter_sim import scenario_clock

START_NS = 1_800_000_000_000_000_000  # a multiple of every scenario's length: scenario time begins at 0
KEYS = {
    "radar": topics.RADAR_TRACKS.key("pi0"),
    "lidar": topics.LIDAR_ZONES.key("jetson0"),
    "camera": topics.CAMERA_DETECTIONS.key("jetson0"),
    "infra_lidar": topics.INFRA_TRACKS.key("infra0"),
    "ego": topics.EGO_MOTION.key("jetson0"),
}
DELAY_S = {"radar": 0.03, "lidar": 0.005, "camera": 0.05, "infra_lidar": 0.08, "ego": 0.0}  # processing and transport


class Over(Exception):
    """The simulated time has run out."""


@dataclass
class Clock:
    """What a source takes for the time: it passes only while the source waits."""

    end_s: float
    now_s: float = 0.0

    def utc_ns(self) -> int:
        return START_NS + round(self.now_s * 1e9)

    def monotonic_s(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s = round(self.now_s + max(0.0, seconds), 9)
        if self.now_s >= self.end_s:
            raise Over

    def is_set(self) -> bool:
        """As ``wait``: for the camera this is its stop event."""
        return False

    def wait(self, seconds: float) -> bool:
        """The camera waits on its stop event; it is never set."""
        self.sleep(seconds)
        return False


@dataclass
class Sent:
    """Everything that one service would publish: (time of arrival, key, message)."""

    name: str
    clock: Clock
    log: list[tuple[float, str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.report = Report(self.name)
        self._next_status_s = 0.0
        host = KEYS[self.name].split("/", 1)[0]
        self._status_key = topics.status_topic(self.name).key(host)

    def publish(self, message: Any) -> None:
        message.seq = len(self.log)
        message.sent_ns = self.clock.utc_ns()
        self.log.append((self.clock.now_s + DELAY_S[self.name], KEYS[self.name], message))
        self.report.published(message, primary=True)

    def tell_status(self) -> None:
        """On change and once a second, as the service's own thread does."""
        now_s = self.clock.now_s
        if self.report.changed.is_set() or now_s >= self._next_status_s:
            self.report.changed.clear()
            self._next_status_s = now_s + 1.0
            status = msgspec.structs.replace(self.report.snapshot(), stamp_ns=self.clock.utc_ns())
            self.log.append((now_s, self._status_key, status))


def radar(scenario: str, sent: Sent) -> Iterator[Any]:
    config = RadarConfig(source=f"sim:{scenario}")
    pipeline = RadarPipeline(config)
    for frame in radar_source.open_source(config, sent.report):
        tracks = pipeline.process(frame.stamp_ns, frame.samples, Motion(0.0, 0.0), frame.epoch, frame.note)
        tracks.received_ns = frame.received_ns
        yield tracks


def lidar(scenario: str, sent: Sent) -> Iterator[Any]:
    config = LidarConfig(source=f"sim:{scenario}")
    pipeline = LidarPipeline(config)
    for stamp_ns, scan in lidar_source.open_source(config, sent.report):
        yield pipeline.process(stamp_ns, scan)


def camera(scenario: str, sent: Sent) -> Iterator[Any]:
    """At 10 Hz instead of 15: enough to tell the story."""
    capture = CaptureConfig(rate_hz=10.0)
    config = camera_source.fitted(CameraConfig(source=f"sim:{scenario}", capture=capture))
    pipeline = CameraPipeline(config)
    frames, _ = camera_source.open_source(config, sent.report)
    for frame in frames(sent.clock):  # type: ignore[arg-type]
        seen = pipeline.process(frame.stamp_ns, frame.image)
        seen.received_ns = frame.received_ns
        yield seen


def infra_lidar(scenario: str, sent: Sent) -> Iterator[Any]:
    """With half of the columns; how long a frame takes on this machine is no part of the story."""
    config = InfraLidarConfig(source=f"sim:{scenario}?columns=900", visibility=VisibilityConfig(budget_ms=1e6))
    config = msgspec.structs.replace(config, T_map_sensor=infra_source.surveyed_pose(config))
    pipeline = InfraLidarPipeline(config)
    for stamp_ns, frame in infra_source.open_source(config, sent.report):
        yield pipeline.process(stamp_ns, frame.points, frame.quality, frame.received_ns).tracks


def ego(scenario: str, sent: Sent) -> Iterator[Any]:
    config = EgoConfig(source=f"sim:{scenario}")
    pipeline = EgoPipeline(config)
    for stamp_ns, motion in ego_source.open_source(config):
        yield pipeline.process(stamp_ns, motion)


Service = Callable[[str, Sent], Iterator[Any]]
SERVICES: dict[str, tuple[Service, Any]] = {
    "radar": (radar, radar_source),
    "lidar": (lidar, lidar_source),
    "camera": (camera, camera_source),
    "infra_lidar": (infra_lidar, infra_source),
    "ego": (ego, ego_source),
}


def run_service(name: str, scenario: str, seconds: float) -> list[tuple[float, str, Any]]:
    """What the service publishes in that time, on a clock of its own."""
    service, module = SERVICES[name]
    sent = Sent(name, Clock(seconds))
    sleep = sent.clock.sleep

    def watched_sleep(duration_s: float) -> None:
        sent.tell_status()
        sleep(duration_s)

    sent.clock.sleep = watched_sleep  # type: ignore[method-assign]
    with pytest.MonkeyPatch.context() as patch:
        for place, clock in itertools.product((clocks, pacing, scenario_clock, module), ("utc_ns", "monotonic_s")):
            if hasattr(place, clock):
                patch.setattr(place, clock, getattr(sent.clock, clock))
        for place in (pacing, module):
            if hasattr(place, "time"):
                patch.setattr(place, "time", SimpleNamespace(sleep=watched_sleep))
        try:
            for message in service(scenario, sent):
                sent.publish(message)
        except Over:
            return sent.log
    raise AssertionError(f"the source of {name} has ended")
