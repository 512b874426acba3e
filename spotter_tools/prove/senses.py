"""The vehicle's sensors in simulated time: device physics, then the services' own parsers and pipelines.

Lidar: the LD06's bytes. Radar: raw chirps. Camera: a drawn picture for the health of the view, and the boxes of a
simulated detector (``detector``). Odometry with its errors. Each gives its messages with the moment of their arrival.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from common.bus.ego import motion_of
from common.bus.status import Report
from common.messages import EgoMotion, Message, Motion
from common.topics import CAMERA_DETECTIONS, EGO_MOTION, LIDAR_ZONES, RADAR_MOTION, RADAR_TRACKS
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.pipeline import LidarPipeline
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.pipeline import RadarPipeline
from spotter_sim import bgt60, camera, ld06, odometry
from spotter_sim.model import DeviceUnplugged, Scenario
from spotter_tools.prove.configs import Configs
from spotter_tools.prove.detector import SimulatedDetector

START_NS = 1_800_000_000_000_000_000
PICTURE_PX = (320, 240)


class Arrival(NamedTuple):
    """A message on its way to fusion."""

    at_s: float
    key: str
    message: Message


@dataclass(frozen=True)
class Delays:
    """From the end of a measurement to fusion: transfer, computing, network; assumed, within the services' budgets."""

    lidar_s: float = 0.015
    radar_s: float = 0.035
    camera_s: float = 0.090  # exposure, transfer, network
    ego_s: float = 0.010


def utc_ns(t_s: float) -> int:
    """The UTC of a moment of the scenario."""
    return START_NS + round(t_s * 1e9)


class Senses:
    """``periods`` names the sensors and how often each is asked; ``measure`` gives what one of them says."""

    def __init__(self, scenario: Scenario, configs: Configs, *, ego: bool) -> None:
        self._scenario, self._configs, self._delays = scenario, configs, Delays()
        self._decoder, self._lidar = ScanDecoder(configs.lidar, Report("prove")), LidarPipeline(configs.lidar)
        self._radar, self._waveform = RadarPipeline(configs.radar), simulator_waveform(configs.radar.waveform)
        self._detector = SimulatedDetector()
        self._camera = CameraPipeline(configs.camera, self._detector)
        self._ego = ego
        self._motion_now: Motion | None = None  # the last one reported; None = unknown
        self._lidar_until_s = 0.0
        self._seq: dict[str, int] = {}

    @property
    def periods(self) -> dict[str, float]:
        """Seconds between two questions, by sensor."""
        block_s = 10 * ld06.POINTS / ld06.SAMPLE_HZ  # the LD06's bytes come in blocks of ten packets
        periods = {"lidar": block_s, "radar": self._configs.radar.waveform.frame_period_s, "camera": 1.0 / 15.0}
        return {**periods, "ego": 0.05} if self._ego else periods

    def measure(self, sensor: str, now_s: float) -> Iterator[Arrival]:
        """What ``sensor`` has measured by ``now_s``; nothing while it is unplugged."""
        try:
            yield from {"lidar": self._scan, "radar": self._frame, "camera": self._picture, "ego": self._motion}[
                sensor
            ](now_s)
        except (DeviceUnplugged, TimeoutError):
            return

    def _scan(self, now_s: float) -> Iterator[Arrival]:
        data = ld06.packets(self._scenario, self._lidar_until_s, now_s)
        self._lidar_until_s = now_s
        for scan in self._decoder.feed(utc_ns(now_s), now_s, data):
            zones = self._lidar.process(scan.stamp_ns, scan, self._motion_now)
            yield self._arrival(now_s + self._delays.lidar_s, LIDAR_ZONES.key(self._configs.lidar.host), zones)

    def _frame(self, now_s: float) -> Iterator[Arrival]:
        length_s = self._waveform.chirps * self._waveform.chirp_period_s
        begin_s = now_s - length_s
        if begin_s < 0.0:
            return
        frame = bgt60.frame(self._scenario, begin_s, self._waveform)
        tracks = self._radar.process(utc_ns(begin_s), frame, self._motion_now)
        host, at_s = self._configs.radar.host, now_s + self._delays.radar_s
        yield self._arrival(at_s, RADAR_TRACKS.key(host), tracks)
        yield self._arrival(at_s, RADAR_MOTION.key(host), self._radar.motion())

    def _picture(self, now_s: float) -> Iterator[Arrival]:
        width, height = PICTURE_PX
        image = camera.image(self._scenario, now_s, width, height)
        self._detector.look(self._scenario.at(now_s), camera.boxes(self._scenario, now_s, width, height), height)
        seen = self._camera.process(utc_ns(now_s), image, self._motion_now)
        yield self._arrival(now_s + self._delays.camera_s, CAMERA_DETECTIONS.key(self._configs.camera.host), seen)

    def _motion(self, now_s: float) -> Iterator[Arrival]:
        measured = odometry.measure(self._scenario.at(now_s))
        message = EgoMotion(
            stamp_ns=utc_ns(now_s),
            speed_mps=measured.speed_mps,
            yaw_rate_radps=measured.yaw_rate_radps,
            speed_sigma_mps=measured.speed_sigma_mps,
            yaw_rate_sigma_radps=measured.yaw_rate_sigma_radps,
        )
        self._motion_now = motion_of(message, self._configs.radar.path)
        yield self._arrival(now_s + self._delays.ego_s, EGO_MOTION.key(self._configs.fusion.ego_host), message)

    def _arrival(self, at_s: float, key: str, message: Message) -> Arrival:
        message.seq = self._seq.get(key, 0)
        self._seq[key] = message.seq + 1
        message.sent_ns = utc_ns(at_s)
        message.source_kind = "simulated"
        return Arrival(at_s, key, message)
