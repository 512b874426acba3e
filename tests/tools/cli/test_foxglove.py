"""The live bridge, asked by a plain WebSocket client that speaks Foxglove's protocol."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as open_socket

from common import topics
from common.bus.runtime import Service
from common.config import ServiceConfig, ZenohConfig
from common.messages import CompressedImage, LidarZones
from spotter_tools.cli.connect import bus

pytestmark = pytest.mark.patient

bridge = pytest.importorskip("spotter_tools.cli.foxglove_bridge", reason="needs the extra foxglove")

Until = Callable[[Callable[[], object]], None]


class Viewer:
    """Knows the channels that are advertised; reads what it has subscribed to."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.channels: dict[str, dict[str, Any]] = {}
        self._names: dict[int, str] = {}
        self._wishes: dict[int, dict[str, int]] = {}

    def until_offered(self, *names: str) -> None:
        while not set(names) <= set(self.channels):
            self._hear(self._socket.recv(timeout=20))

    def subscribe(self, name: str) -> None:
        number = len(self._names) + 1
        self._names[number] = name
        wish = {"id": number, "channelId": self.channels[name]["id"]}
        self._wishes[wish["channelId"]] = wish
        self._ask(wish)

    def _ask(self, wish: dict[str, int]) -> None:
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": [wish]}))

    def unsubscribe(self, name: str) -> None:
        (number,) = [number for number, known in self._names.items() if known == name]
        self._socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [number]}))

    def next(self) -> tuple[str, int, bytes]:
        """Channel, log time and content of the next message."""
        while True:
            frame = self._socket.recv(timeout=20)
            if isinstance(frame, bytes) and frame[0] == 1:
                number, stamp_ns = struct.unpack_from("<IQ", frame, 1)
                return self._names[number], stamp_ns, frame[13:]
            self._hear(frame)

    def _hear(self, frame: str | bytes) -> None:
        if not isinstance(frame, str):
            return
        message = json.loads(frame)
        if message["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in message["channels"]}
        elif message["op"] == "status" and (
            unknown := re.search(r"unknown channel\D*(\d+)", message["message"], re.IGNORECASE)
        ):
            self._ask(self._wishes[int(unknown[1])])  # the server offers a channel a moment before it knows it


@contextmanager
def viewer_of(endpoint: str) -> Iterator[Viewer]:
    with bus(endpoint, "spotter") as session:
        server = bridge.Bridge(session, "127.0.0.1", 0)
        try:
            with open_socket(f"ws://127.0.0.1:{server.port}", subprotocols=["foxglove.sdk.v1"]) as socket:  # type: ignore[list-item]
                yield Viewer(socket)
        finally:
            server.close()


def test_a_viewer_sees_our_fields_and_foxgloves_own(speaking: str) -> None:
    with viewer_of(speaking) as viewer:
        scene, raw = "/foxglove/pi0/radar/tracks", "/jetson0/fusion/verdict"
        viewer.until_offered(scene, raw, "/tf", "/foxglove/jetson0/camera/image")
        assert viewer.channels[scene]["schemaName"] == "foxglove.SceneUpdate"
        assert viewer.channels[scene]["encoding"] == "protobuf"
        assert json.loads(viewer.channels[raw]["schema"])["type"] == "object"
        viewer.subscribe(raw)
        viewer.subscribe(scene)
        seen: dict[str, bytes] = {}
        while len(seen) < 2:
            name, stamp_ns, content = viewer.next()
            assert stamp_ns > 1_700_000_000_000_000_000
            seen[name] = content
    verdict = json.loads(seen[raw])
    assert (verdict["level"], verdict["inputs"]["lidar"]["used"]) == ("CAUTION", True)
    assert b"radar-1" in seen[scene]


def test_pictures_are_asked_for_only_while_somebody_looks(zenoh_config: ZenohConfig, until: Until) -> None:
    name = "/foxglove/jetson0/camera/image"
    picture = CompressedImage(stamp_ns=1_800_000_000_000_000_000, format="jpeg", data=b"a picture")
    with Service("camera", ServiceConfig(host="jetson0", zenoh=zenoh_config)) as camera:
        publish = camera.publisher(topics.CAMERA_IMAGE)
        with viewer_of(zenoh_config.connect[0]) as viewer:
            viewer.until_offered(name)
            assert not publish.wanted
            viewer.subscribe(name)
            until(lambda: publish.wanted)
            publish(picture)
            assert b"a picture" in viewer.next()[2]
            viewer.unsubscribe(name)
            until(lambda: not publish.wanted)
            viewer.subscribe(name)
            until(lambda: publish.wanted)
        until(lambda: not publish.wanted)


def test_nonsense_on_the_bus_is_counted(zenoh_config: ZenohConfig, until: Until) -> None:
    with bus(zenoh_config.connect[0], "spotter") as session, bus(zenoh_config.connect[0], "spotter") as other:
        server = bridge.Bridge(session, "127.0.0.1", 0)

        def counted() -> bool:
            other.put("jetson0/fusion/verdict", b"nonsense")
            return bool(server.undecodable)

        until(counted)
        server.close()


def test_every_schema_has_an_object_at_its_root() -> None:
    schema = json.loads(bridge.flat_schema(LidarZones))
    assert schema["type"] == "object"
    assert {"left", "centre", "right", "level"} <= set(schema["properties"])
    assert "LidarZone" in schema["$defs"]
