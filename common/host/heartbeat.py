"""Whether a supervised process still works, by its sd_notify(3) messages, as systemd would do it.

A process that never says READY=1 (a program that is not ours, a service that still starts) is not monitored.
"""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path

READ_BYTES = 4096
# A service sends its heartbeat from a separate thread, and stops when its main loop was stuck for half of this time
# (WatchdogSec of our systemd units). Long, because opening a camera may take several seconds.
WATCHDOG_S = 30.0


class Heartbeat:
    """The receiving end of one service's NOTIFY_SOCKET, at ``path``. Times are monotonic seconds, given by the caller.

    Raises:
        OSError: the socket cannot be made, for example because the path is too long.
    """

    def __init__(self, path: Path, limit_s: float) -> None:
        self.limit_s = limit_s
        self._path = path
        self._last_s: float | None = None  # None = not ready yet
        self._stopping = False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(str(path))
        except OSError:
            self._socket.close()
            raise

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables for the process."""
        return {"NOTIFY_SOCKET": str(self._path), "WATCHDOG_USEC": str(round(WATCHDOG_S * 1e6))}

    def begin(self) -> None:
        """A new process starts: forget the messages of the one before."""
        self._read()
        self._last_s, self._stopping = None, False

    def silent_s(self, now_s: float) -> float:
        """Seconds since the last sign of life; 0.0 while it is not ready. Call it more often than every second."""
        text = self._read()
        self._stopping |= "STOPPING=1" in text
        if "READY=1" in text or (self._last_s is not None and "WATCHDOG=1" in text):
            self._last_s = now_s
        return 0.0 if self._last_s is None else now_s - self._last_s

    def was_signalled(self) -> bool:
        """Whether a signal asked the process to end (STOPPING=1)."""
        self._stopping |= "STOPPING=1" in self._read()
        return self._stopping

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        with contextlib.suppress(OSError):
            os.unlink(self._path)

    def _read(self) -> str:
        """Read all messages since the last call."""
        texts = []
        with contextlib.suppress(BlockingIOError):
            while True:
                texts.append(self._socket.recv(READ_BYTES).decode(errors="replace"))
        return "\n".join(texts)
