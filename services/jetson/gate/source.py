"""The gate's ears: fusion's verdict, its liveliness token, our own link, and a person's acknowledgement."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable, Iterator

import zenoh

from common.bus.presence import Presence
from common.bus.runtime import Service
from common.bus.session import undeclare
from common.clock import monotonic_s, utc_ns
from common.topics import FUSION_VERDICT, token_key
from services.jetson.gate.checks import GateInputs
from services.jetson.gate.config import GateConfig
from services.jetson.gate.inbox import Arrival, VerdictInbox

MAX_WAITING = 64  # verdicts; more than that in one round is a flood, of which the newest are enough


def listen(service: Service, config: GateConfig) -> Iterator[GateInputs]:
    """One ``GateInputs`` for every verdict that arrives, and at least one in ``period_s``. Never ends."""
    waiting: deque[Arrival] = deque(maxlen=MAX_WAITING)

    def arrived(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            waiting.append(Arrival(sample.payload.to_bytes(), str(sample.encoding), monotonic_s(), utc_ns()))
        service.wake.set()

    inbox, fusion = VerdictInbox(), config.fusion_host
    tokens = token_key(fusion, "fusion", "*")
    presence = Presence(service.session, lambda _: service.wake.set(), tokens)
    subscriber = service.session.declare_subscriber(FUSION_VERDICT.key(fusion), arrived)
    try:
        while True:
            service.wake.wait(config.period_s)
            service.wake.clear()
            inbox.meet([instance for _, _, instance in presence.instances()])
            isolated = not service.session.info.transports()
            arrivals = len(waiting)
            for _ in range(arrivals):
                inbox.take(waiting.popleft())
                yield inbox.inputs(monotonic_s())._replace(isolated=isolated)
            if not arrivals:
                yield inbox.inputs(monotonic_s())._replace(isolated=isolated)
    finally:
        undeclare(subscriber)


class Acknowledgement:
    """``<host>/gate/acknowledge``: a person says that the vehicle may move again. Asked on this host only."""

    def __init__(self, service: Service, answer: Callable[[], dict[str, object]]) -> None:
        self._given = threading.Event()
        self._key = f"{service.host}/gate/acknowledge"
        self._answer = answer
        self._queryable = service.session.declare_queryable(self._key, self._reply)

    def taken(self) -> bool:
        """Whether somebody has acknowledged since the last call."""
        if not self._given.is_set():
            return False
        self._given.clear()
        return True

    def _reply(self, query: zenoh.Query) -> None:
        self._given.set()
        with query:
            query.reply(self._key, json.dumps(self._answer()), encoding="application/json")
