"""What strangers at the page's port cost: how soon the page answers, how often verdicts come, and the server's memory.

    python -m benchmarks.system.strangers

A real router, fusion and dashboard as processes. While 500 connections say nothing, while 100 requests drip a byte at a
time, while a client sends 50 MB in one frame, and with nobody there, before and after. What has to hold is in
tests/security/test_page_load.py.
"""

from __future__ import annotations

import contextlib
import http.client
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import zenoh
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from common.bus.session import build
from common.clock import monotonic_s
from common.config import ZenohConfig
from common.topics import FUSION_VERDICT
from spotter_tools.ports import free_port

BIN = Path(sys.executable).parent
SPAN_S = 4.0
FRAME = "x" * 50_000_000


class Vehicle:
    """A router, a fusion and a dashboard; ``measure`` what they do meanwhile."""

    def __init__(self, stack: ExitStack) -> None:
        self.port, endpoint = free_port(), f"tcp/127.0.0.1:{free_port()}"
        self._session = stack.enter_context(
            zenoh.open(build(ZenohConfig(mode="router", connect=(), listen=(endpoint,))))
        )
        self._verdicts = 0
        self._subscriber = self._session.declare_subscriber(FUSION_VERDICT.any_host, self._count)
        bus = ("--set", f'zenoh.connect=["{endpoint}"]')
        for name, more in (("fusion", ()), ("dashboard", ("--set", f"server.port={self.port}"))):
            self._dashboard = subprocess.Popen([BIN / f"spotter-{name}", *bus, *more], stderr=subprocess.DEVNULL)
            stack.callback(self._dashboard.wait)
            stack.callback(self._dashboard.terminate)
        while not self._verdicts or self._answer_ms() is None:
            threading.Event().wait(0.1)

    def _count(self, _: zenoh.Sample) -> None:
        self._verdicts += 1

    def _answer_ms(self) -> float | None:
        begun_s, connection = monotonic_s(), http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        try:
            connection.request("GET", "/")
            connection.getresponse().read()
        except OSError:
            return None
        finally:
            connection.close()
        return (monotonic_s() - begun_s) * 1e3

    def measure(self, what: str) -> None:
        """Ask for the page again and again, and print how it went."""
        begun_s, before, answers_ms = monotonic_s(), self._verdicts, []
        while monotonic_s() - begun_s < SPAN_S:
            answers_ms.append(self._answer_ms() or float("inf"))
            threading.Event().wait(0.02)
        rate_hz = (self._verdicts - before) / (monotonic_s() - begun_s)
        middle_ms, late_ms = np.percentile(answers_ms, (50, 99))
        resident = Path(f"/proc/{self._dashboard.pid}/status").read_text().partition("VmRSS:")[2].split()[0]
        print(f"{what:<32}{middle_ms:>8.1f} ms{late_ms:>8.1f} ms{rate_hz:>10.1f} Hz{int(resident) / 1e3:>8.0f} MB")


@contextmanager
def connections(port: int, count: int, beginning: bytes = b"") -> Iterator[list[socket.socket]]:
    """So many, each of which has said ``beginning``."""
    with ExitStack() as stack:
        every = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(count)]
        for one in every:
            one.sendall(beginning)
        yield every


@contextmanager
def dripping(port: int, count: int) -> Iterator[None]:
    """Requests that go on with a byte every 0.2 s."""
    stop = threading.Event()
    with connections(port, count, b"GET / HTTP/1.1\r\nHost: localhost\r\nX-Slow: ") as slow:

        def drip() -> None:
            while not stop.wait(0.2):
                for one in slow:
                    with contextlib.suppress(OSError):
                        one.send(b"x")

        thread = threading.Thread(target=drip)
        thread.start()
        yield
        stop.set()
        thread.join()


@contextmanager
def shouting(port: int) -> Iterator[None]:
    """One client after the other sends 50 MB in one frame."""
    stop = threading.Event()

    def shout() -> None:
        while not stop.is_set():
            with contextlib.suppress(ConnectionClosed, OSError), connect(f"ws://127.0.0.1:{port}/ws") as client:
                client.send(FRAME)

    thread = threading.Thread(target=shout)
    thread.start()
    yield
    stop.set()
    thread.join()


def main() -> None:
    """The command above."""
    print(f"{'':<32}{'page p50':>11}{'p99':>11}{'verdicts':>13}{'memory':>11}")
    with ExitStack() as stack:
        vehicle = Vehicle(stack)
        vehicle.measure("nobody else")
        with connections(vehicle.port, 500):
            vehicle.measure("500 silent connections")
        with dripping(vehicle.port, 100):
            vehicle.measure("100 requests that drip")
        with shouting(vehicle.port):
            vehicle.measure("frames of 50 MB")
        vehicle.measure("nobody else again")


if __name__ == "__main__":
    main()
