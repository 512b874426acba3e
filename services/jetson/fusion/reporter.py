"""Health for people: the bar, every sensor and service, the clocks, and in notes whatever else explains the verdict."""

from __future__ import annotations

from common.bus.status import ENDED
from common.clock import WRONG_CLOCK_S, clock_words
from common.messages import SensorHealth, ServiceHealth, ServiceState, SystemHealth, least_live
from common.topics import ONBOARD_SENSORS, spoken
from services.jetson.fusion.bar import bar
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.inbox import MAX_NAMES, Inbox
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
        self._reported: object = None
        self._reported_s = float("-inf")

    def report(self, seen: Observation, sensors: dict[str, SensorHealth]) -> SystemHealth | None:
        """SystemHealth when something has changed or its period is over, else None."""
        services = self._judge_services(seen)
        news = (
            seen.isolated,
            self._inbox.own_clock_doubt(seen.now_s),
            {name: (sensor.state, sensor.cause, sensor.source_kind) for name, sensor in sensors.items()},
            {name: (service.state, service.instances) for name, service in services.items()},
        )
        if news == self._reported and seen.now_s - self._reported_s < self._config.health.health_period_s:
            return None
        self._reported, self._reported_s = news, seen.now_s
        return self._compose(seen, sensors, services)

    def _compose(
        self, seen: Observation, sensors: dict[str, SensorHealth], services: dict[str, ServiceHealth]
    ) -> SystemHealth:
        onboard = {name: sensors[name].state for name in ONBOARD_SENSORS if name in sensors}
        beside_the_road = {name: sensors[name].state for name in sensors if name not in onboard}
        colour, summary = bar(onboard, beside_the_road if self._config.roadside.enabled else None)
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
            f"{watch.host}/{watch.service}": clock
            for name, watch in self._inbox.watches.items()
            if (clock := self._inbox.clocks[name].health(seen.now_s)) is not None
        }
        notes = [
            *([doubt] if doubt else []),
            *([self._inbox.own_speed.note] if self._inbox.own_speed.note else []),
            *self._waiting(),
            *self._far_away(),
            *(f"{spoken(name)} {text}" for name, text in late.items()),
        ]
        notes += [f"{n}: {services[n].reason}, the site has it" for n in self._config.expects if not services[n].alive]
        notes += [f"{n}: {s.instances} processes claim this name" for n, s in services.items() if s.instances > 1]
        notes += [
            _offset_words(name, clock.offset_ms / 1e3)
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
            vehicle=self._config.vehicle.name,
            notes=notes[:MAX_NOTES],
            source_kind=least_live(sensor.source_kind for sensor in sensors.values() if sensor.age_ms is not None),
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
        expected = {f"{watch.host}/{watch.service}" for watch in self._inbox.watches.values()} | {*self._config.expects}
        known = expected | {name for name in self._services if not self._has_ended(name)} | set(instances)
        strangers = sorted(known - expected, key=lambda name: (name not in instances, name))
        names = expected | set(strangers[:MAX_NAMES])  # those that are there first
        self._services = {name: self._judge_service(name, len(instances.get(name, ())), seen) for name in sorted(names)}
        return self._services

    def _has_ended(self, name: str) -> bool:
        """A recorder that was stopped has said so: it is not missing."""
        status = self._inbox.statuses.get(name)
        return status is not None and status.message.reason.startswith(ENDED)

    def _judge_service(self, name: str, instances: int, seen: Observation) -> ServiceHealth:
        status, last = self._inbox.statuses.get(name), self._services.get(name)
        state: ServiceState = "starting"
        reason = "no status yet"
        if instances == 0:
            fault = seen.link_faults.get(name.partition("/")[0])
            state, reason = "disconnected", fault.why if fault else "no process"
        elif status is not None and status.is_fresh(seen.now_s):
            state, reason = status.message.state, status.message.reason
        since_ns = last.since_ns if last is not None and last.state == state else seen.now_ns
        return ServiceHealth(alive=instances > 0, instances=instances, state=state, reason=reason, since_ns=since_ns)


def _offset_words(name: str, offset_s: float) -> str:
    """An offset that is corrected for; a clock that is wrong by hours is the host's, and told as such."""
    if abs(offset_s) > WRONG_CLOCK_S:
        return f"{clock_words(name.partition('/')[0], offset_s)}; ages are corrected for it"
    return f"clock of {name} is {offset_s:+.3f} s from ours; ages are corrected for it"
