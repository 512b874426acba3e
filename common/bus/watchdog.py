"""Heartbeat for systemd or our own supervisor by datagrams of sd_notify(3); in a container, by touching a file.

Does nothing unless NOTIFY_SOCKET or SPOTTER_ALIVE (a folder) is set.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from pathlib import Path


def say_stopping() -> None:
    """A signal has asked this process to end: its supervisor can tell that from work that is done."""
    _send(os.environ.get("NOTIFY_SOCKET", ""), "STOPPING=1")


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
        _send(self._address, f"STATUS={status}" if self._ready else f"READY=1\nSTATUS={status}")
        self._ready = True

    def alive(self) -> None:
        """The work made progress."""
        _send(self._address, "WATCHDOG=1")
        if self._file is not None:
            with suppress(OSError):  # disk full: the file is not updated, and the supervisor restarts us
                self._file.parent.mkdir(parents=True, exist_ok=True)  # the folder may have been deleted
                self._file.touch()


def _send(address: str, text: str) -> None:
    if not address:
        return
    address = "\0" + address[1:] if address.startswith("@") else address
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)  # a stopped supervisor must not block us
        sender.sendto(text.encode(), address)  # no receiver, or no descriptor left: retried next time
