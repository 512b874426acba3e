"""Fusion's inputs: subscriptions, presence and clock measurements, as a sequence of observations."""

from __future__ import annotations

from collections.abc import Iterator

from common.clock import monotonic_s, utc_ns
from common.presence import Presence
from common.runtime import Service
from common.topics import EGO_MOTION, status_topic
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.pipeline import SENSOR_TOPICS

CLOCK_READ_LIMIT_S = 0.001


def observe(service: Service, config: FusionConfig) -> Iterator[Observation]:
    """One observation on every arrival or change, and at least one per verdict period. Never ends."""
    presence = Presence(service.session, lambda _: service.wake.set())
    topics = [*SENSOR_TOPICS.values(), EGO_MOTION, status_topic("*")]
    subscriptions = [service.latest(topic, topic.message, "*") for topic in topics]
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
        )


def read_clocks() -> tuple[float, int]:
    """Monotonic seconds and UTC nanoseconds of the same moment; read again when we were interrupted in between."""
    for _ in range(5):
        before_s, now_ns, after_s = monotonic_s(), utc_ns(), monotonic_s()
        if after_s - before_s < CLOCK_READ_LIMIT_S:
            break
    return (before_s + after_s) / 2, now_ns
