"""Listening to the live service, the candidate, the verdict and the health during a swap."""

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import pairwise

import msgspec
import numpy as np
import zenoh

from common import topics
from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.messages import Message, SystemHealth, Verdict
from common.session import undeclare
from common.swap.compare import Heard
from common.topics import Topic


class Gap(msgspec.Struct, frozen=True, kw_only=True):
    """What the listeners of a topic noticed of the handover.

    A busy machine misses measurements at all times, so the same figures of the time before stand beside them.
    """

    messages: int
    change_ms: float  # from the old one's last message to the new one's first; negative: both spoke for so long
    longest_gap_ms: float  # between arrivals
    longest_gap_before_ms: float
    usual_gap_ms: float  # median
    missed: int  # measurements, at the usual distance of two, that neither told
    missed_before: int
    lost: int  # told but not heard, by the sender's own count
    verdict_flaps: int  # level changed and came back within a second
    verdict_flaps_before: int
    health_flaps: int  # the sensor left online
    health_flaps_before: int


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

    def wait(self, reached: Callable[[list[Heard]], object], budget_s: float, give_up: Callable[[], object]) -> bool:
        """Until what was heard is enough; False when the budget is over or ``give_up()`` is true."""
        deadline_s = monotonic_s() + budget_s
        with self._news:
            while not reached(self._heard):
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


def speakers(live: list[Heard], last_old: int, last_new: int) -> tuple[list[Heard], list[Heard]]:
    """What the old process said and what its successor did, by whose sequence number goes on.

    ``last_old`` and ``last_new`` are the last numbers before the handover, the new one's in the shadow.
    """
    next_seq = [last_old + 1, last_new + 1]
    said: tuple[list[Heard], list[Heard]] = ([], [])
    speaker = 0
    for heard in live:
        apart = [abs(heard.message.seq - expected) for expected in next_seq]
        if apart[0] != apart[1]:  # else whoever spoke last: numbers may pass where the other one's ended
            speaker = int(apart[1] < apart[0])
        said[speaker].append(heard)
        next_seq[speaker] = heard.message.seq + 1
    return said


def handover_seen(
    service: str, before: list[Heard], old: list[Heard], new: list[Heard], verdicts: list[Heard], health: list[Heard]
) -> Gap:
    """Gaps of the topic before the handover and since, when ``old`` and then ``new`` spoke; flaps of the others.

    ``verdicts`` and ``health`` are those of both times.
    """
    live = sorted(old + new, key=lambda heard: heard.arrived_s)
    levels = [(heard.arrived_s, level_of(heard.message)) for heard in verdicts]
    change_s = before[-1].arrived_s if before else 0.0
    flaps_before = flaps([row for row in levels if row[0] <= change_s])
    left_before = left_online(service, [heard for heard in health if heard.arrived_s <= change_s])
    usual_s = float(np.median(arrival_gaps_s(before))) if len(before) > 1 else 0.0
    return Gap(
        messages=len(live),
        change_ms=round((new[0].arrived_s - (before + old)[-1].arrived_s) * 1e3, 1) if new else 0.0,
        longest_gap_ms=round(max(arrival_gaps_s(before[-1:] + live), default=0.0) * 1e3, 1),
        longest_gap_before_ms=round(max(arrival_gaps_s(before), default=0.0) * 1e3, 1),
        usual_gap_ms=round(usual_s * 1e3, 1),
        missed=missed(before[-1:] + live, usual_s),
        missed_before=missed(before, usual_s),
        lost=lost(old) + lost(new),
        verdict_flaps=flaps(levels) - flaps_before,
        verdict_flaps_before=flaps_before,
        health_flaps=left_online(service, health) - left_before,
        health_flaps_before=left_before,
    )


def arrival_gaps_s(heard: list[Heard]) -> list[float]:
    """Between one message and the next."""
    return [later.arrived_s - earlier.arrived_s for earlier, later in pairwise(heard)]


def missed(heard: list[Heard], usual_s: float) -> int:
    """Measurements that nobody told: a late message is not missed, and one told twice makes up for no other."""
    stamps_s = sorted(one.message.stamp_ns * 1e-9 for one in heard)
    return sum(max(0, round((b - a) / usual_s) - 1) for a, b in pairwise(stamps_s)) if usual_s else 0


def lost(heard: list[Heard]) -> int:
    """Holes in one sender's count."""
    return sum(max(0, later.message.seq - earlier.message.seq - 1) for earlier, later in pairwise(heard))


def flaps(levels: list[tuple[float, str]], within_s: float = 1.0) -> int:
    """How often a level was left and came back within this time: a real approach takes longer."""
    changes = [row for i, row in enumerate(levels) if i == 0 or row[1] != levels[i - 1][1]]
    return sum(
        changes[i + 1][1] == changes[i - 1][1] and changes[i + 1][0] - changes[i][0] < within_s
        for i in range(1, len(changes) - 1)
    )


def level_of(message: Message) -> str:
    return message.level if isinstance(message, Verdict) else ""


def left_online(service: str, health: list[Heard]) -> int:
    """How often fusion no longer called the sensor online."""
    messages = [heard.message for heard in health if isinstance(heard.message, SystemHealth)]
    states = [message.sensors[service].state for message in messages if service in message.sensors]
    return sum(earlier == "online" and later != "online" for earlier, later in pairwise(states))
