"""Strangers who cost the page something: it answers others meanwhile, gets rid of them, and the verdict goes on."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

pytestmark = [pytest.mark.system, pytest.mark.whole, pytest.mark.timeout(120), pytest.mark.usefixtures("unmoved")]
TOKEN = "open-sesame"
SLOW_REQUEST = b"GET / HTTP/1.1\r\nHost: localhost\r\nX-Slow: "


def page_answers(vehicle: Any) -> None:
    status, body = vehicle.get(f"/?token={TOKEN}")
    assert (status, b"<h1" in body) == (200, True)
    vehicle.next_verdict()


@contextmanager
def connections(vehicle: Any, count: int) -> Iterator[list[socket.socket]]:
    with ExitStack() as stack:
        yield [
            stack.enter_context(socket.create_connection(("127.0.0.1", vehicle.port), timeout=10.0))
            for _ in range(count)
        ]


def resident_mb(pid: int) -> float:
    line = next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1e3


def is_closed(one: socket.socket) -> bool:
    """The other end has closed it, whatever it said before."""
    one.settimeout(20.0)
    try:
        while one.recv(4096):
            pass
    except ConnectionResetError:
        pass
    return True


def test_500_connections_that_say_nothing_are_closed(vehicle: Any) -> None:
    with connections(vehicle, 500) as idle:
        page_answers(vehicle)
        assert all(is_closed(one) for one in idle)
    page_answers(vehicle)


def test_requests_that_never_end_are_closed(vehicle: Any) -> None:
    """Slowloris: a byte of a header now and then keeps a connection alive for ever."""
    stop = threading.Event()
    with connections(vehicle, 100) as slow:
        for one in slow:
            one.sendall(SLOW_REQUEST)

        def drip() -> None:
            while not stop.wait(0.2):
                for one in slow:
                    try:
                        one.send(b"x")
                    except OSError:
                        continue

        dripping = threading.Thread(target=drip)
        dripping.start()
        try:
            page_answers(vehicle)
            begun_s = time.monotonic()
            while not all(gone(one) for one in slow):
                assert time.monotonic() - begun_s < 30.0
                page_answers(vehicle)
        finally:
            stop.set()
            dripping.join()
    page_answers(vehicle)


def gone(one: socket.socket) -> bool:
    one.setblocking(False)
    try:
        return one.recv(4096) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True


def test_a_connection_that_asks_in_time_is_kept(vehicle: Any) -> None:
    """The limit is for those who do not ask; a page that is open stays open for longer."""
    with connect(f"ws://127.0.0.1:{vehicle.port}/ws?token={TOKEN}") as client:
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < 4.5:
            assert "entries" in str(client.recv(timeout=5))


def hear_to_the_end(client: ClientConnection) -> None:
    while True:
        client.recv(timeout=10)


def test_a_frame_of_50_megabytes_is_refused_and_not_kept(vehicle: Any) -> None:
    before_mb = resident_mb(vehicle.pids["dashboard"])
    with connect(f"ws://127.0.0.1:{vehicle.port}/ws?token={TOKEN}", max_size=None) as client:
        with contextlib.suppress(ConnectionClosed):  # it may be closed before all is sent
            client.send("x" * 50_000_000)
        with pytest.raises(ConnectionClosed):
            hear_to_the_end(client)
        assert client.close_code in (1009, 1006)  # too big, or closed in the middle of the frame
    assert resident_mb(vehicle.pids["dashboard"]) - before_mb < 25.0
    page_answers(vehicle)


def test_a_foreign_origin_hears_nothing_however_often(vehicle: Any) -> None:
    for _ in range(100):
        with pytest.raises(InvalidStatus):
            connect(f"ws://127.0.0.1:{vehicle.port}/ws?token={TOKEN}", origin="http://elsewhere.example")  # type: ignore[arg-type]
    page_answers(vehicle)
