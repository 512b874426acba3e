"""Our bus on one side, a ROS domain on the other. Topics without a ROS subscriber are not subscribed to on the bus."""

from __future__ import annotations

import struct
import threading
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import zenoh

from common import messages as m
from common.bus.session import pass_on_samples, undeclare
from common.clock import utc_ns
from common.codec import DecodeError, decode
from common.ros2.keys import RosNameError, topic_name
from common.ros2.node import Node, RosPublisher
from common.topics import info_key, status_topic
from spotter_tools.ros2.geometry import FrameError
from spotter_tools.ros2.table import LATCHED, TF_STATIC, Row
from spotter_tools.ros2.transforms import TF, sensor_transform

RING = 8
LOOK_S = 0.2  # how often subscribers are looked for
STATIC_EVERY = 5  # looks: transforms of the sensors are said again, for tools that keep none
INFO_TIMEOUT_S = 1.0


@dataclass
class Line:
    """One of our topics as one ROS topic."""

    row: Row
    host: str
    publish: RosPublisher
    name: str
    key: str
    kind: str
    subscriber: Any = field(default=None)
    sent: int = 0


class Bridge:
    """Finds the services of a site by their status, offers their ROS topics, and fills those that are listened to.

    Args:
        session: of the site's namespace.
        node: in ROS, on a session without a namespace.
        rows: what is offered.
        sensors: whether the places of the vehicle's sensors are said on /tf_static.
    """

    def __init__(self, session: zenoh.Session, node: Node, rows: tuple[Row, ...], sensors: bool) -> None:
        self._session, self._node, self._rows = session, node, rows
        self._static = node.publisher(TF_STATIC, TF, LATCHED) if sensors else None
        self._transforms: dict[str, Any] = {}  # by service; None = it does not say where it sits
        self._lines: dict[tuple[str, str], Line] = {}  # by ROS topic and our key
        self._waiting: dict[tuple[str, str], m.ServiceStatus] = {}  # by host and service: seen, not yet offered
        self._lock = threading.Lock()
        self.refused: dict[str, int] = {}  # what was not published, and why
        self._statuses = session.declare_subscriber(status_topic("*").any_host, self._on_status)

    def lines(self) -> list[Line]:
        """What is offered, in the order of the ROS topics."""
        return [line for _, line in sorted(self._lines.items(), key=lambda one: one[0])]

    def run(self, stop: threading.Event) -> None:
        """Offer and look until ``stop`` is set."""
        looks = 0
        while not stop.is_set():
            for (host, service), status in self._taken():
                self._offer(host, service, status)
            for line in self._lines.values():
                self._look(line)
            if self._static is not None and looks % STATIC_EVERY == 0 and self._transforms:
                for transform in filter(None, self._transforms.values()):
                    self._static(transform)
            looks += 1
            stop.wait(LOOK_S)

    def close(self) -> None:
        """Unsubscribe; the sessions stay open."""
        undeclare(self._statuses)
        for line in self._lines.values():
            if line.subscriber is not None:
                undeclare(line.subscriber)

    def _on_status(self, sample: zenoh.Sample) -> None:
        host, service, _ = str(sample.key_expr).split("/")
        try:
            status = decode(sample.payload.to_bytes(), m.ServiceStatus)
        except DecodeError:
            return
        with self._lock:
            self._waiting[host, service] = status

    def _taken(self) -> list[tuple[tuple[str, str], m.ServiceStatus]]:
        with self._lock:
            waiting, self._waiting = self._waiting, {}
        return sorted(waiting.items(), key=lambda one: one[0])

    def _offer(self, host: str, service: str, status: m.ServiceStatus) -> None:
        for row in self._rows:
            name = row.name(host, status.source_kind)
            place = name, row.topic.key(host)
            if row.topic.service != service or place in self._lines:
                continue
            try:
                publisher = self._node.publisher(topic_name(name), row.type, row.qos)
            except RosNameError as error:
                self._refuse(str(error))
                continue
            self._lines[place] = Line(row, host, publisher, *place, status.source_kind)
        if self._static is not None and service not in self._transforms and status.source_kind == "live":
            self._place(host, service)

    def _place(self, host: str, service: str) -> None:
        """Ask a sensor's service where it sits."""
        for reply in self._session.get(info_key(host, service), timeout=INFO_TIMEOUT_S):
            if reply.ok is None:
                continue
            try:
                info = decode(reply.ok.payload.to_bytes(), m.ServiceInfo)
            except DecodeError:
                continue
            self._transforms[service] = sensor_transform(service, info.config, utc_ns())

    def _look(self, line: Line) -> None:
        """Subscribe on the bus while there is a ROS subscriber."""
        if line.publish.wanted and line.subscriber is None:
            line.subscriber = self._session.declare_subscriber(line.key, zenoh.handlers.RingChannel(RING))
            feed = partial(pass_on_samples, line.subscriber, partial(self._pass_on, line))
            threading.Thread(target=feed, name=line.name, daemon=True).start()
        elif not line.publish.wanted and line.subscriber is not None:
            gone, line.subscriber = line.subscriber, None
            undeclare(gone)

    def _pass_on(self, line: Line, _key: str, payload: bytes) -> None:
        try:
            message = decode(payload, line.row.topic.message, line.row.topic.max_bytes)
        except DecodeError:
            self._refuse(f"{line.key}: not decodable")
            return
        if not line.row.says_itself and message.source_kind != line.kind:
            self._refuse(f"{line.key}: {message.source_kind} data under a name for {line.kind} ones")
            return
        try:
            mapped = line.row.map(message, line.host)
            if mapped is not None:
                line.publish(mapped)
                line.sent += 1
        except FrameError as error:
            self._refuse(f"{line.key}: {error}")
        except (struct.error, ValueError, ArithmeticError):  # a stamp or a number that its 32 bits do not hold
            self._refuse(f"{line.key}: not sayable in ROS")

    def _refuse(self, why: str) -> None:
        with self._lock:
            self.refused[why] = self.refused.get(why, 0) + 1
