"""The page's connection when its server vanishes without a word, and what it says before it has heard of everything."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from common import topics
from common.bus.runtime import Service
from common.clock import utc_ns
from common.config import ServiceConfig, ZenohConfig
from common.messages import CameraDetections, CompressedImage
from tests.jetson.dashboard.speaking_fusion import Fusion

pytestmark = [pytest.mark.system, pytest.mark.slow]

CUT_OFF = "!document.getElementById('link').hidden"
WELL = "document.getElementById('link').hidden"


class Relay:
    """TCP to ``port``; after ``strand`` the connections that are there stay open and carry nothing, new ones do."""

    def __init__(self, port: int) -> None:
        self._port, self._era = port, 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._ends: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def strand(self) -> None:
        self._era += 1

    def close(self) -> None:
        for one in (self._listener, *self._ends):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                here, _ = self._listener.accept()
                there = socket.create_connection(("127.0.0.1", self._port))
                self._ends += [here, there]
                for ends in ((here, there), (there, here)):
                    threading.Thread(target=self._carry, args=(*ends, self._era), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket, era: int) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65_536):
                if era == self._era:
                    sink.sendall(data)
            if era == self._era:
                sink.shutdown(socket.SHUT_WR)


@pytest.fixture
def relay(module_router: str, start_dashboard_at: Callable[..., Any]) -> Iterator[Relay]:
    relay = Relay(start_dashboard_at(module_router).port)
    yield relay
    relay.close()


def test_a_connection_that_nobody_ends_is_made_anew(browser: Any, relay: Relay) -> None:
    browser.open(f"{relay.url}/")
    browser.wait(WELL, 20.0)
    relay.strand()
    browser.wait(CUT_OFF, 20.0)
    browser.wait(WELL, 20.0)


class Camera:
    """Sends a picture with these words, and what was detected, five times a second."""

    def __init__(self, zenoh: ZenohConfig) -> None:
        self.words, self._zenoh, self._stop = "first", zenoh, threading.Event()
        self._thread = threading.Thread(target=self._send)

    def __enter__(self) -> Camera:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _send(self) -> None:
        data = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
        with Service("camera", ServiceConfig(host="jetson0", zenoh=self._zenoh)) as service:
            image, boxes = service.publisher(topics.CAMERA_IMAGE), service.publisher(topics.CAMERA_DETECTIONS)
            while not self._stop.wait(0.2):
                now_ns = utc_ns()
                image(CompressedImage(stamp_ns=now_ns, format="jpeg", data=data, captions=[self.words]))
                boxes(
                    CameraDetections(stamp_ns=now_ns, detections=[], brightness=9.0, level=None, image_size_px=(64, 48))
                )


def test_the_picture_comes_back_too(browser: Any, relay: Relay, module_router: str) -> None:
    shows = "document.getElementById('camera-words').textContent === '{}'"
    with Camera(ZenohConfig(connect=(module_router,))) as camera:
        browser.open(f"{relay.url}/")
        browser.run("document.getElementById('camera').scrollIntoView()")
        browser.wait(shows.format("first"), 20.0)
        relay.strand()
        camera.words = "second"
        browser.wait(shows.format("second"), 90.0)  # each stranded connection of the browser costs five seconds


def test_a_verdict_that_is_not_live_says_so_before_any_health(
    browser: Any, module_router: str, start_dashboard_at: Callable[..., Any]
) -> None:
    fusion = Fusion(ZenohConfig(connect=(module_router,)), tells_health=False, source_kind="simulated")
    speaking = threading.Thread(target=fusion.live)
    speaking.start()
    try:
        browser.open(f"{start_dashboard_at(module_router).url}/")
        browser.wait("document.getElementById('level').textContent === 'SAFE'", 20.0)
        browser.wait("document.getElementById('origin').textContent.includes('SIMULATED DATA')", 5.0)
        assert not browser.run("document.getElementById('origin').hidden")
    finally:
        fusion.stop.set()
        speaking.join()
