"""Reads one topic: the valid messages, and a sentence on why there are none.

It subscribes to the topic under every type and hash, to distinguish a wrong type from silence.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import zenoh

from common.bus.session import close_session, open_session
from common.bus.status import Report
from common.clock import monotonic_s, utc_ns
from common.config import ZenohConfig
from common.ros2.graph import Graph
from common.ros2.keys import SENSOR_DATA, attachment_of, topic_key, type_and_hash
from common.ros2.node import Node
from common.ros2.source import RosTopic
from common.ros2.stamps import BEHIND_NS, StampError, measured_ns
from common.ros2.types import CdrError, from_cdr, ns_of, type_hash

log = logging.getLogger(__name__)

SILENCE_S = 1.0
WAITING = 2  # messages; older ones are dropped: a late measurement is worth less than the next


@dataclass(frozen=True)
class Arrived:
    """A message as it came."""

    stamp_ns: int  # UTC, of the measurement
    received_ns: int  # UTC
    message: Any  # of the topic's type


@dataclass
class _Sequences:
    """Counts what is missing between the messages of each publisher."""

    last: dict[bytes, int] = field(default_factory=dict)

    def missing(self, gid: bytes, sequence: int) -> int:
        before = self.last.get(gid)
        self.last[gid] = sequence
        return max(0, sequence - before - 1) if before is not None else 0


class TopicReader:
    """A subscription with a session of its own; use it in a ``with`` statement.

    name: of our node in the graph. waiting: how many messages may wait until they are taken.
    """

    def __init__(self, topic: RosTopic, config: ZenohConfig, report: Report, name: str, waiting: int = WAITING) -> None:
        self.topic, self._report = topic, report
        self._hash = type_hash(topic.type)
        self._config, self._name = config, name
        self._queue: queue.Queue[tuple[int, bytes]] = queue.Queue(waiting)
        self._sequences = _Sequences()
        self._refused = ""  # why the newest message was refused; "" after a good one
        self._newest_ns = 0
        self._lock = threading.Lock()

    def __enter__(self) -> TopicReader:
        self._session = self._opened()
        self.graph = Graph(self._session, self.topic.domain)
        key = topic_key(self.topic.domain, self.topic.name)
        self._subscriber = self._session.declare_subscriber(key, self._take_in)
        node = Node(self._session, self._name, self.topic.domain)
        node.announce("MS", self.topic.name, self.topic.type, SENSOR_DATA)
        self._node = node
        return self

    def _opened(self) -> zenoh.Session:
        """The session; until a router answers, the report says that it is waited for."""
        router = ", ".join(self._config.connect) or "(no endpoint)"
        while True:
            try:
                return open_session(self._config, give_up_after_s=SILENCE_S)
            except ConnectionError:
                why = f"ROS topic {self.topic.name}: no router answers at {router}; is the ROS machine's running?"
                self._report.state("disconnected", why)

    def __exit__(self, *_: object) -> None:
        close_session(self._session)

    def next(self, timeout_s: float) -> Arrived | None:
        """The next message that can be used; None if none comes within ``timeout_s``."""
        deadline_s = monotonic_s() + timeout_s
        while True:
            try:
                received_ns, payload = self._queue.get(timeout=max(0.0, deadline_s - monotonic_s()))
            except queue.Empty:
                return None
            arrived = self._read(received_ns, payload)
            if arrived is not None:
                return arrived

    def messages(self, stop: threading.Event | None = None) -> Iterator[Arrived]:
        """Messages as they come, without end; while there are no valid ones, the report says why."""
        since_s = monotonic_s()
        while not (stop and stop.is_set()):
            arrived = self.next(max(0.0, since_s + SILENCE_S - monotonic_s()))
            if arrived is not None:
                yield arrived
                with self._lock:
                    used = not self._refused
                since_s = monotonic_s() if used else since_s
            if monotonic_s() - since_s >= SILENCE_S:
                self._report.state("disconnected", self.why_nothing())
                since_s = monotonic_s()

    def why_nothing(self) -> str:
        """A sentence for people: no publisher, another type or definition, a wrong stamp, or silence."""
        with self._lock:
            refused = self._refused
        return f"ROS topic {self.topic.name}: {refused or self.graph.why_silent(self.topic, self._hash)}"

    def refuse(self, why: str, counted: str = "") -> None:
        """The newest message could not be used: by this reader, or by its caller. "" = it is counted already."""
        with self._lock:
            if why != self._refused:
                log.warning("ROS topic %s: %s", self.topic.name, why)
            self._refused = why
        if counted:
            self._report.bad_input(counted)

    def _take_in(self, sample: zenoh.Sample) -> None:
        """In Zenoh's thread: keep the newest messages of our type."""
        if sample.kind != zenoh.SampleKind.PUT:
            return
        received_ns = utc_ns()
        type_, hash_ = type_and_hash(str(sample.key_expr))
        if type_ != self.topic.type:
            self.refuse(f"carries {type_}, expected {self.topic.type}", "message of another type")
            return
        if hash_ != self._hash and not self.topic.any_hash:
            why = f"carries another definition of {type_} ({hash_[:15]}) than ours ({self._hash[:15]}): "
            self.refuse(f"{why}another ROS distribution? ?hash=any takes it as it is", "message of another definition")
            return
        attachment = attachment_of(sample.attachment.to_bytes()) if sample.attachment is not None else None
        if attachment is not None:
            self._report.count("message lost", self._sequences.missing(attachment.gid, attachment.sequence))
        if self._queue.full():
            try:
                self._queue.get_nowait()
                self._report.dropped()
            except queue.Empty:  # taken at this very moment
                pass
        self._queue.put_nowait((received_ns, sample.payload.to_bytes()))

    def _read(self, received_ns: int, payload: bytes) -> Arrived | None:
        try:
            message = from_cdr(payload, self.topic.type)
            head = getattr(message, "header", None)  # a packet of an Ouster has none: it is dated by arrival
            stamp_ns = measured_ns(ns_of(head.stamp), received_ns, self.topic.stamp) if head else received_ns
        except (CdrError, StampError) as error:
            self.refuse(str(error), "wrong stamp" if isinstance(error, StampError) else "undecodable message")
            return None
        if head and self._newest_ns - BEHIND_NS < stamp_ns <= self._newest_ns:  # farther back: the clocks were set
            self._report.bad_input("message repeated or out of order")
            return None
        self._newest_ns = stamp_ns
        with self._lock:
            self._refused = ""
        return Arrived(stamp_ns, received_ns, message)
