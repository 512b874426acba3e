"""A TCP relay on loopback that can be slow or cut: when cut, connections stay open and carry nothing."""

from __future__ import annotations

import contextlib
import socket
import threading
from queue import SimpleQueue

from common.clock import monotonic_s

CHUNK_BYTES = 65_536
POLL_S = 0.2


class LinkProxy:
    """Listens on a free port and forwards to ``target``; ``cut()``, ``slow()`` and ``heal()`` at any time."""

    def __init__(self, target: tuple[str, int]) -> None:
        self._target = target
        self._delay_s = 0.0
        self._open = threading.Event()
        self._open.set()
        self._closed = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._sockets: list[socket.socket] = []
        threading.Thread(target=self._accept, name="proxy", daemon=True).start()

    @property
    def endpoint(self) -> str:
        """Where to connect instead of to the target."""
        return f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"

    def cut(self) -> None:
        """Carry nothing from now on, and close nothing, like a pulled cable."""
        self._open.clear()

    def slow(self, delay_s: float) -> None:
        """Delay everything by this time, each way."""
        self._delay_s = delay_s

    def heal(self) -> None:
        """Carry everything again without delay, queued data first."""
        self._delay_s = 0.0
        self._open.set()

    def close(self) -> None:
        """End all connections and threads."""
        self._closed.set()
        self._open.set()
        for one in (self._listener, *self._sockets):
            with contextlib.suppress(OSError):
                one.close()

    def _accept(self) -> None:
        while not self._closed.is_set():
            try:
                client, _ = self._listener.accept()
                server = socket.create_connection(self._target, timeout=5.0)
            except OSError:
                continue
            for one in (client, server):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                one.settimeout(POLL_S)
            self._sockets += [client, server]
            for ends in ((client, server), (server, client)):
                threading.Thread(target=self._pump, args=ends, daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        """Read, and hand over to the thread that sends: so a slow link carries as much as a fast one."""
        waiting: SimpleQueue[tuple[float, bytes]] = SimpleQueue()
        threading.Thread(target=self._deliver, args=(waiting, source, sink), daemon=True).start()
        while not self._closed.is_set():
            self._open.wait()
            try:
                data = source.recv(CHUNK_BYTES)
            except TimeoutError:
                continue
            except OSError:
                break
            waiting.put((monotonic_s() + self._delay_s, data))
            if not data:
                return
        waiting.put((0.0, b""))

    def _deliver(self, waiting: SimpleQueue[tuple[float, bytes]], source: socket.socket, sink: socket.socket) -> None:
        """Send each piece when it is due, in order; an empty one ends the connection."""
        while True:
            due_s, data = waiting.get()
            self._closed.wait(max(0.0, due_s - monotonic_s()))
            self._open.wait()  # what was read during the cut arrives after it, or never
            if not data or not _sent(sink, data):
                break
        for one in (source, sink):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)  # wakes the other end at once, and a thread that waits on it here


def _sent(sink: socket.socket, data: bytes) -> bool:
    try:
        sink.sendall(data)
    except OSError:
        return False
    return True
