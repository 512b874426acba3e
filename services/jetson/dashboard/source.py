"""What the page shows, from the bus: the newest value of every topic; the large ones only while somebody looks."""

from __future__ import annotations

import threading
from types import TracebackType

from common.bus.pubsub import Latest
from common.bus.runtime import Service
from common.messages import Message
from common.topics import DATA_TOPICS, Topic, status_topic
from services.jetson.dashboard.board import Board
from services.jetson.dashboard.config import DashboardConfig

WAIT_S = 0.5


class BoardSource:
    """Feeds a board from Zenoh in a thread of its own. Use it in a ``with`` statement.

    Of fusion only ``config.fusion_host`` is shown, and nothing of the hosts of other vehicles.
    """

    def __init__(self, service: Service, board: Board, config: DashboardConfig) -> None:
        self._service = service
        self._board = board
        self._fusion_host = config.fusion_host
        self._others = frozenset(config.other_hosts)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._viewers: dict[str, int] = {}
        self._inboxes: dict[str, Latest[Message]] = {}
        for topic in (*DATA_TOPICS, status_topic("*")):
            if not topic.on_demand:
                self._inboxes[topic.name] = self._subscribe(topic)
        self._thread = threading.Thread(target=self._feed, name="board", daemon=True)

    def __enter__(self) -> BoardSource:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        self._service.wake.set()
        self._thread.join(1.0)

    def view(self, product: str, viewers: int) -> None:
        """Count clients that look at an on-demand topic; the first subscribes, the last unsubscribes."""
        topic = next((t for t in DATA_TOPICS if t.on_demand and t.name == product), None)
        if topic is None:
            return
        with self._lock:
            count = self._viewers.get(product, 0) + viewers
            self._viewers[product] = count
            if count > 0 and product not in self._inboxes:
                self._inboxes[product] = self._subscribe(topic)
            elif count <= 0 and product in self._inboxes:
                self._inboxes.pop(product).close()

    def _subscribe(self, topic: Topic) -> Latest[Message]:
        return self._service.latest(topic, topic.message, self._fusion_host if topic.service == "fusion" else "*")

    def _feed(self) -> None:
        while not self._stop.is_set():
            self._service.wake.wait(WAIT_S)
            self._service.wake.clear()
            with self._lock:
                inboxes = list(self._inboxes.values())
            for inbox in inboxes:
                for received in inbox.take():
                    if received.key.partition("/")[0] in self._others:
                        continue
                    self._board.put(received.key, received.message, received.arrived_s)
