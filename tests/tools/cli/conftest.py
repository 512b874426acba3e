"""A small system that speaks: fusion, lidar and radar in this process, and a recording of it made by hand."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

from common import topics
from common.bus.runtime import Service
from common.codec import encode
from common.config import ServiceConfig, ZenohConfig
from common.messages import (
    CameraDetection,
    CameraDetections,
    LidarZone,
    LidarZones,
    Message,
    ObjectTrack,
    ObjectTracks,
    RadarTrack,
    RadarTracks,
    SensorHealth,
    SystemHealth,
    Verdict,
    VerdictInput,
)
from common.recording.file import RecordingFile

LEVELS = ("SAFE", "CAUTION", "IMMINENT")


def verdict(stamp_ns: int, level: str = "CAUTION") -> Verdict:
    used = VerdictInput(state="online", level=level, age_ms=12.5, used=True, why="", stamp_ns=stamp_ns - 20_000_000)  # type: ignore[arg-type]
    return Verdict(
        stamp_ns=stamp_ns, level=level, rule=f"R-{level}", because=f"lidar {level} at 0.61 m", inputs={"lidar": used},  # type: ignore[arg-type]
        confirmed=True, suppressed=False, advisory=None, blind=False,
        permission={"SAFE": "GO", "CAUTION": "SLOW", "IMMINENT": "STOP"}[level],  # type: ignore[arg-type]
    )  # fmt: skip


def health(stamp_ns: int, lidar: str = "online") -> SystemHealth:
    reason = "" if lidar == "online" else "lens blocked"
    sensor = SensorHealth(state=lidar, reason=reason, since_ns=0, age_ms=9.0, rate_hz=10.0)  # type: ignore[arg-type]
    colour = "green" if lidar == "online" else "amber"
    return SystemHealth(stamp_ns=stamp_ns, sensors={"lidar": sensor}, colour=colour, summary="bar", services={})  # type: ignore[arg-type]


def zones(stamp_ns: int) -> LidarZones:
    free, seen = LidarZone(nearest_m=None, points=0, level="SAFE"), LidarZone(nearest_m=0.61, points=9, level="CAUTION")
    return LidarZones(stamp_ns=stamp_ns, left=free, centre=seen, right=free, level="CAUTION", raw_level="CAUTION")


def radar(stamp_ns: int, range_m: float = 4.2) -> RadarTracks:
    track = RadarTrack(
        track_id=1, range_m=range_m, azimuth_rad=0.1, velocity_mps=-1.5, age_frames=12, approaching=True, moving=True,
        ttc_s=range_m / 1.5, level="CAUTION", snr_db=18.0,
    )  # fmt: skip
    return RadarTracks(
        stamp_ns=stamp_ns, tracks=[track], level="CAUTION", settled=True, noise_floor_db=-60.0, range_max_m=9.6
    )


def objects(stamp_ns: int, x_m: float = 3.0) -> ObjectTracks:
    track = ObjectTrack(
        track_id=7, label="car", label_confidence=0.9, position_m=(x_m, 4.0, 0.7), velocity_mps=(3.0, 4.0, 0.0),
        covariance=[[float(i == j) for j in range(6)] for i in range(6)], size_m=(4.0, 1.8, 1.5), yaw_rad=0.9,
        age_s=2.0, score=0.8, state="confirmed", points=120,
    )  # fmt: skip
    return ObjectTracks(stamp_ns=stamp_ns, tracks=[track], points_in=1000, clusters=3)


def camera(stamp_ns: int) -> CameraDetections:
    found = CameraDetection(
        label="person", confidence=0.8, box_xyxy_px=(10.0, 20.0, 40.0, 90.0), distance_m=2.5, level="SAFE",
        in_zone=True, truncated=False,
    )  # fmt: skip
    return CameraDetections(
        stamp_ns=stamp_ns, detections=[found], brightness=99.0, level="SAFE", image_size_px=(64, 96)
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six seconds: SAFE, CAUTION, IMMINENT, two each; the lidar degraded in the middle."""
    path = tmp_path_factory.mktemp("recording") / "drive.mcap"
    start_ns = 1_700_000_000_000_000_000
    with RecordingFile(path, {"spotter": {"version": "test"}}) as file:

        def add(key: str, message: Message) -> None:
            file.add(key, type(message), encode(message), message.stamp_ns, message.sent_ns, message.seq)

        for tick in range(60):
            at_ns = start_ns + tick * 100_000_000
            add("jetson0/fusion/verdict", verdict(at_ns, LEVELS[tick // 20]))
            add("jetson0/fusion/health", health(at_ns, "degraded" if 20 <= tick < 40 else "online"))
            add("jetson0/lidar/zones", zones(at_ns))
            add("pi0/radar/tracks", radar(at_ns, 9.0 - 0.1 * tick))
            add("infra0/infra_lidar/tracks", objects(at_ns, 3.0 + 0.3 * tick))
            add("jetson0/camera/detections", camera(at_ns))
    return path


@pytest.fixture
def speaking(zenoh_config: ZenohConfig) -> Iterator[str]:
    """The endpoint of a router at which fusion (CAUTION), lidar and radar speak at 50 Hz."""
    stop = threading.Event()
    parts: dict[str, tuple[str, dict[topics.Topic, Callable[[int], Message]]]] = {
        "fusion": ("jetson0", {topics.FUSION_VERDICT: verdict, topics.FUSION_HEALTH: health}),
        "lidar": ("jetson0", {topics.LIDAR_ZONES: zones}),
        "radar": ("pi0", {topics.RADAR_TRACKS: radar}),
    }

    def speak(name: str) -> None:
        host, products = parts[name]
        with Service(name, ServiceConfig(host=host, zenoh=zenoh_config)) as service:
            publish = {topic: service.publisher(topic) for topic in products}
            while not stop.wait(0.02):
                for topic, make in products.items():
                    publish[topic](make(time.time_ns()))

    threads = [threading.Thread(target=speak, args=(name,)) for name in parts]
    for thread in threads:
        thread.start()
    yield zenoh_config.connect[0]
    stop.set()
    for thread in threads:
        thread.join()


@pytest.fixture(scope="session")
def speakers() -> ModuleType:
    """This file: its messages, for tests that need one of each."""
    return sys.modules[__name__]
