"""A TCP relay on loopback that can be cut: the connection stays open and carries nothing, as a pulled cable does."""

from __future__ import annotations

import contextlib
import socket
import threading

CHUNK_BYTES = 65_536
POLL_S = 0.2


class LinkProxy:
    """Listens on a free port and forwards to ``target``; ``cut()`` and ``heal()`` at any time."""

    def __init__(self, target: tuple[str, int]) -> None:
        self._target = target
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
        """Carry nothing from now on, and close nothing: as a pulled cable."""
        self._open.clear()

    def heal(self) -> None:
        """Carry everything again, what piled up first."""
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
        while not self._closed.is_set():
            self._open.wait()
            try:
                data = source.recv(CHUNK_BYTES)
            except TimeoutError:
                continue
            except OSError:
                break
            self._open.wait()  # what was read during the cut arrives after it, or never
            if not data or not _sent(sink, data):
                break
        for one in (source, sink):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)  # tells the other end at once, whoever still waits on it here


def _sent(sink: socket.socket, data: bytes) -> bool:
    try:
        sink.sendall(data)
    except OSError:
        return False
    return True
