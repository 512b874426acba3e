"""The shared runtime of every service: session, token, status, info, clock, publish, newest-value subscribe.

::

    with Service("radar", config) as service:
        publish = service.publisher(RADAR_TRACKS)
        for stamp_ns, frame in open_source(config, service.report):
            publish(pipeline.process(stamp_ns, frame))

Ctrl-C and SIGTERM end it alike: both raise ``KeyboardInterrupt`` in the main thread, every ``with`` closes, the token
goes away.
"""

from __future__ import annotations

import importlib.metadata
import logging
import os
import threading
import uuid
from contextlib import ExitStack
from types import TracebackType
from typing import TypeVar

import zenoh

from common import topics
from common.clock import utc_ns
from common.codec import encode, encoding_of
from common.config import ServiceConfig, config_hash
from common.messages import ClockReply, Message, ServiceInfo, ServiceStatus
from common.presence import Presence
from common.pubsub import Latest, Publisher
from common.session import close_session, open_session
from common.status import Report
from common.topics import Topic
from common.watchdog import Watchdog

log = logging.getLogger("runtime")
M = TypeVar("M", bound=Message)

STATUS_PERIOD_S = 1.0


class Service:
    """One service's presence on the bus. Use it in a ``with`` statement, from the main thread."""

    def __init__(self, name: str, config: ServiceConfig) -> None:
        self.name = name
        self.host = config.host
        self.instance = uuid.uuid4().hex[:8]
        self.report = Report(self.instance)
        self.wake = threading.Event()  # set on every arrival at any subscription of this service
        self.closed_cleanly = True
        self._config = config
        self._started_ns = utc_ns()
        self._topics: list[str] = []
        self._stop = threading.Event()
        self._stack = ExitStack()

    def __enter__(self) -> Service:
        self.session = open_session(self._config.zenoh)
        self._stack.callback(self._close)
        self._status_key = topics.status_topic(self.name).key(self.host)
        self._publish_status = self.session.declare_publisher(
            self._status_key,
            encoding=encoding_of(ServiceStatus),
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            congestion_control=zenoh.CongestionControl.DROP,
        )
        self._queryables = [
            self.session.declare_queryable(self._status_key, self._answer_status),
            self.session.declare_queryable(topics.info_key(self.host, self.name), self._answer_info),
            self.session.declare_queryable(topics.clock_key(self.host, self.name), self._answer_clock),
        ]
        self._token = self.session.liveliness().declare_token(topics.token_key(self.host, self.name, self.instance))
        self._rivals = Presence(self.session, self._check_rivals, topics.token_key(self.host, self.name, "*"))
        self._status_thread = threading.Thread(target=self._report_status, name="status", daemon=True)
        self._status_thread.start()
        return self

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
        key = topic.key(self.host)
        self._topics.append(key)
        return Publisher(self.session, topic, key, self.report)

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
            self._tell_systemd(watchdog, status)
            status.seq, status.sent_ns = seq, utc_ns()
            try:
                self._publish_status.put(encode(status))
            except zenoh.ZError:
                return  # the session is closed
            seq += 1
            self.report.changed.wait(STATUS_PERIOD_S)

    def _tell_systemd(self, watchdog: Watchdog, status: ServiceStatus) -> None:
        """Ready with the first message; alive only while the main loop goes round, whatever our threads do."""
        if status.published or status.state == "online":
            watchdog.ready(f"{status.state} {status.reason}".strip())
        if self.report.silent_s() < max(watchdog.limit_s / 2, 2 * STATUS_PERIOD_S):
            watchdog.alive()

    def _check_rivals(self, presence: Presence) -> None:
        rivals = {i for _, _, i in presence.instances()} - {self.instance}
        text = ""
        if rivals:
            text = (
                f"{self.host}/{self.name} is claimed by {len(rivals) + 1} processes: this is {self.instance}, "
                f"the other {', '.join(sorted(rivals))}; stop one of them"
            )
            log.error(text)
        self.report.conflict(text)

    def _answer_status(self, query: zenoh.Query) -> None:
        self._reply(query, self._status_key, self.report.snapshot())

    def _answer_info(self, query: zenoh.Query) -> None:
        info = ServiceInfo(
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
        )
        self._reply(query, topics.info_key(self.host, self.name), info)

    def _answer_clock(self, query: zenoh.Query) -> None:
        received_ns = utc_ns()
        asked = query.payload.to_bytes() if query.payload is not None else b""
        reply = ClockReply(
            stamp_ns=int.from_bytes(asked[:8], "little"),
            request_received_ns=received_ns,
            reply_sent_ns=utc_ns(),
        )
        self._reply(query, topics.clock_key(self.host, self.name), reply)

    def _reply(self, query: zenoh.Query, key: str, message: Message) -> None:
        with query:
            query.reply(key, encode(message), encoding=encoding_of(type(message)))
