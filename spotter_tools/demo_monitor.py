"""Monitors a running demo: counts, rates, verdict and health history, latency.

Latency is from the measurement's stamp to the verdict that first used it being sent: echo to alarm, on one clock.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh

from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.messages import ServiceStatus, SystemHealth, Verdict
from common.topics import DATA_TOPICS, SERVICES, find_topic, status_topic
from spotter_tools.wording import without_numbers

_PRIMARY = {topic.service: topic.product for topic in reversed(DATA_TOPICS) if topic.age_limit_s is not None}
MAX_LATENCIES = 200_000


@dataclass
class DemoReport:
    """What the monitor has seen since ``start``; times are seconds since then."""

    started_s: float
    messages: Counter[str] = field(default_factory=Counter)
    primary: Counter[str] = field(default_factory=Counter)
    bad_input: dict[str, int] = field(default_factory=dict)
    levels: list[tuple[float, str, str]] = field(default_factory=list)
    health: list[tuple[float, str, str, str]] = field(default_factory=list)
    latencies_ms: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_LATENCIES))
    verdicts: int = 0


class DemoMonitor:
    """Subscribes to everything; ``report()`` may be called at any time, ``restart()`` begins a new measurement."""

    def __init__(self, session: zenoh.Session) -> None:
        self._lock = threading.Lock()
        self._last_stamp_ns: dict[str, int] = {}
        self._last_state: dict[str, tuple[str, str]] = {}
        self._last_verdict: tuple[str, str] = ("", "")
        self._seen: DemoReport = DemoReport(monotonic_s())
        # On-demand topics are left alone: listening would make the services produce them.
        watched = [topic for topic in DATA_TOPICS if not topic.on_demand] + [status_topic("*")]
        self._subscribers = [
            session.declare_subscriber(topic.any_host, zenoh.handlers.FifoChannel(4096)) for topic in watched
        ]
        for subscriber in self._subscribers:
            threading.Thread(target=self._receive, args=(subscriber,), name="demo monitor", daemon=True).start()

    def restart(self) -> None:
        """Start the measurement again: counts, histories and latencies begin now."""
        with self._lock:
            self._seen = DemoReport(monotonic_s(), bad_input=dict(self._seen.bad_input))
            self._last_state.clear()
            self._last_verdict = ("", "")

    def services_online(self) -> set[str]:
        """Services that have published data, or status where they have no data of their own."""
        with self._lock:
            return {
                row.name
                for row in SERVICES
                if self._seen.primary[row.name] or (row.name not in _PRIMARY and self._seen.messages[row.name])
            }

    def report(self) -> dict[str, Any]:
        """The JSON object of ``spotter demo --json``."""
        with self._lock:
            seen = self._seen
            elapsed_s = max(monotonic_s() - seen.started_s, 1e-3)
            latencies_ms = np.array(seen.latencies_ms)
            return {
                "services": {row.name: self._service(row.name, elapsed_s) for row in SERVICES},
                "verdict": {
                    "rate_hz": round(seen.verdicts / elapsed_s, 2),
                    "levels_seen": sorted({level for _, level, _ in seen.levels}),
                    "history": [list(row) for row in seen.levels],
                },
                "health": {"history": [list(row) for row in seen.health]},
                "latency_ms": {
                    "p50": _percentile(latencies_ms, 50),
                    "p99": _percentile(latencies_ms, 99),
                },
            }

    def silent_services(self) -> list[str]:
        """Services that published nothing since the start of the measurement."""
        with self._lock:
            return [
                row.name
                for row in SERVICES
                if not (self._seen.primary[row.name] if row.name in _PRIMARY else self._seen.messages[row.name])
            ]

    def _service(self, name: str, elapsed_s: float) -> dict[str, Any]:
        counted = self._seen.primary[name] if name in _PRIMARY else self._seen.messages[name]
        return {
            "messages": self._seen.messages[name],
            "rate_hz": round(counted / elapsed_s, 2),
            "bad_input": self._seen.bad_input.get(name, 0),
        }

    def _receive(self, subscriber: Iterable[zenoh.Sample]) -> None:
        try:
            for sample in subscriber:
                self._note(str(sample.key_expr), sample.payload.to_bytes())
        except zenoh.ZError:
            return

    def _note(self, key: str, payload: bytes) -> None:
        topic = find_topic(key)
        if topic is None:
            return
        with self._lock:
            self._seen.messages[topic.service] += 1
            if _PRIMARY.get(topic.service) == topic.product:
                self._seen.primary[topic.service] += 1
            if topic.message not in (Verdict, SystemHealth, ServiceStatus):
                return
            try:
                message = decode(payload, topic.message)
            except DecodeError:
                return
            if isinstance(message, Verdict):
                self._note_verdict(message)
            elif isinstance(message, SystemHealth):
                self._note_health(message)
            elif isinstance(message, ServiceStatus):
                self._seen.bad_input[topic.service] = message.bad_input

    def _note_verdict(self, verdict: Verdict) -> None:
        self._seen.verdicts += 1
        if (verdict.level, verdict.rule) != self._last_verdict:
            self._last_verdict = (verdict.level, verdict.rule)
            self._seen.levels.append((self._elapsed_s(), verdict.level, verdict.rule))
        for name, contribution in verdict.inputs.items():
            stamp_ns = contribution.stamp_ns
            if stamp_ns and self._last_stamp_ns.get(name) != stamp_ns:
                self._last_stamp_ns[name] = stamp_ns
                self._seen.latencies_ms.append((verdict.sent_ns - stamp_ns) / 1e6)

    def _note_health(self, system: SystemHealth) -> None:
        for name, sensor in system.sensors.items():
            state = (sensor.state, without_numbers(sensor.reason))
            if self._last_state.get(name) != state:
                self._last_state[name] = state
                self._seen.health.append((self._elapsed_s(), name, sensor.state, sensor.reason))

    def _elapsed_s(self) -> float:
        return round(monotonic_s() - self._seen.started_s, 3)


def _percentile(values: np.ndarray, percent: float) -> float | None:
    return round(float(np.percentile(values, percent)), 2) if len(values) else None
