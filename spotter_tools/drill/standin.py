"""A proxy that republishes a service's messages with injected faults.

The service publishes into another namespace, the proxy into the usual one. So services need no commands for faults, and
all the rest (codec, network, fusion) is unchanged.
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import msgpack
import zenoh

from common.bus.runtime import Service
from common.bus.session import close_session, open_session, undeclare
from common.clock import monotonic_s
from common.config import ServiceConfig, ZenohConfig
from common.topics import Topic
from spotter_tools.drill.fault_plan import Fault

UPSTREAM = "drill_upstream"  # the namespace into which the real service publishes
STRANGER = "stranger9"
Outgoing = tuple[float, str, bytes]  # when to send (monotonic), host, payload


class FaultInjector:
    """Converts one payload to the payloads that are sent instead. No I/O; time is an argument."""

    def __init__(self, host: str, seed: int = 0) -> None:
        self.fault: Fault | None = None
        self._host = host
        self._dice = random.Random(seed)
        self._held: bytes | None = None
        self._stuck: bytes | None = None
        self._count = 0

    def set(self, fault: Fault | None) -> None:
        """Begin a fault, or end it with None."""
        self.fault, self._held, self._stuck = fault, None, None

    def feed(self, now_s: float, payload: bytes) -> list[Outgoing]:
        """The outgoing payloads for one incoming payload."""
        self._count += 1
        match self.fault.kind if self.fault else "":
            case "delay":
                assert self.fault is not None
                return [(now_s + self.fault.seconds, self._host, payload)]
            case "duplicate":
                return [(now_s + 0.01 * i, self._host, payload) for i in range(3)]
            case "reorder":
                return self._reorder(now_s, payload)
            case "stuck":
                self._stuck = self._stuck or payload
                return [(now_s, self._host, self._stuck)]
            case "foreign_host":
                return [(now_s, STRANGER, payload)]
            case "":
                return [(now_s, self._host, payload)]
        return [(now_s, self._host, self._wrong(payload))]

    def _reorder(self, now_s: float, payload: bytes) -> list[Outgoing]:
        """Swap the two messages of each pair."""
        if self._held is None:
            self._held = payload
            return []
        first, self._held = self._held, None
        return [(now_s, self._host, payload), (now_s + 0.005, self._host, first)]

    def _wrong(self, payload: bytes) -> bytes:
        assert self.fault is not None
        message = msgpack.unpackb(payload)
        match self.fault.kind:
            case "garbage":
                return self._dice.randbytes(self._dice.randrange(1, 200))
            case "wrong_types":
                message = {name: [value] for name, value in message.items()}
            case "nan":
                message = _with_nan(message)
            case "million":
                name = next((name for name, value in message.items() if isinstance(value, list)), "tracks")
                message[name] = [None] * 1_000_000
            case "future" | "past":
                for name in ("stamp_ns", "received_ns", "sent_ns"):
                    message[name] = max(0, message[name] + round(self.fault.seconds * 1e9))
            case "jump":
                message["seq"] = self._dice.randrange(2**60)
        return bytes(msgpack.packb(message))


def _with_nan(message: dict[str, Any]) -> dict[str, Any]:
    return {name: math.nan if isinstance(value, float) else value for name, value in message.items()}


class StandIn:
    """Service ``name`` on ``host`` as seen by all others: own token, status and clock, the data of the real service."""

    def __init__(self, name: str, host: str, topic: Topic, endpoint: str, namespace: str) -> None:
        self.injector = FaultInjector(host)
        self._topic = topic
        self._queue: list[tuple[float, int, str, bytes]] = []
        self._order: Iterator[int] = itertools.count()
        self._wake = threading.Condition()
        self._stopped = False
        self._upstream = open_session(ZenohConfig(connect=(endpoint,), namespace=UPSTREAM))
        config = ServiceConfig(host=host, zenoh=ZenohConfig(connect=(endpoint,), namespace=namespace))
        self._stack = ExitStack()
        self._service = self._stack.enter_context(Service(name, config))
        self._service.report.state("online")
        self._subscriber = self._upstream.declare_subscriber(topic.key(host), zenoh.handlers.FifoChannel(256))
        for work in (self._receive, self._send):
            threading.Thread(target=work, name="stand-in", daemon=True).start()

    def close(self) -> None:
        """Leave the bus."""
        with self._wake:
            self._stopped = True
            self._wake.notify_all()
        undeclare(self._subscriber)
        close_session(self._upstream)
        self._stack.close()

    def _receive(self) -> None:
        try:
            for sample in self._subscriber:
                outgoing = self.injector.feed(monotonic_s(), sample.payload.to_bytes())
                with self._wake:
                    for due_s, host, payload in outgoing:
                        heapq.heappush(self._queue, (due_s, next(self._order), host, payload))
                    self._wake.notify_all()
        except zenoh.ZError:
            return

    def _send(self) -> None:
        put: Callable[[str, bytes], None] = self._service.session.put
        while True:
            with self._wake:
                while not self._stopped and (not self._queue or self._queue[0][0] > monotonic_s()):
                    self._wake.wait(max(0.0, self._queue[0][0] - monotonic_s()) if self._queue else None)
                if self._stopped:
                    return
                _, _, host, payload = heapq.heappop(self._queue)
            try:
                put(self._topic.key(host), payload)
            except zenoh.ZError:
                return
