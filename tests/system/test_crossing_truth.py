"""The demonstration's story against the simulated truth: world -> wire data -> all pipelines -> verdict and health.

Every service's own source, parser and pipeline run on a simulated clock, one after the other; what they would publish
is delivered to fusion in the order of time. No process, no network, no waiting: the same figures on every machine.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from common import clock as clocks
from common import topics
from common.messages import LEVELS, SensorHealth, Verdict
from common.pubsub import Received
from common.sim import scenario_clock
from common.sim.truth import expect
from common.sim.world import SCENARIOS
from common.status import Report
from services.infra_lidar import source as infra_source
from services.infra_lidar.config import BlindnessConfig, InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.jetson.camera import source as camera_source
from services.jetson.camera.config import CameraConfig, CaptureConfig
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.ego import source as ego_source
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.pipeline import EgoPipeline
from services.jetson.fusion.config import FusionConfig, RoadsideConfig
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.lidar import source as lidar_source
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.pipeline import LidarPipeline
from services.radar_pi import source as radar_source
from services.radar_pi.config import RadarConfig
from services.radar_pi.pipeline import RadarPipeline

pytestmark = pytest.mark.slow

START_NS = 1_800_000_000_000_000_000  # a multiple of every scenario's length: scenario time begins at 0
LAG_S, LEAD_S = 0.6, 0.3  # the verdict's delay by persistence; the roadside sees an approach before the vehicle does
FAULT_LAG_S = 2.5  # until a fault is noticed (lidar: 15 scans) and an alarm it may hide has been let go
STEP_S = 0.1  # between two looks at the truth
SETTLED_S = 2.0  # after the start: the radar has learned its background
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
        tracks = pipeline.process(frame.stamp_ns, frame.samples, 0.0, frame.epoch, frame.note)
        tracks.received_ns = frame.received_ns
        yield tracks


def lidar(scenario: str, sent: Sent) -> Iterator[Any]:
    config = LidarConfig(source=f"sim:{scenario}")
    pipeline = LidarPipeline(config)
    for stamp_ns, scan in lidar_source.open_source(config, sent.report):
        yield pipeline.process(stamp_ns, scan)


def camera(scenario: str, sent: Sent) -> Iterator[Any]:
    """At 5 Hz instead of 15: enough to tell the story."""
    capture = CaptureConfig(rate_hz=5.0)
    config = camera_source.fitted(CameraConfig(source=f"sim:{scenario}", capture=capture))
    pipeline = CameraPipeline(config)
    frames, _ = camera_source.open_source(config, sent.report)
    for frame in frames(sent.clock):  # type: ignore[arg-type]
        seen = pipeline.process(frame.stamp_ns, frame.image)
        seen.received_ns = frame.received_ns
        yield seen


def infra_lidar(scenario: str, sent: Sent) -> Iterator[Any]:
    """With half of the columns; how long a frame takes on this machine is no part of the story."""
    config = InfraLidarConfig(source=f"sim:{scenario}?columns=900", blindness=BlindnessConfig(budget_ms=1e6))
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
        for place, clock in itertools.product((clocks, scenario_clock, module), ("utc_ns", "monotonic_s")):
            if hasattr(place, clock):
                patch.setattr(place, clock, getattr(sent.clock, clock))
        if hasattr(module, "time"):
            patch.setattr(module, "time", SimpleNamespace(sleep=watched_sleep))
        try:
            for message in service(scenario, sent):
                sent.publish(message)
        except Over:
            return sent.log
    raise AssertionError(f"the source of {name} has ended")


@dataclass
class Story:
    """What fusion said: verdicts, and health whenever it was told."""

    scenario: str
    verdicts: list[tuple[float, Verdict]] = field(default_factory=list)
    health: list[tuple[float, dict[str, SensorHealth]]] = field(default_factory=list)

    def levels(self) -> list[str]:
        """Levels in the order in which they came, after settling, without repetitions."""
        told = [verdict.level for at_s, verdict in self.verdicts if at_s >= SETTLED_S]
        return [level for i, level in enumerate(told) if i == 0 or level != told[i - 1]]

    def states(self, sensor: str, begin_s: float, end_s: float) -> set[str]:
        return {h[sensor].state for at_s, h in self.health if begin_s <= at_s < end_s}

    def reasons(self, sensor: str, begin_s: float, end_s: float) -> set[str]:
        return {h[sensor].reason for at_s, h in self.health if begin_s <= at_s < end_s}


def tell(scenario: str, seconds: float, names: Iterable[str]) -> Story:
    """Run the services one by one, then fusion on all they sent, in the order of arrival."""
    names = list(names)
    log = sorted((one for name in names for one in run_service(name, scenario, seconds)), key=lambda one: one[0])
    present = frozenset((KEYS[name].split("/")[0], name, "a") for name in names)
    pipeline = FusionPipeline(FusionConfig(roadside=RoadsideConfig(enabled="infra_lidar" in names)))
    story = Story(scenario)
    for at_s, key, message in log:
        now_ns = START_NS + round(at_s * 1e9)
        received = (Received(key, message, at_s, now_ns),)
        verdict, health = pipeline.process(Observation(now_s=at_s, now_ns=now_ns, received=received, present=present))
        story.verdicts.append((at_s, verdict))
        if health is not None:
            story.health.append((at_s, dict(health.sensors)))
    assert not pipeline.bad_input
    return story


@pytest.fixture(scope="module")
def crossing() -> Story:
    """Two turns; in the second one the pole's lidar has learned its background."""
    return tell("crossing", 2 * SCENARIOS["crossing"].length_s, SERVICES)


@pytest.fixture(scope="module")
def faults() -> Story:
    return tell("faults", SCENARIOS["faults"].length_s, [name for name in SERVICES if name != "infra_lidar"])


@cache
def true_ranks(scenario: str) -> np.ndarray:
    """The rank of the true verdict every 0.1 s; one second beyond the scenario's end."""
    times = np.arange(0.0, max(30.0, SCENARIOS[scenario].length_s), STEP_S)
    ranks = [LEVELS.index(expect(scenario, float(t)).verdict) for t in times]
    return np.array(ranks + ranks[:10])


def around(scenario: str, at_s: float, lag_s: float) -> np.ndarray:
    """The true ranks in the last ``lag_s`` and the next ``LEAD_S``."""
    first, last = math.floor((at_s - lag_s) / STEP_S), math.ceil((at_s + LEAD_S) / STEP_S)
    return true_ranks(scenario)[max(0, first) : last + 1]


def test_crossing_goes_up_and_down_twice_a_turn(crossing: Story) -> None:
    """SAFE, CAUTION, IMMINENT and back for the person and for the car, without a step in between."""
    up_and_down = ["CAUTION", "IMMINENT", "CAUTION", "SAFE"]
    assert crossing.levels() == ["SAFE", *4 * up_and_down]


def test_crossing_follows_the_truth(crossing: Story) -> None:
    """Every verdict is a level that was true in the last 0.6 s or will be in the next 0.3 s, or between two such."""
    for at_s, verdict in crossing.verdicts:
        if at_s >= SETTLED_S:
            near = around("crossing", at_s, LAG_S)
            assert near.min() <= LEVELS.index(verdict.level) <= near.max(), f"{at_s:.2f} s: {verdict.because}"


@pytest.mark.parametrize("story", ["crossing", "faults"])
def test_never_safe_while_it_is_imminent(story: str, request: pytest.FixtureRequest) -> None:
    told: Story = request.getfixturevalue(story)
    imminent = true_ranks(story) == LEVELS.index("IMMINENT")
    for at_s, verdict in told.verdicts:
        before = int(at_s / STEP_S)
        if at_s >= SETTLED_S and verdict.level == "SAFE":
            assert not imminent[before : before + 2].all(), f"{at_s:.2f} s: {verdict.because}"


def test_every_sensor_is_online_while_nothing_is_wrong(crossing: Story) -> None:
    for sensor in ("radar", "lidar", "camera", "infra_lidar"):
        assert crossing.states(sensor, SETTLED_S, 99.0) == {"online"}, crossing.reasons(sensor, SETTLED_S, 99.0)


@pytest.mark.parametrize(
    ("sensor", "begin_s", "end_s", "within_s", "state", "reason"),
    [
        ("lidar", 4.0, 9.0, 2.0, "degraded", "no return up to 12 m"),
        ("lidar", 13.0, 18.0, 0.7, "disconnected", "connected but silent"),
        ("camera", 22.0, 27.0, 0.4, "degraded", "dark"),
        ("camera", 31.0, 36.0, 0.4, "disconnected", "unplugged"),
        ("radar", 40.0, 45.0, 0.3, "disconnected", "sends no frame"),
        ("radar", 49.0, 54.0, 0.3, "disconnected", "unplugged"),
        ("lidar", 58.0, 63.0, 2.0, "degraded", "no return up to 12 m"),
        ("camera", 58.0, 63.0, 0.4, "degraded", "dark"),
        ("radar", 67.0, 72.0, 0.3, "disconnected", "sends no frame"),
    ],
)
def test_a_fault_is_told(
    faults: Story, sensor: str, begin_s: float, end_s: float, within_s: float, state: str, reason: str
) -> None:
    """Online before, then the state and the reason in time, until the fault ends; well again within 2.5 s."""
    assert faults.states(sensor, begin_s - 1.0, begin_s) == {"online"}
    assert faults.states(sensor, begin_s + within_s, end_s) == {state}
    assert all(reason in why for why in faults.reasons(sensor, begin_s + within_s, end_s - 0.1))
    assert faults.states(sensor, end_s + FAULT_LAG_S, end_s + FAULT_LAG_S + 0.5) == {"online"}


def test_faults_touch_nobody_else(faults: Story) -> None:
    """While one sensor is out the others stay online."""
    for at_s, health in faults.health:
        wrong = {name for name in ("radar", "lidar", "camera") if health[name].state != "online"}
        if SETTLED_S <= at_s < 58.0:
            assert len(wrong) <= 1, f"{at_s:.2f} s: {wrong}"


def test_faults_follow_the_truth(faults: Story) -> None:
    """As in ``crossing``, with more time after a fault has begun or ended."""
    edges = np.array([edge for fault in SCENARIOS["faults"].faults for edge in (fault.start_s, fault.end_s)])
    for at_s, verdict in faults.verdicts:
        since_s = at_s - edges
        fresh = ((since_s >= 0.0) & (since_s < FAULT_LAG_S)).any()
        if at_s >= SETTLED_S:
            near = around("faults", at_s, FAULT_LAG_S if fresh else LAG_S)
            assert near.min() <= LEVELS.index(verdict.level) <= near.max(), f"{at_s:.2f} s: {verdict.because}"


def test_blind_is_never_safe(faults: Story) -> None:
    """All three out: CAUTION or worse, and the vehicle stops."""
    blind = [verdict for at_s, verdict in faults.verdicts if 69.0 <= at_s < 72.0]
    assert blind
    assert all(v.blind and v.level != "SAFE" and v.permission == "STOP" for v in blind)
