"""What is plugged into this machine: pseudo-terminals whose far end a test holds."""

from __future__ import annotations

import contextlib
import os
import threading
import time
import tty
from collections.abc import Callable, Iterator

import pytest

from spotter_sim import ld06


class Port:
    """The far end of a pseudo-terminal: what is plugged into ``path``. ``data``: said over and over at this pace."""

    def __init__(self, data: Callable[[float], bytes] | None) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._speak, args=(data,), daemon=True)
        self._thread.start()

    def _speak(self, data: Callable[[float], bytes] | None) -> None:
        begun_s, t_s = time.monotonic(), 0.0
        while not self._stop.wait(0.02):
            while data is not None and t_s < time.monotonic() - begun_s:  # a busy machine catches up
                t_s += 0.02
                with contextlib.suppress(BlockingIOError):  # nobody reads
                    os.write(self._master, data(t_s))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def plug() -> Iterator[Callable[..., Port]]:
    ports: list[Port] = []

    def one(data: Callable[[float], bytes] | None = None) -> Port:
        ports.append(Port(data))
        return ports[-1]

    yield one
    for port in ports:
        port.close()


@pytest.fixture(scope="session")
def turning() -> Callable[[float], bytes]:
    """What an LD06 in the simulated crossing sends in the 20 ms after ``t_s``."""
    return lambda t_s: ld06.packets("crossing", t_s, t_s + 0.02)
