"""Health for people: the bar, every sensor and service, the clocks, and in notes whatever else explains the verdict."""

from __future__ import annotations

from common.messages import SensorHealth, ServiceHealth, ServiceState, SystemHealth
from services.jetson.fusion.bar import bar
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.health import STATUS_AGE_LIMIT_S
from services.jetson.fusion.inbox import MAX_NAMES, ONBOARD, Inbox
from services.jetson.fusion.latency import LatencyBook
from services.jetson.fusion.observation import Observation

ISOLATED = "I AM ISOLATED: fusion has lost its own link, the sensors may be well"
NOTABLE_OFFSET_MS = 100.0
MAX_NOTES = 20


class Reporter:
    """``report`` gives the message when something has changed, and otherwise at the health period."""

    def __init__(self, config: FusionConfig, inbox: Inbox, latency: LatencyBook) -> None:
        self._config, self._inbox, self._latency = config, inbox, latency
        self._services: dict[str, ServiceHealth] = {}
        self._told: object = None
        self._told_s = float("-inf")

    def report(self, seen: Observation, sensors: dict[str, SensorHealth]) -> SystemHealth | None:
        """SystemHealth when something has changed or its period is over, else None."""
        services = self._judge_services(seen)
        news = (
            seen.isolated,
            self._inbox.own_clock_doubt(seen.now_s),
            {name: (sensor.state, sensor.cause) for name, sensor in sensors.items()},
            {name: (service.state, service.instances) for name, service in services.items()},
        )
        if news == self._told and seen.now_s - self._told_s < self._config.health.health_period_s:
            return None
        self._told, self._told_s = news, seen.now_s
        return self._compose(seen, sensors, services)

    def _compose(
        self, seen: Observation, sensors: dict[str, SensorHealth], services: dict[str, ServiceHealth]
    ) -> SystemHealth:
        colour, summary = bar({name: sensors[name].state for name in ONBOARD})
        if seen.isolated:
            colour, summary = "red", ISOLATED
        doubt = self._inbox.own_clock_doubt(seen.now_s)
        if doubt and colour == "green":
            colour, summary = "amber", "CLOCK NOT TRUSTED: the age of data is uncertain"
        late = self._latency.over_budget()
        for name, text in late.items():
            if sensors[name].state == "online":
                sensors[name].reason = text
        clocks = {
            f"{watch.host}/{watch.service}": told
            for name, watch in self._inbox.watches.items()
            if (told := self._inbox.clocks[name].health(seen.now_s)) is not None
        }
        notes = [
            *([doubt] if doubt else []),
            *self._waiting(),
            *self._far_away(),
            *(f"{name} {text}" for name, text in late.items()),
        ]
        notes += [f"{n}: {s.instances} processes claim this name" for n, s in services.items() if s.instances > 1]
        notes += [
            f"clock of {name} is {clock.offset_ms / 1e3:+.3f} s from ours; ages are corrected for it"
            for name, clock in clocks.items()
            if abs(clock.offset_ms) > NOTABLE_OFFSET_MS
        ]
        notes += [f"{what}: {count}" for what, count in self._inbox.bad_input.most_common(MAX_NOTES)]
        return SystemHealth(
            stamp_ns=seen.now_ns,
            sensors=sensors,
            colour=colour,
            summary=summary,
            services=services,
            clocks=clocks,
            notes=notes[:MAX_NOTES],
        )

    def _waiting(self) -> list[str]:
        missing = [f"{w.host}/{w.service}" for w in self._inbox.watches.values() if not w.reported]
        return [f"starting, waiting for {', '.join(missing)}"] if missing else []

    def _far_away(self) -> list[str]:
        """When every other host is gone at once, the first suspect is our own uplink."""
        others = {watch.host for watch in self._inbox.watches.values()} - {self._config.host}
        seen_before = {w.host for w in self._inbox.watches.values() if w.reported and w.host in others}
        if len(others) < 2 or seen_before != others or others & self._inbox.roster.hosts:
            return []
        return ["no other host is reachable: look at this host's own network first"]

    def _judge_services(self, seen: Observation) -> dict[str, ServiceHealth]:
        instances = self._inbox.roster.services
        expected = {f"{watch.host}/{watch.service}" for watch in self._inbox.watches.values()}
        known = expected | set(self._services) | set(instances)
        names = expected | set(sorted(known - expected)[:MAX_NAMES])
        self._services = {name: self._judge_service(name, len(instances.get(name, ())), seen) for name in sorted(names)}
        return self._services

    def _judge_service(self, name: str, instances: int, seen: Observation) -> ServiceHealth:
        status, last = self._inbox.statuses.get(name), self._services.get(name)
        state: ServiceState = "starting"
        reason = "no status yet"
        if instances == 0:
            state, reason = "disconnected", "no process"
        elif status is not None and seen.now_s - status.arrived_s <= STATUS_AGE_LIMIT_S:
            state, reason = status.message.state, status.message.reason
        since_ns = last.since_ns if last is not None and last.state == state else seen.now_ns
        return ServiceHealth(alive=instances > 0, instances=instances, state=state, reason=reason, since_ns=since_ns)
