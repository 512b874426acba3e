"""A stand-in for fusion: it publishes the verdict and the health that a test of the page asks for."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field

from common import topics
from common.bus.runtime import Service
from common.config import ServiceConfig, ZenohConfig
from common.messages import ClockHealth, SensorHealth, SystemHealth, Verdict, VerdictInput


@dataclass
class Fusion:
    """A fusion that says what the test wants, at 20 Hz, until it is told to be silent."""

    zenoh: ZenohConfig
    level: str = "SAFE"
    colour: str = "green"
    summary: str = "ALL VEHICLE SENSORS ONLINE"
    sensor_state: str = "online"
    silent: bool = False
    tells_health: bool = True
    blind: bool = False
    because: str = "LiDAR CAUTION at 0.61 m"
    source_kind: str = "live"
    stop: threading.Event = field(default_factory=threading.Event)

    def live(self) -> None:
        with Service("fusion", ServiceConfig(host="jetson0", zenoh=self.zenoh)) as service:
            put_verdict = service.publisher(topics.FUSION_VERDICT)
            put_health = service.publisher(topics.FUSION_HEALTH)
            while not self.stop.wait(0.05):
                if not self.silent:
                    put_verdict(self.verdict())
                    if self.tells_health:
                        put_health(self.health())

    def verdict(self) -> Verdict:
        contribution = VerdictInput(
            state="online", level=self.level, age_ms=40.0, used=True, why="its band counts",  # type: ignore[arg-type]
            stage_ms={"capture": 1.0, "processing": 2.0, "transport": 0.5, "fusion": 0.1},
        )  # fmt: skip
        permission = {"SAFE": "GO", "CAUTION": "SLOW", "IMMINENT": "STOP"}[self.level]
        return Verdict(
            stamp_ns=time.time_ns(), level=self.level, rule="R1-worst-case", because=self.because,  # type: ignore[arg-type]
            inputs={"lidar": contribution}, confirmed=False, suppressed=False, advisory=None, blind=self.blind,
            permission=permission, to_lower="the centre lane clear for 4 scans",  # type: ignore[arg-type]
            source_kind=self.source_kind,  # type: ignore[arg-type]
        )  # fmt: skip

    def health(self) -> SystemHealth:
        sensor = SensorHealth(
            state=self.sensor_state, reason="" if self.sensor_state == "online" else "lens blocked: 40 scans",  # type: ignore[arg-type]
            since_ns=time.time_ns(), age_ms=40.0, rate_hz=10.0, source_kind=self.source_kind,  # type: ignore[arg-type]
        )  # fmt: skip
        clock = ClockHealth(offset_ms=-10.25, bound_ms=1.42, age_s=1.0, trusted=True)
        clocks = {"pi0/radar": clock, "infra0/infra_lidar": clock}
        roadside = SensorHealth(
            state="disconnected", reason="stale", since_ns=time.time_ns(), age_ms=None, rate_hz=0.0,
            source_kind="simulated",
        )  # fmt: skip
        return SystemHealth(
            stamp_ns=time.time_ns(),
            sensors={"lidar": sensor, "radar": sensor, "camera": sensor, "infra_lidar": roadside},
            colour=self.colour, summary=self.summary, services={}, clocks=clocks,  # type: ignore[arg-type]
        )  # fmt: skip
