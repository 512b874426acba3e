"""Fusion's inputs: subscriptions, presence and clock measurements, as a sequence of observations."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator

import zenoh

from common.clock import monotonic_s, utc_ns
from common.codec import DecodeError, decode
from common.messages import ClockReply
from common.presence import Presence
from common.runtime import Service
from common.topics import EGO_MOTION, clock_key, status_topic
from services.jetson.fusion.clocks import ClockSample, measure
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.inbox import SENSOR_TOPICS
from services.jetson.fusion.observation import Observation

CLOCK_READ_LIMIT_S = 0.001
CLOCK_ANSWER_LIMIT_S = 0.3


def observe(service: Service, config: FusionConfig) -> Iterator[Observation]:
    """One observation on every arrival or change, and at least one per verdict period. Never ends."""
    presence = Presence(service.session, lambda _: service.wake.set())
    topics = [*SENSOR_TOPICS.values(), EGO_MOTION, status_topic("*")]
    subscriptions = [service.latest(topic, topic.message, "*") for topic in topics]
    clocks = ClockPoller(service, presence, config)
    while True:
        service.wake.wait(config.health.verdict_period_s)
        service.wake.clear()
        received = tuple(one for subscription in subscriptions for one in subscription.take())
        now_s, now_ns = read_clocks()
        yield Observation(
            now_s=now_s,
            now_ns=now_ns,
            received=received,
            present=frozenset(presence.instances()),
            isolated=not service.session.info.transports(),
            clock_samples=clocks.take(),
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
    """Asks every sensor's service for the time, over and over, in a thread of its own."""

    def __init__(self, service: Service, presence: Presence, config: FusionConfig) -> None:
        self._session, self._presence, self._wake = service.session, presence, service.wake
        self._period_s = config.clocks.period_s
        self._targets = [(getattr(config.sensors, name).host, topic.service) for name, topic in SENSOR_TOPICS.items()]
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
        while not self._pause.wait(self._period_s):
            for host, name in self._targets:
                if not self._presence.instances(host, name):
                    continue
                try:
                    sample = ask(self._session, host, name)
                except zenoh.ZError:
                    return  # the session is closed
                if sample is not None:
                    self._samples.append(sample)


def ask(session: zenoh.Session, host: str, service: str) -> ClockSample | None:
    """One exchange with one service; None when it did not answer, or not sensibly."""
    asked_ns = utc_ns()
    for reply in session.get(
        clock_key(host, service), payload=asked_ns.to_bytes(8, "little"), timeout=CLOCK_ANSWER_LIMIT_S
    ):
        back_ns = utc_ns()
        if reply.ok is None:
            continue
        try:
            answer = decode(reply.ok.payload.to_bytes(), ClockReply)
        except DecodeError:
            continue
        if answer.stamp_ns == asked_ns:
            at = (asked_ns, answer.request_received_ns, answer.reply_sent_ns, back_ns)
            return measure(f"{host}/{service}", monotonic_s(), *at)
    return None
