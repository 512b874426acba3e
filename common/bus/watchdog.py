"""Heartbeat for systemd or our own supervisor by datagrams of sd_notify(3); in a container, by touching a file.

Does nothing unless NOTIFY_SOCKET or SPOTTER_ALIVE (a folder) is set.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from pathlib import Path


class Watchdog:
    """Call ``ready`` once, then ``alive`` while the work makes progress. Without it the supervisor restarts us."""

    def __init__(self, name: str) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        folder = os.environ.get("SPOTTER_ALIVE", "")
        self._file = Path(folder, name) if folder else None
        if self._file is not None:
            self._file.parent.mkdir(parents=True, exist_ok=True)
        self._ready = False

    @property
    def limit_s(self) -> float:
        """The watchdog time-out of systemd (WATCHDOG_USEC); 0 = off."""
        return int(os.environ.get("WATCHDOG_USEC", "0")) * 1e-6

    def ready(self, status: str = "") -> None:
        """The start is over. Further calls only change the status line."""
        self._send(f"STATUS={status}" if self._ready else f"READY=1\nSTATUS={status}")
        self._ready = True

    def alive(self) -> None:
        """The work made progress."""
        self._send("WATCHDOG=1")
        if self._file is not None:
            with suppress(OSError):  # disk full: the file is not updated, and the supervisor restarts us
                self._file.parent.mkdir(parents=True, exist_ok=True)  # the folder may have been deleted
                self._file.touch()

    def _send(self, text: str) -> None:
        if not self._address:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)  # a stopped supervisor must not block us
            sender.sendto(text.encode(), address)  # no receiver, or no descriptor left: retried next time
