"""Sorts what arrives: sensor messages to their watches, statuses and motion kept as the newest, strangers counted."""

from __future__ import annotations

from collections import Counter
from typing import Any

from common.messages import EgoMotion, ServiceStatus
from common.pubsub import Received
from common.topics import CAMERA_DETECTIONS, EGO_MOTION, INFRA_TRACKS, LIDAR_ZONES, RADAR_TRACKS, Topic
from services.jetson.fusion.clocks import ClockWatch, OwnClock
from services.jetson.fusion.config import FusionConfig, SensorConfig
from services.jetson.fusion.health import SensorWatch, Surroundings
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.roster import Roster

SENSOR_TOPICS: dict[str, Topic] = {
    "lidar": LIDAR_ZONES,
    "radar": RADAR_TRACKS,
    "camera": CAMERA_DETECTIONS,
    "infra_lidar": INFRA_TRACKS,
}
ONBOARD = ("lidar", "radar", "camera")
MAX_NAMES = 64  # strangers cannot fill our memory
REFUSED_SHOWN_S = 2.0
UNDECODABLE = "undecodable"


class Inbox:
    """The newest of everything, by sensor name."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        sensors: dict[str, SensorConfig] = {name: getattr(config.sensors, name) for name in SENSOR_TOPICS}
        self.watches = {
            name: SensorWatch(name, sensors[name].host, topic, config.health) for name, topic in SENSOR_TOPICS.items()
        }
        self.clocks = {name: ClockWatch(config.clocks) for name in SENSOR_TOPICS}
        self.roster = Roster()
        self.statuses: dict[str, Received[ServiceStatus]] = {}
        self.ego: Received[EgoMotion] | None = None
        self.bad_input: Counter[str] = Counter()  # since the start, by key and reason
        self.new_bad_input: Counter[str] = Counter()  # what somebody still has to be told
        self._by_key = {topic.key(sensors[name].host): name for name, topic in SENSOR_TOPICS.items()}
        self._by_service = {f"{watch.host}/{watch.service}": name for name, watch in self.watches.items()}
        self._refused: dict[str, tuple[str, float]] = {}
        self._own_clock = OwnClock(config.clocks)
        self._own_step: tuple[str, float] = ("", 0.0)

    def own_clock_doubt(self, now_s: float) -> str:
        """Why no stamp can be dated now; empty when our own clock has stood still for long enough."""
        text, stepped_s = self._own_step
        settle_s = self._config.clocks.settle_samples * self._config.clocks.period_s
        return text if text and now_s - stepped_s < settle_s else ""

    def sort(self, seen: Observation) -> dict[str, Surroundings]:
        """Take everything in; returns what is known about each sensor besides its data."""
        self._check_own_clock(seen)
        self.roster.update(seen.present)
        for sample in seen.clock_samples:
            if sample.name in self._by_service:
                self.clocks[self._by_service[sample.name]].add(sample)
        for key, why in seen.refused.items():
            self._refuse(key, why, seen.now_s)
        for received in seen.received:
            if isinstance(received.message, ServiceStatus):
                self._take_status(received)
        around = {name: self._surroundings(name, seen) for name in self.watches}
        for received in seen.received:
            self._take(received, around)
        return around

    def _check_own_clock(self, seen: Observation) -> None:
        step_s = self._own_clock.step(seen.now_s, seen.now_ns)
        if step_s:
            self._own_step = (f"our own clock stepped by {step_s:+.3f} s, measuring the others again", seen.now_s)
            for clock in self.clocks.values():
                clock.forget()

    def _take(self, received: Received[Any], around: dict[str, Surroundings]) -> None:
        name = self._by_key.get(received.key)
        if name is not None:
            what = self.watches[name].take(received, around[name])
            if what:
                self._count(f"{received.key}: {what}")
        elif received.key == EGO_MOTION.key(self._config.ego_host):
            self.ego = received
        elif not isinstance(received.message, ServiceStatus):
            self._count(f"{received.key}: from an unexpected host")

    def _take_status(self, received: Received[ServiceStatus]) -> None:
        name = received.key.removesuffix("/status")
        if name in self.statuses or name in self._by_service or len(self.statuses) < MAX_NAMES:
            self.statuses[name] = received

    def _refuse(self, key: str, why: str, now_s: float) -> None:
        self._count(f"{key}: {UNDECODABLE}")
        if key in self._by_key:
            self._refused[self._by_key[key]] = (why, now_s)

    def _count(self, what: str) -> None:
        if what not in self.bad_input and len(self.bad_input) >= MAX_NAMES:
            what = "from further strangers"
        self.bad_input[what] += 1
        if not what.endswith(UNDECODABLE):
            self.new_bad_input[what] += 1

    def _surroundings(self, name: str, seen: Observation) -> Surroundings:
        watch, clock = self.watches[name], self.clocks[name]
        full_name = f"{watch.host}/{watch.service}"
        instances = self.roster.services.get(full_name, ())
        if not instances:
            clock.forget()  # whoever comes next has a clock of its own
        best, undatable = clock.estimate(seen.now_s), bool(self.own_clock_doubt(seen.now_s))
        why, refused_s = self._refused.get(name, ("", seen.now_s))
        return Surroundings(
            instances=instances,
            handing_over=full_name in self.roster.handing_over,
            host_alive=watch.host in self.roster.hosts,
            isolated=seen.isolated,
            status=self.statuses.get(full_name),
            clock_distrust=clock.distrust(seen.now_s),
            clock_offset_s=best.offset_s if best else None if undatable else 0.0,
            undecodable=f"undecodable: {why}" if why and seen.now_s - refused_s < REFUSED_SHOWN_S else "",
        )
