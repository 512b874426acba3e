"""Subscriptions of a swap, and waiting for what arrives on them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack

import zenoh

from common import topics
from common.bus.presence import Presence
from common.bus.session import undeclare
from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.security.rules import SHADOW
from common.topics import Topic
from spotter_tools.swap.compare import Received

START_BUDGET_S = 90.0


class TopicTap:
    """Keeps all messages of one key, in order; ``since`` drops older ones."""

    def __init__(self, session: zenoh.Session, key: str, topic: Topic) -> None:
        self._topic = topic
        self._received: list[Received] = []
        self._news = threading.Condition()
        self.undecodable = 0
        self.wrong = ""  # error of the last one that could not be decoded
        self._subscriber = session.declare_subscriber(key, self._note)

    def _note(self, sample: zenoh.Sample) -> None:
        arrived_s = monotonic_s()
        try:
            message = decode(sample.payload.to_bytes(), self._topic.message, self._topic.max_bytes)
        except DecodeError as error:
            self.undecodable, self.wrong = self.undecodable + 1, str(error)
            return
        with self._news:
            self._received.append(Received(message, arrived_s))
            self._news.notify_all()

    def since(self, start_s: float) -> list[Received]:
        """Messages that arrived since a monotonic time; older ones are dropped."""
        with self._news:
            self._received = [one for one in self._received if one.arrived_s >= start_s]
            return list(self._received)

    def wait(self, reached: Callable[[list[Received]], object], budget_s: float, give_up: Callable[[], object]) -> bool:
        """Until ``reached`` holds for the received messages; False when the budget is over or ``give_up()`` is true."""
        deadline_s = monotonic_s() + budget_s
        with self._news:
            while not reached(self._received):
                if monotonic_s() > deadline_s or give_up():
                    return False
                self._news.wait(0.2)
        return True

    def close(self) -> None:
        """End the subscription."""
        undeclare(self._subscriber)


def primary(service: str) -> Topic:
    """The topic with an age limit, which others depend on; otherwise the status of the service."""
    found = [t for t in topics.DATA_TOPICS if t.service == service and t.age_limit_s is not None]
    return found[0] if found else topics.status_topic(service)


class SwapTaps:
    """Every subscription of a swap: the live topic, the candidate's shadow topic, verdict, health and tokens."""

    def __init__(self, session: zenoh.Session, service: str, host: str, stack: ExitStack) -> None:
        topic = primary(service)
        key = topic.key(host)
        self.topic = topic
        self.live = TopicTap(session, key, topic)
        self.shadow = TopicTap(session, f"{SHADOW}/{key}", topic)
        self.verdicts = TopicTap(session, topics.FUSION_VERDICT.any_host, topics.FUSION_VERDICT)
        self.health = TopicTap(session, topics.FUSION_HEALTH.any_host, topics.FUSION_HEALTH)
        self.changed = threading.Event()
        self.presence = Presence(session, lambda _: self.changed.set(), topics.token_key(host, service, "*"))
        self.promoted = False
        for tap in (self.live, self.shadow, self.verdicts, self.health, self.presence):
            stack.callback(tap.close)

    def wait_instances(self, wanted: Callable[[set[str]], bool], budget_s: float) -> bool:
        """Until ``wanted`` holds for the instances with a token; False when the budget is over."""
        deadline_s = monotonic_s() + budget_s
        while not wanted({instance for _, _, instance in self.presence.instances()}):
            if monotonic_s() > deadline_s:
                return False
            self.changed.wait(0.1)
            self.changed.clear()
        return True
