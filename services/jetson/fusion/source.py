"""Fusion's inputs: subscriptions, presence and clock measurements, as a sequence of observations."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress

import zenoh

from common.bus.presence import Presence
from common.bus.runtime import Service
from common.clock import monotonic_s, utc_ns
from common.codec import DecodeError, decode
from common.messages import ClockReply, LinkFault, RouterLinks
from common.topics import EGO_MOTION, RADAR_MOTION, SENSOR_TOPICS, clock_key, links_key, status_topic
from services.jetson.fusion.acknowledge import Acknowledgement
from services.jetson.fusion.clocks import ClockSample, measure
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.observation import Observation

CLOCK_READ_LIMIT_S = 0.001
CLOCK_ANSWER_LIMIT_S = 0.3


def observe(service: Service, config: FusionConfig) -> Iterator[Observation]:
    """One observation on every arrival or change, and at least one per verdict period. Never ends."""
    presence = Presence(service.session, lambda _: service.wake.set())
    topics = [*SENSOR_TOPICS.values(), EGO_MOTION, RADAR_MOTION, status_topic("*")]
    subscriptions = [service.latest(topic, topic.message, "*") for topic in topics]
    clocks = ClockPoller(service, presence, config)
    person = Acknowledgement(service)
    while True:
        service.wake.wait(config.health.verdict_period_s)
        service.wake.clear()
        received = tuple(one for subscription in subscriptions for one in subscription.take())
        clock_samples = clocks.take()
        now_s, now_ns = read_clocks()  # after all that came, so that a step since then is noticed with it
        yield Observation(
            now_s=now_s,
            now_ns=now_ns,
            received=received,
            present=frozenset(presence.instances()),
            isolated=not service.session.info.transports(),
            clock_samples=clock_samples,
            link_faults=clocks.link_faults,
            acknowledged=person.taken(),
            refused={key: why for subscription in subscriptions for key, why in subscription.refused.items()},
        )


def read_clocks() -> tuple[float, int]:
    """Monotonic seconds and UTC nanoseconds of the same moment; read again when we were interrupted in between."""
    for _ in range(5):
        before_s, now_ns, after_s = monotonic_s(), utc_ns(), monotonic_s()
        if after_s - before_s < CLOCK_READ_LIMIT_S:
            break
    return (before_s + after_s) / 2, now_ns


class ClockPoller:
    """Asks the services of every sensor and of the ego motion for the time, over and over, in a thread of its own.

    While a host is not there at all, it asks the own router why. ``link_faults`` is its last answer.
    """

    def __init__(self, service: Service, presence: Presence, config: FusionConfig) -> None:
        self._session, self._presence, self._wake = service.session, presence, service.wake
        self._period_s = config.clocks.period_s
        self._targets = [(getattr(config.sensors, name).host, topic.service) for name, topic in SENSOR_TOPICS.items()]
        self._targets.append((config.ego_host, EGO_MOTION.service))
        self._own_host = config.host
        self.link_faults: Mapping[str, LinkFault] = {}
        self._samples: deque[ClockSample] = deque(maxlen=64)
        self._pause = threading.Event()
        threading.Thread(target=self._poll, name="clocks", daemon=True).start()

    def take(self) -> tuple[ClockSample, ...]:
        """The measurements since the last call."""
        taken = []
        while self._samples:
            taken.append(self._samples.popleft())
        return tuple(taken)

    def _poll(self) -> None:
        while not self._session.is_closed() and not self._pause.wait(self._period_s):
            for host, name in self._targets:
                if self._presence.instances(host, name):
                    with suppress(zenoh.ZError):  # closed, or this one question could not be asked
                        sample = ask(self._session, host, name)
                        if sample is not None:
                            self._samples.append(sample)
            absent = {host for host, _ in self._targets if not self._presence.instances(host)} - {self._own_host}
            with suppress(zenoh.ZError):
                self.link_faults = ask_router(self._session, self._own_host) if absent else {}


def ask_router(session: zenoh.Session, own_host: str) -> Mapping[str, LinkFault]:
    """By host, why the router of this host cannot link it; empty where the router knows of nothing, or has no TLS."""
    for reply in session.get(links_key(own_host), timeout=CLOCK_ANSWER_LIMIT_S):
        if reply.ok is not None:
            try:
                return decode(reply.ok.payload.to_bytes(), RouterLinks).faults
            except DecodeError:
                continue
    return {}


def ask(session: zenoh.Session, host: str, service: str) -> ClockSample | None:
    """One exchange with one service; None when it did not answer, or not sensibly."""
    asked_s, asked_ns = read_clocks()
    for reply in session.get(
        clock_key(host, service), payload=asked_ns.to_bytes(8, "little"), timeout=CLOCK_ANSWER_LIMIT_S
    ):
        back_s, back_ns = read_clocks()
        if reply.ok is None:
            continue
        try:
            answer = decode(reply.ok.payload.to_bytes(), ClockReply)
        except DecodeError:
            continue
        if abs((back_ns - asked_ns) * 1e-9 - (back_s - asked_s)) > 2 * CLOCK_READ_LIMIT_S:
            return None  # our own clock stepped in between
        if answer.stamp_ns == asked_ns:
            at = (asked_ns, answer.request_received_ns, answer.reply_sent_ns, back_ns)
            return measure(f"{host}/{service}", back_s, *at)
    return None
