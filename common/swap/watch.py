"""Listening to the live service, the candidate, the verdict and the health during a swap."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from itertools import pairwise

import msgspec
import zenoh

from common import topics
from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.messages import Message, SystemHealth, Verdict
from common.session import undeclare
from common.swap.compare import Heard
from common.topics import Topic


class Gap(msgspec.Struct, frozen=True, kw_only=True):
    """What the listeners of a topic noticed of the handover."""

    messages: int
    longest_gap_ms: float
    usual_gap_ms: float  # median
    missed: int  # fewer than the usual gap would give over the same time
    verdict_flaps: int  # level changed and came back within a second
    health_flaps: int  # the sensor left online


class Ear:
    """Everything on one key, in order; ``since`` forgets what came before."""

    def __init__(self, session: zenoh.Session, key: str, topic: Topic) -> None:
        self._topic = topic
        self._heard: list[Heard] = []
        self._news = threading.Condition()
        self.undecodable = 0
        self.wrong = ""  # with the last one that could not be decoded
        self._subscriber = session.declare_subscriber(key, self._note)

    def _note(self, sample: zenoh.Sample) -> None:
        arrived_s = monotonic_s()
        try:
            message = decode(sample.payload.to_bytes(), self._topic.message, self._topic.max_bytes)
        except DecodeError as error:
            self.undecodable, self.wrong = self.undecodable + 1, str(error)
            return
        with self._news:
            self._heard.append(Heard(message, arrived_s))
            self._news.notify_all()

    def since(self, start_s: float) -> list[Heard]:
        with self._news:
            self._heard = [heard for heard in self._heard if heard.arrived_s >= start_s]
            return list(self._heard)

    def wait(self, wanted: Callable[[Heard], bool], budget_s: float, give_up: Callable[[], object]) -> bool:
        """Until such a message has come; False when the budget is over or ``give_up()`` is true."""
        deadline_s = monotonic_s() + budget_s
        with self._news:
            while not any(wanted(heard) for heard in self._heard):
                if monotonic_s() > deadline_s or give_up():
                    return False
                self._news.wait(0.2)
        return True

    def close(self) -> None:
        undeclare(self._subscriber)


def primary(service: str) -> Topic:
    """The topic that others decide on, or the status of a service that has none."""
    found = [t for t in topics.DATA_TOPICS if t.service == service and t.age_limit_s is not None]
    return found[0] if found else topics.status_topic(service)


def handover_seen(service: str, live: list[Heard], verdicts: list[Heard], health: list[Heard]) -> Gap:
    """Gaps on the topic and flaps of verdict and health over the same time."""
    gaps_s = sorted(later.arrived_s - earlier.arrived_s for earlier, later in pairwise(live))
    usual_s = gaps_s[len(gaps_s) // 2] if gaps_s else 0.0
    return Gap(
        messages=len(live),
        longest_gap_ms=round(gaps_s[-1] * 1e3, 1) if gaps_s else 0.0,
        usual_gap_ms=round(usual_s * 1e3, 1),
        missed=max(0, round(sum(gaps_s) / usual_s) - len(gaps_s)) if usual_s else 0,
        verdict_flaps=flaps([(heard.arrived_s, level_of(heard.message)) for heard in verdicts]),
        health_flaps=sum(
            earlier == "online" and later != "online"
            for earlier, later in pairwise(_states(service, (heard.message for heard in health)))
        ),
    )


def flaps(levels: list[tuple[float, str]], within_s: float = 1.0) -> int:
    """How often a level was left and came back within this time: a real approach takes longer."""
    changes = [row for i, row in enumerate(levels) if i == 0 or row[1] != levels[i - 1][1]]
    return sum(
        changes[i + 1][1] == changes[i - 1][1] and changes[i + 1][0] - changes[i][0] < within_s
        for i in range(1, len(changes) - 1)
    )


def level_of(message: Message) -> str:
    return message.level if isinstance(message, Verdict) else ""


def _states(service: str, messages: Iterable[Message]) -> list[str]:
    """The sensor's state over time, as fusion sees it."""
    health = [message for message in messages if isinstance(message, SystemHealth)]
    return [message.sensors[service].state for message in health if service in message.sensors]
