"""The live bridge: Zenoh on one side, Foxglove's WebSocket protocol on the other."""

from __future__ import annotations

import json
import threading
from functools import partial
from typing import Any

import msgspec
import zenoh
from foxglove import Channel, Context, Schema, start_server
from foxglove.messages import CompressedImage, PointCloud
from foxglove.websocket import ServerListener

from common.bus.session import pass_on_samples, undeclare
from common.clock import utc_ns
from common.codec import DecodeError, decode, to_builtins
from common.messages import Message
from common.recording.foxglove import convert, static_transforms
from common.recording.schemas import json_schema, schema_name
from common.topics import CAMERA_IMAGE, DATA_TOPICS, INFRA_POINTS, find_topic, service_row, status_topic

BACKLOG = 256  # messages that wait for a slow Foxglove before the oldest is dropped
RING = 32
TRANSFORM_PERIOD_S = 1.0
# On-demand topics that Foxglove can draw: their channels are there before anything has come, so that one can ask.
OFFERED = {CAMERA_IMAGE: CompressedImage, INFRA_POINTS: PointCloud}
TOO_LARGE_AS_JSON = ("LaserScan", "RadarDetections", "PointCloud", "CompressedImage", "FusionTrace")


class Bridge(ServerListener):
    """Channels appear with the first message of a key; on-demand topics are subscribed to while a client looks."""

    def __init__(self, session: zenoh.Session, address: str, port: int) -> None:
        self._session = session
        self._lock = threading.Lock()  # of the channels
        self._looking = threading.Lock()  # of the lookers: a callback must never wait for a channel being made
        self._channels: dict[str, Channel] = {}
        self._lookers: dict[str, int] = {}
        self._on_demand: dict[str, zenoh.Subscriber] = {}
        self._stop = threading.Event()
        self.undecodable = 0
        self._context = Context()
        self._server = start_server(
            name="spotter", host=address, port=port, server_listener=self, context=self._context,
            message_backlog_size=BACKLOG,
        )  # fmt: skip
        self.port = self._server.port
        always = [topic for topic in DATA_TOPICS if not topic.on_demand] + [status_topic("*")]
        self._subscribers = [self._subscribe(topic.any_host) for topic in always]
        for topic, kind in OFFERED.items():
            self._own_channel(f"/foxglove/{topic.key(service_row(topic.service).host)}", kind)
        threading.Thread(target=self._repeat_transforms, name="transforms", daemon=True).start()

    def close(self) -> None:
        self._stop.set()
        for subscriber in (*self._subscribers, *self._on_demand.values()):
            undeclare(subscriber)
        self._server.stop()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self._look(channel.topic, +1)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        self._look(channel.topic, -1)

    def _look(self, name: str, lookers: int) -> None:
        """The first looker of an on-demand topic subscribes on the bus, the last one unsubscribes."""
        key = name.removeprefix("/foxglove/")
        topic = find_topic(key)
        if topic is None or not topic.on_demand:
            return
        with self._looking:
            count = self._lookers[key] = max(0, self._lookers.get(key, 0) + lookers)
            gone = self._on_demand.pop(key, None) if not count else None
            if count and key not in self._on_demand:
                self._on_demand[key] = self._subscribe(key)
        if gone is not None:
            undeclare(gone)

    def _subscribe(self, key: str) -> zenoh.Subscriber:
        subscriber = self._session.declare_subscriber(key, zenoh.handlers.RingChannel(RING))
        feed = partial(pass_on_samples, subscriber, self._pass_on)
        threading.Thread(target=feed, name=f"bridge {key}", daemon=True).start()
        return subscriber

    def _pass_on(self, key: str, payload: bytes) -> None:
        topic = find_topic(key)
        if topic is None:
            return
        try:
            message = decode(payload, topic.message, topic.max_bytes)
        except DecodeError:
            self.undecodable += 1
            return
        for name, converted in convert(key, message):
            self._log_own(name, converted, message.stamp_ns)
        if type(message).__name__ not in TOO_LARGE_AS_JSON:
            channel = self._json_channel(f"/{key}", type(message))
            channel.log(msgspec.json.encode(to_builtins(message)), log_time=message.stamp_ns)

    def _log_own(self, name: str, converted: Any, stamp_ns: int) -> None:
        self._own_channel(name, type(converted)).log(converted.encode(), log_time=stamp_ns)

    def _own_channel(self, name: str, kind: Any) -> Channel:
        """A channel of one of Foxglove's own schemas."""
        with self._lock:
            if name not in self._channels:
                self._channels[name] = Channel(
                    name, schema=kind.get_schema(), message_encoding="protobuf", context=self._context
                )
            return self._channels[name]

    def _json_channel(self, name: str, message_type: type[Message]) -> Channel:
        """A channel with our own fields, for plots and raw views."""
        with self._lock:
            if name not in self._channels:
                schema = Schema(name=schema_name(message_type), encoding="jsonschema", data=flat_schema(message_type))
                self._channels[name] = Channel(name, schema=schema, message_encoding="json", context=self._context)
            return self._channels[name]

    def _repeat_transforms(self) -> None:
        """Foxglove keeps no old transforms for a client that comes later."""
        while True:
            now_ns = utc_ns()
            for transform in static_transforms(now_ns):
                self._log_own("/tf", transform, now_ns)
            if self._stop.wait(TRANSFORM_PERIOD_S):
                return


def flat_schema(message_type: type[Message]) -> bytes:
    """The JSON schema with the message itself at its root: Foxglove wants an object there, not a reference."""
    schema = json.loads(json_schema(message_type))
    root = schema["$defs"][message_type.__name__]
    return json.dumps({**root, "$defs": schema["$defs"]}).encode()
