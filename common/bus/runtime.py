"""The shared runtime of every service: session, token, status, info, clock, publish, newest-value subscribe.

::

    with Service("radar", config) as service:
        publish = service.publisher(RADAR_TRACKS)
        for stamp_ns, frame in open_source(config, service.report):
            publish(pipeline.process(stamp_ns, frame))

Ctrl-C and SIGTERM both raise ``KeyboardInterrupt`` in the main thread: every ``with`` closes, and the token is removed.
"""

from __future__ import annotations

import importlib.metadata
import logging
import os
import threading
import uuid
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from types import TracebackType
from typing import TypeVar

import zenoh

from common import topics
from common.bus.handover import Handover
from common.bus.presence import AFTER, Presence, claimants, successor
from common.bus.pubsub import Latest, Publisher
from common.bus.session import close_session, open_session
from common.bus.status import Report
from common.bus.watchdog import Watchdog
from common.clock import monotonic_s, utc_ns
from common.codec import encode_for_readers, encoding_of
from common.config import ServiceConfig, config_hash, public
from common.messages import ClockReply, Message, ServiceInfo, ServiceStatus
from common.source_url import source_kind
from common.topics import Topic

log = logging.getLogger("runtime")
M = TypeVar("M", bound=Message)

STATUS_PERIOD_S = 1.0
HANDOVER_BUDGET_S = 15.0  # after a handover, until the old instance has to be gone


class Service:
    """A service on the bus. Use it in a ``with`` statement, from the main thread."""

    def __init__(self, name: str, config: ServiceConfig) -> None:
        self.name = name
        self.host = config.host
        self._handover = Handover()
        self._live_since_s: float | None = None  # after a handover, until the old one is known to be gone
        self.instance = uuid.uuid4().hex[:8]
        if self._handover.succeeds:
            self.instance = successor(self.instance, self._handover.succeeds)
        self.report = Report(self.instance, source_kind(config.source))
        self.wake = threading.Event()  # set on every arrival at any subscription of this service
        self.closed_cleanly = True
        self._config = config
        self._started_ns = utc_ns()
        self._topics: list[str] = []
        self._publishers: dict[str, Publisher] = {}
        self._queryables: list[zenoh.Queryable] = []
        self._tokens: list[zenoh.LivelinessToken] = []
        self._stop = threading.Event()
        self._stack = ExitStack()

    def __enter__(self) -> Service:
        self.session = open_session(self._config.zenoh)
        self._stack.callback(self._close)
        self._announce()
        if not self._handover.prefix:
            self._claim()
        self._handover.when_promoted(self._go_live)
        self._status_thread = threading.Thread(target=self._report_status, name="status", daemon=True)
        self._status_thread.start()
        return self

    def _announce(self) -> None:
        """Declares status, info and clock under the current keys; the shadow declarations stay until exit."""
        self._publish_status = self.session.declare_publisher(
            self._key("status"),
            encoding=encoding_of(ServiceStatus),
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            congestion_control=zenoh.CongestionControl.DROP,
        )
        for last, answer in (("status", self._status), ("info", self._info), ("clock", self._clock)):
            key = self._key(last)
            self._queryables.append(self.session.declare_queryable(key, partial(_reply, key, answer)))
        self._tokens.append(self.session.liveliness().declare_token(self._key(f"alive/{self.instance}")))

    def _claim(self) -> None:
        """Watch for other instances of this service; not done in the shadow."""
        self._rivals = Presence(self.session, self._check_rivals, topics.token_key(self.host, self.name, "*"))

    def _go_live(self) -> None:
        """From the shadow to the live keys: data first, then the token, so that no reader waits for data."""
        moved = [(publisher, publisher.move(self._key(product))) for product, publisher in self._publishers.items()]
        for publisher, sent in moved:
            if publisher.decided_on:
                sent.wait()
        self._announce()
        self._claim()
        self._live_since_s = monotonic_s()
        log.info("live, in the place of %s", self._handover.succeeds)

    def _key(self, last: str) -> str:
        return f"{self._handover.prefix}{self.host}/{self.name}/{last}"

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.close()

    def publisher(self, topic: Topic) -> Publisher:
        """A publisher for one of this service's own topics.

        Raises:
            ValueError: the topic belongs to another service.
        """
        if topic.service != self.name:
            raise ValueError(f"service {self.name} may not publish {topic.name}")
        self._topics.append(topic.key(self.host))
        publisher = Publisher(self.session, topic, self._key(topic.product), self.report)
        self._publishers[topic.product] = publisher
        return publisher

    def latest(self, topic: Topic, message_type: type[M], host: str, wake: threading.Event | None = None) -> Latest[M]:
        """The newest value of a topic on one host, or on every host with ``"*"``."""
        return Latest(self.session, topic, message_type, topic.key(host), self.report, wake or self.wake)

    def _close(self) -> None:
        self._stop.set()
        self.report.changed.set()
        self._status_thread.join(0.3)
        self.closed_cleanly = close_session(self.session)

    def _report_status(self) -> None:
        seq, watchdog = 0, Watchdog(self.name)
        while not self._stop.is_set():
            self.report.changed.clear()
            status = self.report.snapshot()
            self._feed_watchdog(watchdog, status)
            self._check_predecessor()
            status.seq, status.sent_ns = seq, utc_ns()
            try:
                self._publish_status.put(encode_for_readers(status)[0])
            except zenoh.ZError:
                return  # the session is closed
            seq += 1
            self.report.changed.wait(STATUS_PERIOD_S)

    def _feed_watchdog(self, watchdog: Watchdog, status: ServiceStatus) -> None:
        """Ready with the first message. Watchdog is fed only while the main loop makes progress."""
        if status.published or status.state == "online":
            watchdog.ready(f"{status.state} {status.reason}".strip())
        if self.report.silent_s() < max(watchdog.limit_s / 2, 2 * STATUS_PERIOD_S):
            watchdog.alive()

    def _check_predecessor(self) -> None:
        """Two instances are tolerated for HANDOVER_BUDGET_S after a handover, then reported."""
        if self._live_since_s is None or monotonic_s() - self._live_since_s < HANDOVER_BUDGET_S:
            return
        old = [i for _, _, i in self._rivals.instances() if i.partition(AFTER)[0] == self._handover.succeeds]
        self.report.conflict(f"{self.name} {old[0]} was to be stopped when this one took over; stop it" if old else "")
        self._live_since_s = monotonic_s() if old else None

    def _check_rivals(self, presence: Presence) -> None:
        present = {i for _, _, i in presence.instances()} | {self.instance}
        rivals = claimants(present) - {self.instance}
        text = ""
        if rivals and self.instance in claimants(present):  # a process with an announced successor is about to end
            text = (
                f"{self.host}/{self.name} is claimed by {len(rivals) + 1} processes: this is {self.instance}, "
                f"the other {', '.join(sorted(rivals))}; stop one of them"
            )
            log.error(text)
        self.report.conflict(text)

    def _status(self, query: zenoh.Query) -> ServiceStatus:
        return self.report.snapshot()

    def _info(self, query: zenoh.Query) -> ServiceInfo:
        return ServiceInfo(
            stamp_ns=utc_ns(),
            service=self.name,
            host=self.host,
            instance=self.instance,
            version=importlib.metadata.version("spotter"),
            config_hash=config_hash(self._config),
            topics=self._topics,
            started_ns=self._started_ns,
            pid=os.getpid(),
            source=self._config.source,
            source_kind=self.report.source_kind,
            config=public(self._config),
        )

    def _clock(self, query: zenoh.Query) -> ClockReply:
        received_ns = utc_ns()
        asked = query.payload.to_bytes() if query.payload is not None else b""
        return ClockReply(
            stamp_ns=int.from_bytes(asked[:8], "little"),
            request_received_ns=received_ns,
            reply_sent_ns=utc_ns(),
        )


def _reply(key: str, answer: Callable[[zenoh.Query], Message], query: zenoh.Query) -> None:
    with query:
        message = answer(query)
        query.reply(key, encode_for_readers(message)[0], encoding=encoding_of(type(message)))
