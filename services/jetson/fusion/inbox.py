"""Sorts what arrives: sensor messages to their watches, the newest status and motion; the rest is counted by name."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

from common.bus.pubsub import Received
from common.messages import ServiceStatus
from common.topics import EGO_MOTION, RADAR_MOTION, SENSOR_TOPICS
from services.jetson.fusion.clocks import ClockWatch, OwnClock
from services.jetson.fusion.config import FusionConfig, SensorConfig
from services.jetson.fusion.dating import Age, SenderClock, age_of
from services.jetson.fusion.health import DatedStatus, LinkState, SensorWatch
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.own_speed import OwnSpeed
from services.jetson.fusion.roster import Roster
from services.jetson.fusion.vehicle import EgoWatch

MAX_NAMES = 64  # of unexpected senders: they cannot fill the memory
REFUSED_SHOWN_S = 2.0
UNDECODABLE = "undecodable"


class Inbox:
    """The newest of everything, by sensor name."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._others = frozenset(config.vehicle.other_hosts)  # hosts of other vehicles
        sensors: dict[str, SensorConfig] = {name: getattr(config.sensors, name) for name in SENSOR_TOPICS}
        fitted = {name: topic for name, topic in SENSOR_TOPICS.items() if sensors[name].expected}
        self.watches = {
            name: SensorWatch(name, sensors[name].host, topic, config.health) for name, topic in fitted.items()
        }
        self._ego_clock = ClockWatch(config.clocks)
        self.clocks = {name: ClockWatch(config.clocks) for name in fitted}
        self.roster = Roster()
        self.statuses: dict[str, DatedStatus] = {}
        self.ego = EgoWatch(config)
        self.own_speed = OwnSpeed(config)
        self._radar_motion = RADAR_MOTION.key(config.sensors.radar.host)
        self.bad_input: Counter[str] = Counter()  # since the start, by key and reason
        self.new_bad_input: Counter[str] = Counter()  # not reported yet
        self._by_key = {topic.key(sensors[name].host): name for name, topic in fitted.items()}
        self._by_service = {f"{watch.host}/{watch.service}": name for name, watch in self.watches.items()}
        self._clock_of = {service: self.clocks[name] for service, name in self._by_service.items()}
        self._clock_of[f"{config.ego_host}/{EGO_MOTION.service}"] = self._ego_clock
        self._refused: dict[str, tuple[str, float]] = {}
        self._own_clock = OwnClock(config.clocks)
        self._own_step: tuple[str, float] = ("", 0.0)

    def own_clock_doubt(self, now_s: float) -> str:
        """Why no stamp can be dated now; empty when our own clock has stood still for long enough."""
        text, stepped_s = self._own_step
        settle_s = self._config.clocks.settle_samples * self._config.clocks.period_s
        return text if text and now_s - stepped_s < settle_s else ""

    def sort(self, seen: Observation) -> dict[str, LinkState]:
        """Take everything in; returns what is known about each sensor besides its data."""
        if not self._stepped(seen):
            for sample in seen.clock_samples:
                if sample.name in self._clock_of:
                    self._clock_of[sample.name].add(sample)
        self.roster.update(frozenset(one for one in seen.present if one[0] not in self._others))
        self._forget_clocks_of_the_gone()
        for key, why in seen.refused.items():
            if key.partition("/")[0] in self._others:
                continue
            self._refuse(key, why, seen.now_s)
        ours = [
            _by_our_clock(received, seen)
            for received in seen.received
            if received.key.partition("/")[0] not in self._others
        ]
        for received in ours:
            if isinstance(received.message, ServiceStatus):
                self._take_status(received, seen.now_s)
        link = {name: self._link_state(name, seen) for name in self.watches}
        for received in ours:
            self._take(received, link)
        return link

    def _stepped(self, seen: Observation) -> bool:
        """Our own clock has; what was measured of the others since the last look may be by the clock as it was."""
        step_s = self._own_clock.step(seen.now_s, seen.now_ns)
        if step_s:
            self._own_step = (f"our own clock stepped by {step_s:+.3f} s, measuring the others again", seen.now_s)
            for clock in self._clock_of.values():
                clock.shift(step_s)
        return bool(step_s)

    def _forget_clocks_of_the_gone(self) -> None:
        """The next process has a clock of its own."""
        for service, clock in self._clock_of.items():
            if service not in self.roster.services:
                clock.forget()

    def _sender(self, service: str, now_s: float) -> SenderClock | None:
        """The clock of a service. One that nobody asks for the time has the clock of another service on its host.

        None where no clock of that host is known.
        """
        if service in self._clock_of:
            return self._clock_of[service].sender(now_s)
        host = service.partition("/")[0] + "/"
        measured = (one for name, one in self._clock_of.items() if name.startswith(host) and one.estimate(now_s))
        clock = next(measured, None)
        return None if clock is None else clock.sender(now_s)

    def _take(self, received: Received[Any], link: dict[str, LinkState]) -> None:
        name = self._by_key.get(received.key)
        kind = received.message.source_kind
        is_motion = received.key in (EGO_MOTION.key(self._config.ego_host), self._radar_motion)
        is_input = name is not None or is_motion
        if is_input and self._config.vehicle.live_only and kind != "live":
            self._count(f"{received.key}: {kind}, and this site is live")
            if name is not None:
                self._refused[name] = (f"its data is {kind}, and this site is live", received.arrived_s)
        elif name is not None:
            what = self.watches[name].take(received, link[name])
            if what:
                self._count(f"{received.key}: {what}")
        elif received.key == EGO_MOTION.key(self._config.ego_host):
            what = self.ego.take(received, self._ego_clock.sender(received.arrived_s))
            if what:
                self._count(f"{received.key}: {what}")
        elif received.key == self._radar_motion and "radar" in self.clocks:
            self.own_speed.take(received, self.clocks["radar"].sender(received.arrived_s))
        elif not isinstance(received.message, ServiceStatus):
            self._count(f"{received.key}: from an unexpected host")

    def _take_status(self, received: Received[ServiceStatus], now_s: float) -> None:
        """The newest of each service; a word that was said already is not said anew by being repeated."""
        name, new = received.key.removesuffix("/status"), received.message
        last = self.statuses.get(name)
        if last is None and not self._has_room(name):
            return
        if last is not None and _is_repeated(new, last.message):
            self._count(f"{received.key}: repeated")
            return
        clock = self._sender(name, now_s)
        age = Age(received.arrived_s, 0.0) if clock is None else age_of(received, clock)
        self.statuses[name] = DatedStatus(received, age)

    def _has_room(self, name: str) -> bool:
        """For the status of one more. Of strangers there is a limit, and one that is gone makes room."""
        expected = self._by_service.keys() | {*self._config.expects}
        strangers = [one for one in self.statuses if one not in expected]
        if name in expected or len(strangers) < MAX_NAMES:
            return True
        gone = next((one for one in strangers if one not in self.roster.services), None)
        if gone is not None:
            del self.statuses[gone]
        return gone is not None

    def _refuse(self, key: str, why: str, now_s: float) -> None:
        self._count(f"{key}: {UNDECODABLE}")
        if key in self._by_key:
            self._refused[self._by_key[key]] = (f"undecodable: {why}", now_s)

    def _count(self, what: str) -> None:
        if what not in self.bad_input and len(self.bad_input) >= MAX_NAMES:
            what = "from further strangers"
        self.bad_input[what] += 1
        if not what.endswith(UNDECODABLE):
            self.new_bad_input[what] += 1

    def _link_state(self, name: str, seen: Observation) -> LinkState:
        watch, clock = self.watches[name], self.clocks[name]
        full_name = f"{watch.host}/{watch.service}"
        instances = self.roster.services.get(full_name, ())
        why, refused_s = self._refused.get(name, ("", seen.now_s))
        return LinkState(
            instances=instances,
            handing_over=full_name in self.roster.handing_over,
            host_alive=watch.host in self.roster.hosts,
            isolated=seen.isolated,
            status=self.statuses.get(full_name),
            clock_distrust=clock.distrust(seen.now_s),
            clock=clock.sender(seen.now_s),
            unlinked=seen.link_faults.get(watch.host),
            undecodable=why if why and seen.now_s - refused_s < REFUSED_SHOWN_S else "",
        )


def _is_repeated(new: ServiceStatus, last: ServiceStatus) -> bool:
    older = new.instance == last.instance and new.seq <= last.seq and new.stamp_ns < last.stamp_ns
    return older or new == last


def _by_our_clock(received: Received[Any], seen: Observation) -> Received[Any]:
    """Its arrival in our UTC of now, from the monotonic clock: the UTC of then may be of before a step."""
    return replace(received, arrived_ns=seen.now_ns - round((seen.now_s - received.arrived_s) * 1e9))
