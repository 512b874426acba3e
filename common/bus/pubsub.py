"""Typed publishers and newest-value subscribers. Policy comes from the topics table."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import zenoh

from common.bus.session import undeclare
from common.bus.status import Report
from common.clock import monotonic_s, utc_ns
from common.codec import DecodeError, EncodeError, decode, encode_for_readers, encoding_of
from common.messages import Message
from common.topics import Topic

log = logging.getLogger("publisher")
M = TypeVar("M", bound=Message)

_PRIORITY = {
    "real_time": zenoh.Priority.REAL_TIME,
    "interactive_high": zenoh.Priority.INTERACTIVE_HIGH,
    "data_high": zenoh.Priority.DATA_HIGH,
    "data": zenoh.Priority.DATA,
    "data_low": zenoh.Priority.DATA_LOW,
    "background": zenoh.Priority.BACKGROUND,
}
_CONGESTION = {
    "drop": zenoh.CongestionControl.DROP,
    "block_first": zenoh.CongestionControl.BLOCK_FIRST,
}
_RING_FOR_WILDCARD = 64


class Publisher:
    """Call it with a message: it adds sequence number and sending time, encodes, checks as a reader would, and sends.

    Out-of-range values are clipped (``common/mend.py``); what cannot be clipped is not sent. Both are counted.
    """

    def __init__(self, session: zenoh.Session, topic: Topic, key: str, report: Report) -> None:
        self._session = session
        self._topic = topic
        self._report = report
        self._seq = 0
        self._out = self._declare(key)

    def _declare(self, key: str) -> tuple[zenoh.Publisher, threading.Event]:
        publisher = self._session.declare_publisher(
            key,
            encoding=encoding_of(self._topic.message),
            priority=_PRIORITY[self._topic.priority],
            congestion_control=_CONGESTION[self._topic.congestion],
        )
        return publisher, threading.Event()

    def move(self, key: str) -> threading.Event:
        """Publish under another key from the next message on; the event is set once that message was sent."""
        self._out = self._declare(key)  # one assignment: the thread that publishes sees either the old or the new
        return self._out[1]

    @property
    def decided_on(self) -> bool:
        """True if consumers act on this topic, which means that it has an age limit."""
        return self._topic.age_limit_s is not None

    @property
    def wanted(self) -> bool:
        """False for an on-demand topic without subscribers: its messages need not be made."""
        return self.has_subscribers if self._topic.on_demand else True

    @property
    def has_subscribers(self) -> bool:
        """True while a subscriber matches."""
        status: Any = self._out[0].matching_status  # the object itself is always true, unlike what its stub says
        return bool(status.matching)

    def __call__(self, message: Message) -> None:
        if not isinstance(message, self._topic.message):
            raise TypeError(f"{self._topic.name} carries {self._topic.message.__name__}, got {type(message).__name__}")
        message.seq = self._seq
        message.sent_ns = utc_ns()
        if self._report.source_kind != "unknown":
            message.source_kind = self._report.source_kind
        publisher, sent = self._out
        try:
            payload, mended = encode_for_readers(message)
        except EncodeError as error:
            log.error("not sent: %s", error)
            self._report.bad_input(f"unsendable {self._topic.name}")
            self._report.state("degraded", f"{self._topic.name} not sent: {error}"[:2000])
            return
        if mended:
            self._report.count(f"mended {self._topic.name}")
        publisher.put(payload)
        sent.set()
        self._seq += 1
        self._report.published(message, primary=self.decided_on)


@dataclass(frozen=True)
class Received(Generic[M]):
    """A message with its key and its arrival time on the reader's own clocks."""

    key: str
    message: M
    arrived_s: float  # monotonic
    arrived_ns: int  # UTC, for transport times only


class Latest(Generic[M]):
    """Newest value per key: a slow reader skips messages. Decoding happens in ``take``, in the reader's thread.

    ``wake`` is set on every arrival, so that one loop can wait for several subscriptions.
    """

    def __init__(
        self,
        session: zenoh.Session,
        topic: Topic,
        message_type: type[M],
        key_expr: str,
        report: Report,
        wake: threading.Event,
    ) -> None:
        self._topic = topic
        self._type = message_type
        self._report = report
        self._wake = wake
        self._lock = threading.Lock()
        self._newest: dict[str, tuple[zenoh.Sample, float, int]] = {}
        self.refused: dict[str, str] = {}  # by key: the error of each message that the last ``take`` refused
        ring = _RING_FOR_WILDCARD if "*" in key_expr else 1
        self._subscriber = session.declare_subscriber(key_expr, zenoh.handlers.RingChannel(ring))
        self._thread = threading.Thread(target=self._receive, name=f"latest {topic.name}", daemon=True)
        self._thread.start()

    def take(self) -> list[Received[M]]:
        """What has arrived since the last call, at most one message per key; undecodable ones are counted."""
        with self._lock:
            newest, self._newest = self._newest, {}
        self.refused = {}
        taken: list[Received[M]] = []
        for key, (sample, arrived_s, arrived_ns) in newest.items():
            try:
                message = decode(sample.payload.to_bytes(), self._type, self._topic.max_bytes)
            except DecodeError as error:
                # Count by topic, not by error text: with texts a sender could fill our memory.
                self._report.bad_input(f"undecodable {self._topic.name}")
                self.refused[key] = str(error)
                continue
            taken.append(Received(key, message, arrived_s, arrived_ns))
        return taken

    def close(self) -> None:
        """End the subscription."""
        undeclare(self._subscriber)

    def _receive(self) -> None:
        try:
            for sample in self._subscriber:
                if sample.kind != zenoh.SampleKind.PUT:
                    continue
                arrival = (sample, monotonic_s(), utc_ns())
                with self._lock:
                    self._newest[str(sample.key_expr)] = arrival
                self._wake.set()
        except zenoh.ZError:
            return  # the session is closed
