"""Records verdict and health during a drill, with the monotonic time of every arrival."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Collection
from typing import TypeVar

import zenoh

from common.bus.session import undeclare
from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.messages import Message, SystemHealth, Verdict
from common.topics import FUSION_HEALTH, FUSION_VERDICT, ONBOARD_SENSORS, Topic

M = TypeVar("M", bound=Message)
KEPT = 4096


class Watch:
    """``wait_for`` the first message that fits; ``broken_rules`` are what no fault may ever cause.

    ``hosts`` are those of the one vehicle that is drilled; without them there is only one.
    """

    def __init__(self, session: zenoh.Session, hosts: Collection[str] = ()) -> None:
        self._changed = threading.Condition()
        self._seen: dict[type, deque[tuple[float, Message]]] = {
            Verdict: deque(maxlen=KEPT),
            SystemHealth: deque(maxlen=KEPT),
        }
        self.broken_rules: list[str] = []
        self._subscribers = [
            session.declare_subscriber(topic.key(host), self._noter(topic))
            for topic in (FUSION_VERDICT, FUSION_HEALTH)
            for host in hosts or ("*",)
        ]

    def close(self) -> None:
        """Stop listening."""
        for subscriber in self._subscribers:
            undeclare(subscriber)

    def wait_for(
        self, kind: type[M], fits: Callable[[M], bool], since_s: float, until_s: float
    ) -> tuple[float, M] | None:
        """(arrival, message) of the first that arrived after ``since_s`` and fits; None when none did in time."""
        while True:
            with self._changed:
                for arrived_s, message in self._seen[kind]:
                    if arrived_s >= since_s and isinstance(message, kind) and fits(message):
                        return arrived_s, message
                left_s = until_s - monotonic_s()
                if left_s <= 0.0:
                    return None
                self._changed.wait(min(left_s, 0.1))

    def wait_for_silence(self, quiet_s: float, until_s: float) -> float | None:
        """When the newest verdict had been there for ``quiet_s`` without a successor; None when they kept coming."""
        while True:
            with self._changed:
                last_s = self._seen[Verdict][-1][0] if self._seen[Verdict] else 0.0
                now_s = monotonic_s()
                if now_s - last_s >= quiet_s:
                    return last_s + quiet_s
                if now_s >= until_s:
                    return None
                self._changed.wait(quiet_s - (now_s - last_s))

    def levels(self, since_s: float) -> set[str]:
        """The verdict's levels since then."""
        with self._changed:
            return {m.level for at_s, m in self._seen[Verdict] if at_s >= since_s and isinstance(m, Verdict)}

    def newest(self, kind: type[M]) -> M | None:
        """The last message of a kind that was seen, if any."""
        with self._changed:
            last = self._seen[kind][-1][1] if self._seen[kind] else None
        return last if isinstance(last, kind) else None

    def _noter(self, topic: Topic) -> Callable[[zenoh.Sample], None]:
        def note(sample: zenoh.Sample) -> None:
            """Keep one message of ``topic`` with the time at which it came."""
            now_s = monotonic_s()
            try:
                message = decode(sample.payload.to_bytes(), topic.message)
            except DecodeError:
                return
            with self._changed:
                self._seen[topic.message].append((now_s, message))
                if isinstance(message, Verdict):
                    self.broken_rules += broken_rules(message)
                self._changed.notify_all()

        return note


def broken_rules(verdict: Verdict, onboard: tuple[str, ...] = ONBOARD_SENSORS) -> list[str]:
    """Rules for every verdict under any fault: never SAFE with two sensors out, no IMMINENT lowered, blind stops."""
    inputs = verdict.inputs
    out = [name for name in onboard if name not in inputs or inputs[name].state != "online"]
    problems = []
    if len(out) >= 2 and verdict.level == "SAFE":
        problems.append(f"SAFE while {', '.join(out)} are out")
    if len(out) == len(onboard) and verdict.permission != "STOP":
        problems.append("blind without STOP")
    for name in onboard:
        if name != "camera" and name not in out and inputs[name].level == "IMMINENT" and verdict.level != "IMMINENT":
            problems.append(f"the {name}'s IMMINENT was lowered to {verdict.level}")
    return problems
