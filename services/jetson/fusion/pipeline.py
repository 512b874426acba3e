"""Observations in, verdict and health out. No network, no clock: the time is part of the observation."""

from __future__ import annotations

from collections import Counter

from common.messages import EgoMotion, ServiceHealth, ServiceState, ServiceStatus, SystemHealth, Verdict
from common.presence import Instance
from common.pubsub import Received
from common.topics import CAMERA_DETECTIONS, EGO_MOTION, INFRA_TRACKS, LIDAR_ZONES, RADAR_TRACKS, Topic
from services.jetson.fusion.bar import bar
from services.jetson.fusion.clocks import ClockWatch, OwnClock
from services.jetson.fusion.config import FusionConfig, SensorConfig
from services.jetson.fusion.evidence import FusionInputs, FusionMemory, SensorInput
from services.jetson.fusion.health import STATUS_AGE_LIMIT_S, SensorWatch, Surroundings
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.verdict import fuse

SENSOR_TOPICS: dict[str, Topic] = {
    "lidar": LIDAR_ZONES,
    "radar": RADAR_TRACKS,
    "camera": CAMERA_DETECTIONS,
    "infra_lidar": INFRA_TRACKS,
}
ONBOARD = ("lidar", "radar", "camera")
MAX_SERVICES = 64  # of those that were not expected, so that strangers cannot fill our memory


class FusionPipeline:
    """``process`` every observation: on every input and at least at the verdict's period."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        sensors: dict[str, SensorConfig] = {name: getattr(config.sensors, name) for name in SENSOR_TOPICS}
        self.watches = {
            name: SensorWatch(name, sensors[name].host, topic, config.health) for name, topic in SENSOR_TOPICS.items()
        }
        self._by_key = {topic.key(sensors[name].host): name for name, topic in SENSOR_TOPICS.items()}
        self._clocks = {name: ClockWatch(config.clocks) for name in SENSOR_TOPICS}
        self._own_clock = OwnClock(config.clocks)
        self._statuses: dict[str, Received[ServiceStatus]] = {}
        self._services: dict[str, ServiceHealth] = {}
        self._ego: Received[EgoMotion] | None = None
        self._memory = FusionMemory()
        self._told: object = None
        self._told_s = -1e9
        self.rejected: Counter[str] = Counter()

    def process(self, seen: Observation) -> tuple[Verdict, SystemHealth | None]:
        """The verdict now, and health when it has changed or is due."""
        # 1. whose clock can be trusted, and how far is it from ours
        self._update_clocks(seen)
        # 2. sort what arrived by who sent it
        around = self._surroundings(seen)
        self._sort(seen, around)
        # 3. the state of every sensor
        around = self._surroundings(seen)
        judged = {name: watch.judge(seen.now_s, seen.now_ns, around[name]) for name, watch in self.watches.items()}
        sensors = {name: sensor for name, (sensor, _) in judged.items()}
        # 4. the verdict
        verdict, self._memory = fuse(self._inputs(seen, sensors), self._memory, self._config.rules)
        # 5. health for people
        health = SystemHealth(
            stamp_ns=seen.now_ns,
            sensors={name: told for name, (_, told) in judged.items()},
            colour="green",
            summary="",
            services=self._judge_services(seen),
        )
        return verdict, self._when_due(seen, health)

    def _update_clocks(self, seen: Observation) -> None:
        stepped_s = self._own_clock.step(seen.now_s, seen.now_ns)
        if stepped_s:
            for clock in self._clocks.values():
                clock.restart(f"our own clock stepped by {stepped_s:+.3f} s")
        for sample in seen.clock_samples:
            if sample.name in self._clocks:
                self._clocks[sample.name].add(sample)

    def _surroundings(self, seen: Observation) -> dict[str, Surroundings]:
        hosts = {host for host, _, _ in seen.present}
        around = {}
        for name, watch in self.watches.items():
            instances = sum((host, service) == (watch.host, watch.service) for host, service, _ in seen.present)
            best = self._clocks[name].estimate(seen.now_s)
            around[name] = Surroundings(
                instances=instances,
                host_alive=watch.host in hosts,
                isolated=seen.isolated,
                status=self._statuses.get(f"{watch.host}/{watch.service}"),
                clock_distrust=self._clocks[name].distrust(seen.now_s),
                clock_offset_s=best.offset_s if best else 0.0,
                undecodable=seen.undecodable.get(SENSOR_TOPICS[name].name, ""),
            )
        return around

    def _sort(self, seen: Observation, around: dict[str, Surroundings]) -> None:
        for received in seen.received:
            message = received.message
            name = self._by_key.get(received.key)
            if name is not None:
                self.watches[name].take(received, around[name])
            elif received.key == EGO_MOTION.key(self._config.ego_host):
                self._ego = received
            elif isinstance(message, ServiceStatus):
                self._take_status(received)
            else:
                self.rejected["from an unexpected host"] += 1

    def _take_status(self, received: Received[ServiceStatus]) -> None:
        name = received.key.removesuffix("/status")
        if name in self._statuses or len(self._statuses) < MAX_SERVICES:
            self._statuses[name] = received

    def _moving(self, now_s: float) -> bool | None:
        """Whether the vehicle moves; None when nobody tells, or not lately."""
        limit_s = EGO_MOTION.age_limit_s or 0.5
        if self._ego is None or now_s - self._ego.arrived_s > limit_s or self._ego.message.speed_mps is None:
            return None
        return abs(self._ego.message.speed_mps) >= self._config.moving_mps

    def _inputs(self, seen: Observation, sensors: dict[str, SensorInput]) -> FusionInputs:
        return FusionInputs(
            now_s=seen.now_s,
            moving=self._moving(seen.now_s),
            lidar=sensors["lidar"],
            radar=sensors["radar"],
            camera=sensors["camera"],
            starting=tuple(n for n in ONBOARD if not self.watches[n].reported),
            stamp_ns=seen.now_ns,
        )

    def _judge_services(self, seen: Observation) -> dict[str, ServiceHealth]:
        expected = {f"{watch.host}/{watch.service}" for watch in self.watches.values()}
        instances = Counter(f"{host}/{service}" for host, service, _ in seen.present)
        names = expected | set(list(instances)[:MAX_SERVICES])
        return {name: self._judge_service(name, instances[name], seen) for name in sorted(names)}

    def _judge_service(self, name: str, instances: int, seen: Observation) -> ServiceHealth:
        status = self._statuses.get(name)
        last = self._services.get(name)
        state: ServiceState
        if instances == 0:
            state, reason = "disconnected", "no process"
        elif status is None or seen.now_s - status.arrived_s > STATUS_AGE_LIMIT_S:
            state, reason = "starting", "no status yet"
        else:
            state, reason = status.message.state, status.message.reason
        since_ns = last.since_ns if last is not None and last.state == state else seen.now_ns
        self._services[name] = ServiceHealth(
            alive=instances > 0, instances=instances, state=state, reason=reason, since_ns=since_ns
        )
        return self._services[name]

    def _when_due(self, seen: Observation, health: SystemHealth) -> SystemHealth | None:
        colour, summary = bar({name: health.sensors[name].state for name in ONBOARD})
        health.colour, health.summary = colour, summary
        states = {name: (told.state, told.cause) for name, told in health.sensors.items()}
        told = (states, summary, {name: (s.state, s.instances) for name, s in health.services.items()})
        if told == self._told and seen.now_s - self._told_s < self._config.health.health_period_s:
            return None
        self._told, self._told_s = told, seen.now_s
        return health


__all__ = ["FusionPipeline", "Instance"]
