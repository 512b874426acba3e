"""Who decides in a drive: Spotter's fusion as it is, or the article's rules."""

from __future__ import annotations

from typing import Any, Protocol

from common.bus.pubsub import Received
from common.messages import Message, Verdict
from common.topics import SENSOR_TOPICS
from services.jetson.fusion.clocks import ClockSample
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.pipeline import FusionPipeline
from spotter_tools.prove.configs import Configs
from spotter_tools.prove.plain_rules import PlainRules
from spotter_tools.prove.senses import Arrival, utc_ns

CLOCK_PERIOD_S = 0.5


class Decider(Protocol):
    """Takes messages as they arrive and gives verdicts."""

    def take(self, arrival: Arrival) -> None:
        """A message has come."""

    def decide(self, now_s: float) -> Verdict:
        """The verdict now."""


class Spotter:
    """Fusion's own pipeline: every process is there, on one clock; what is silent is found out by its age."""

    def __init__(self, configs: Configs) -> None:
        self._pipeline, self._config = FusionPipeline(configs.fusion), configs.fusion
        self._pending: list[Received[Any]] = []
        hosts = {name: getattr(configs.fusion.sensors, name).host for name in SENSOR_TOPICS}
        self._present = frozenset(
            (hosts[name], topic.service, "prove") for name, topic in SENSOR_TOPICS.items() if name != "infra_lidar"
        )
        self._clocks_asked_s = -CLOCK_PERIOD_S

    def take(self, arrival: Arrival) -> None:
        """Keep it for the next verdict."""
        self._pending.append(_received(arrival))

    def decide(self, now_s: float) -> Verdict:
        """One step of the pipeline."""
        samples: tuple[ClockSample, ...] = ()
        if now_s - self._clocks_asked_s >= CLOCK_PERIOD_S:
            self._clocks_asked_s = now_s
            samples = tuple(ClockSample(f"{host}/{name}", now_s, 0.0, 0.001) for host, name, _ in self._present)
        observation = Observation(now_s, utc_ns(now_s), tuple(self._pending), self._present, clock_samples=samples)
        self._pending = []
        verdict, _ = self._pipeline.process(observation)
        return verdict


class Article:
    """The article's rules on the same messages; they do not use the vehicle's motion."""

    def __init__(self, configs: Configs) -> None:
        self._rules = PlainRules()

    def take(self, arrival: Arrival) -> None:
        """Keep the newest."""
        self._rules.take(_received(arrival))

    def decide(self, now_s: float) -> Verdict:
        """The verdict now."""
        return self._rules.decide(now_s, utc_ns(now_s))


DECIDERS: dict[str, type[Spotter] | type[Article]] = {"spotter": Spotter, "article": Article}


def _received(arrival: Arrival) -> Received[Message]:
    return Received(arrival.key, arrival.message, arrival.at_s, utc_ns(arrival.at_s))


__all__ = ["DECIDERS", "Article", "Decider", "Spotter"]
