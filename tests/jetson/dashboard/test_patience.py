"""Whoever is connected and does not ask is let go, after the first request as well as before it."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import uvicorn

from services.jetson.dashboard.protocol import impatient
from spotter_tools.ports import free_port

WITHIN_S = 0.4
REQUEST = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"


async def application(scope: Any, receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
    await send({"type": "http.response.body", "body": b"ok"})


@pytest.fixture(scope="module")
def port(until: Callable[..., None]) -> Iterator[int]:
    port = free_port()
    config = uvicorn.Config(application, port=port, log_level="error", lifespan="off", http=impatient(WITHIN_S))
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    until(lambda: server.started, "the server has started")
    yield port
    server.should_exit = True
    thread.join()


def answer(link: socket.socket) -> bytes:
    received = b""
    while not received.endswith(b"\r\n\r\nok"):
        more = link.recv(1000)
        assert more
        received += more
    return received


@pytest.mark.parametrize("asked_before", [0, 1, 3])
def test_a_request_that_is_never_finished_ends_its_connection(port: int, asked_before: int) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=5.0) as link:
        for _ in range(asked_before):
            link.sendall(REQUEST)
            answer(link)
        begun_s = time.monotonic()
        link.sendall(b"GET / HTTP/1.1\r\nHost: loc")
        assert link.recv(1000) == b""  # closed by the other end
        assert time.monotonic() - begun_s < 4.0  # the server's own patience between two requests is 5 s


def test_whoever_asks_slowly_but_in_time_is_answered(port: int) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=5.0) as link:
        for _ in range(3):
            for at in range(0, len(REQUEST), 20):
                link.sendall(REQUEST[at : at + 20])
                time.sleep(0.05)
            assert answer(link).startswith(b"HTTP/1.1 200")
            time.sleep(WITHIN_S)
