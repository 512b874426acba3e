"""What the blackbox keeps: this host's topics, and the verdict and health that trigger it, as they arrive."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable, Iterator

import zenoh

from common.bus.runtime import Service
from common.clock import monotonic_s, utc_ns
from common.topics import DATA_TOPICS, FUSION_HEALTH, FUSION_VERDICT
from services.blackbox.config import BlackboxConfig
from services.blackbox.ring import Kept

QUEUE = 20_000
RING_PER_TOPIC = 512
TICK_S = 0.1
LARGE = ("camera/image", "infra_lidar/points")


def keys_to_keep(config: BlackboxConfig) -> list[str]:
    """This host's topics (not the large ones unless asked for), its statuses, and what triggers."""
    own = [topic.key(config.host) for topic in DATA_TOPICS if config.large or topic.name not in LARGE]
    triggers = [topic.key(config.fusion_host) for topic in (FUSION_VERDICT, FUSION_HEALTH)]
    return list(dict.fromkeys([*own, f"{config.host}/*/status", *triggers]))


class BusTap:
    """Iterate it: one ``Kept`` an arrival, and None at least every tenth of a second."""

    def __init__(self, service: Service, config: BlackboxConfig) -> None:
        self._service = service
        self._queue: queue.Queue[Kept] = queue.Queue(QUEUE)
        self._subscribers = [
            service.session.declare_subscriber(key, zenoh.handlers.RingChannel(RING_PER_TOPIC))
            for key in keys_to_keep(config)
        ]
        for subscriber in self._subscribers:
            threading.Thread(target=self._receive, args=(subscriber,), name="tap", daemon=True).start()

    def __iter__(self) -> Iterator[Kept | None]:
        while True:
            try:
                yield self._queue.get(timeout=TICK_S)
            except queue.Empty:
                yield None

    def _receive(self, subscriber: Iterable[zenoh.Sample]) -> None:
        try:
            for sample in subscriber:
                try:
                    kept = Kept(str(sample.key_expr), sample.payload.to_bytes(), utc_ns(), monotonic_s())
                    self._queue.put_nowait(kept)
                except queue.Full:
                    self._service.report.dropped()
        except zenoh.ZError:
            return  # the session is closed
