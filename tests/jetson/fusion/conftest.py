"""Builders of sensor messages and inputs that the fusion tests share."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from common.bus.pubsub import Received
from common.geometry import pose_2d
from common.messages import (
    CameraDetection,
    CameraDetections,
    EgoMotion,
    LidarZone,
    LidarZones,
    LinkFault,
    ObjectTrack,
    ObjectTracks,
    RadarTrack,
    RadarTracks,
    SensorHealth,
    ServiceStatus,
    SystemHealth,
    Verdict,
)
from common.topics import SENSOR_TOPICS
from services.jetson.fusion.clocks import ClockSample
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.fusion.store import Saved


def lidar(stamp_ns: int, level: Any = "SAFE", nearest_m: float | None = None, **more: Any) -> LidarZones:
    clear = LidarZone(nearest_m=None, points=0, level="SAFE")
    centre = LidarZone(nearest_m=nearest_m, points=9, level=level)
    return LidarZones(
        stamp_ns=stamp_ns, left=clear, centre=centre, right=clear, level=level, raw_level=level, **more
    )  # fmt: skip


def radar(stamp_ns: int, level: Any = "SAFE", **more: Any) -> RadarTracks:
    track = RadarTrack(
        track_id=7, range_m=1.0, azimuth_rad=0.1, velocity_mps=-0.8, age_frames=9, approaching=True, moving=True,
        ttc_s=1.25, level=level, snr_db=21.0,
    )  # fmt: skip
    defaults = {"settled": True, "noise_floor_db": -60.0, "tracks": [] if level == "SAFE" else [track]}
    return RadarTracks(stamp_ns=stamp_ns, level=level, **(defaults | more))


def camera(stamp_ns: int, level: Any = None, **more: Any) -> CameraDetections:
    box = CameraDetection(
        label="person", confidence=0.9, box_xyxy_px=(300, 100, 340, 400), distance_m=1.1, level=level or "SAFE",
        in_zone=True, truncated=False,
    )  # fmt: skip
    defaults = {"brightness": 100.0, "image_size_px": (640, 480), "detections": [] if level is None else [box]}
    return CameraDetections(stamp_ns=stamp_ns, level=level, **(defaults | more))


def infra(stamp_ns: int, **more: Any) -> ObjectTracks:
    return ObjectTracks(stamp_ns=stamp_ns, tracks=more.pop("tracks", []), **more)


def car(x_m: float = 3.0) -> ObjectTrack:
    """A roadside track so far ahead that comes at us with 4 m/s."""
    return ObjectTrack(
        track_id=3, label="car", label_confidence=0.9, position_m=(x_m, 0.0, 0.8), velocity_mps=(-4.0, 0.0, 0.0),
        covariance=np.diag([0.01] * 6).tolist(), size_m=(1.0, 1.0, 1.5), yaw_rad=0.0, age_s=2.0, score=1.0,
        state="confirmed", points=99,
    )  # fmt: skip


@pytest.fixture(scope="session")
def messages() -> SimpleNamespace:
    """``messages.lidar(stamp_ns, level)`` and so on: valid messages with one object behind the level."""
    return SimpleNamespace(lidar=lidar, radar=radar, camera=camera, infra=infra, car=car)


@pytest.fixture(scope="session")
def build_message() -> dict[str, Callable[..., Any]]:
    """The same builders by sensor name."""
    return BUILDERS


# One builder per sensor of the topics table: (stamp_ns, level, **fields), the roadside's without a level.
BUILDERS: dict[str, Callable[..., Any]] = {"lidar": lidar, "radar": radar, "camera": camera, "infra_lidar": infra}
HOSTS: dict[str, str] = {name: getattr(FusionConfig().sensors, name).host for name in SENSOR_TOPICS}
START_NS = 1_800_000_000_000_000_000
TICK_S = 0.05


class Bench:
    """Fusion's pipeline in simulated time: every sensor is a process that publishes at 10 Hz until it is disturbed."""

    def __init__(self, config: FusionConfig | None = None, sensors: tuple[str, ...] = tuple(HOSTS)) -> None:
        self.config = config or FusionConfig()
        self.pipeline = FusionPipeline(self.config)
        self.now_s = 1000.0
        self.levels: dict[str, Any] = {**dict.fromkeys(HOSTS, "SAFE"), "camera": None}
        self.extra: dict[str, dict[str, Any]] = {name: {} for name in HOSTS}
        self.delay_s = dict.fromkeys(HOSTS, 0.02)
        self.clock_s = dict.fromkeys(HOSTS, 0.0)  # their clock minus ours
        self.silent: set[str] = set()
        self.instances = {(HOSTS[name], name, name) for name in sensors}
        self.seq = dict.fromkeys(HOSTS, 0)
        self.isolated = False
        self.our_clock_s = 0.0
        self.answers_clock = True
        self.clock_bound_s = 0.001  # half the round trip of a clock measurement
        self.pending: list[Received[Any]] = []
        self.verdicts: list[Verdict] = []
        self.verdict: Verdict | None = None
        self.health: SystemHealth | None = None
        self.refused: dict[str, str] = {}
        self.link_faults: dict[str, LinkFault] = {}
        self.acknowledged = False
        self.delivered_s = dict.fromkeys(HOSTS, self.now_s)  # when each last sent a message in good time

    @property
    def now_ns(self) -> int:
        return START_NS + round((self.now_s + self.our_clock_s) * 1e9)

    def key(self, name: str) -> str:
        return SENSOR_TOPICS[name].key(HOSTS[name])

    def restart_fusion(self, gap_s: float = 0.5) -> None:
        """Fusion is killed and started again; what it had written goes through the file's format."""
        saved = self.pipeline.state(Observation(now_s=self.now_s, now_ns=self.now_ns))
        self.pipeline = FusionPipeline(self.config, msgspec.json.decode(msgspec.json.encode(saved), type=Saved))
        self.now_s = round(self.now_s + gap_s, 6)

    def acknowledge(self) -> Verdict:
        """A person says that what nobody sees is gone."""
        self.acknowledged = True
        return self.tick()

    def kill(self, name: str) -> None:
        self.instances = {one for one in self.instances if one[1] != name}

    def start(self, name: str, instance: str = "again") -> None:
        self.instances |= {(HOSTS[name], name, instance)}
        self.seq[name] = 0

    def message(self, name: str) -> Any:
        """What the sensor would publish now; its stamp is on its own clock."""
        measured_ns = START_NS + round((self.now_s - self.delay_s[name] + self.clock_s[name]) * 1e9)
        level = [] if name == "infra_lidar" else [self.levels[name]]
        message = BUILDERS[name](measured_ns, *level, **self.extra[name])
        message.received_ns = message.sent_ns = measured_ns
        message.seq = self.seq[name]
        self.seq[name] += 1
        return message

    def receive(self, key: str, message: Any) -> None:
        self.pending.append(Received(key, message, self.now_s, self.now_ns))

    def status(self, name: str, state: Any, reason: str = "") -> None:
        status = ServiceStatus(
            stamp_ns=self.now_ns, state=state, reason=reason, published=0, dropped=0, bad_input=0, rate_hz=0.0,
            last_frame_age_s=None, stage_ms={}, rss_mb=1.0,
        )  # fmt: skip
        self.receive(f"{HOSTS[name]}/{name}/status", status)

    def tick(self) -> Verdict:
        """One step of 50 ms; every second one brings a message of every sensor that lives and is not silent."""
        self.now_s = round(self.now_s + TICK_S, 6)
        step = round(self.now_s / TICK_S)
        alive = {service for _, service, _ in self.instances}
        for name in HOSTS:
            if step % 2 == 0 and name in alive and name not in self.silent:
                self.receive(self.key(name), self.message(name))
                if self.delay_s[name] < 0.5:
                    self.delivered_s[name] = self.now_s
        samples = []
        if step % 10 == 0 and self.answers_clock:
            samples = [
                ClockSample(f"{HOSTS[n]}/{n}", self.now_s, self.clock_s[n] - self.our_clock_s, self.clock_bound_s)
                for n in HOSTS
                if n in alive
            ]
        seen = Observation(
            now_s=self.now_s,
            now_ns=self.now_ns,
            received=tuple(self.pending),
            present=frozenset(self.instances),
            isolated=self.isolated,
            clock_samples=tuple(samples),
            refused=self.refused,
            link_faults=self.link_faults,
            acknowledged=self.acknowledged,
        )
        self.pending, self.refused, self.acknowledged = [], {}, False
        self.verdict, health = self.pipeline.process(seen)
        self.verdicts.append(self.verdict)
        self.health = health or self.health
        return self.verdict

    def run(self, seconds: float) -> Verdict:
        verdict = self.tick()
        for _ in range(round(seconds / TICK_S) - 1):
            verdict = self.tick()
        return verdict

    def outcomes(self, seconds: float) -> set[tuple[str, str]]:
        """Levels and permissions of all that is said in this time."""
        before = len(self.verdicts)
        self.run(seconds)
        return {(verdict.level, verdict.permission) for verdict in self.verdicts[before:]}

    def drive(self, speed_mps: float, yaw_rate_radps: float, seconds: float) -> None:
        """The vehicle's motion is known, and this."""
        pose = pose_2d(0.0, 0.0, 0.0).tolist()
        for _ in range(round(seconds / TICK_S)):
            motion = EgoMotion(
                stamp_ns=self.now_ns, speed_mps=speed_mps, yaw_rate_radps=yaw_rate_radps, T_map_vehicle=pose
            )
            self.receive("jetson0/ego/motion", motion)
            self.tick()

    def until(self, condition: Callable[[], object], limit_s: float) -> float:
        """Seconds of simulated time until the condition holds; fails after the limit."""
        start_s = self.now_s
        while not condition():
            assert self.now_s - start_s < limit_s + TICK_S / 2, f"not within {limit_s} s: {self.health} {self.verdict}"
            self.tick()
        return self.now_s - start_s

    def is_dead(self, name: str) -> bool:
        """No process, no link, or nothing sent in good time for longer than the topic's limit."""
        alive = any(service == name for _, service, _ in self.instances)
        limit_s = SENSOR_TOPICS[name].age_limit_s
        return self.isolated or not alive or self.now_s - self.delivered_s[name] > limit_s

    def sensor(self, name: str) -> SensorHealth:
        assert self.health is not None
        return self.health.sensors[name]

    def is_in(self, name: str, state: str, cause: str | None = None) -> bool:
        sensor = self.sensor(name)
        return sensor.state == state and cause in (None, sensor.cause)


@pytest.fixture
def bench() -> Bench:
    """A bench on which all sensors have come online."""
    one = Bench()
    one.run(1.0)
    assert one.health is not None
    assert one.health.colour == "green"
    return one


@pytest.fixture(scope="session")
def new_bench() -> type[Bench]:
    return Bench
