"""The process of a service after ``spotter swap``: what the swap writes for the supervisor of that host.

Every process of a supervisor has the path of a private folder in its environment (SPOTTER_SUPERVISOR). Before a swap
stops the old process, it writes its successor there; the supervisor then watches that one, although it is no child.
Until the swap keeps the new one for good, its end brings the old command back: also when the swap itself was killed.
"""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

import msgspec

INBOX_VARIABLE = "SPOTTER_SUPERVISOR"


class Successor(msgspec.Struct, frozen=True):
    """A process that took over, and how to start it once more; ``kept``: also after its end."""

    pid: int
    command: list[str]
    environment: dict[str, str]
    folder: str
    kept: bool = False


class Adopted:
    """A process of another parent, with what a supervisor uses of asyncio's own."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def send_signal(self, signum: int) -> None:
        """Send a signal; ``ProcessLookupError`` when it has ended."""
        signal.pidfd_send_signal(self._descriptor, signum)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)

    async def wait(self) -> None:
        """Until it has ended; the exit code is known to its parent only."""
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        loop.add_reader(self._descriptor, ended.set)
        try:
            await ended.wait()
        finally:
            loop.remove_reader(self._descriptor)
            os.close(self._descriptor)


def adopt(pid: int) -> Adopted | None:
    """By a descriptor, which stays valid when the number is used again; None when the process has ended."""
    try:
        return Adopted(os.pidfd_open(pid))
    except ProcessLookupError:
        return None


def write_successor(inbox: Path, service: str, successor: Successor) -> None:
    """Write it atomically, readable by the supervisor's user alone: an environment may hold secrets."""
    written = inbox / f".{service}"
    written.touch(0o600)
    written.write_bytes(msgspec.json.encode(successor))
    written.replace(inbox / service)


def read_successor(inbox: Path, service: str) -> Successor | None:
    """The successor that the last swap of this service wrote; None when there was none."""
    try:
        return msgspec.json.decode((inbox / service).read_bytes(), type=Successor)
    except (OSError, msgspec.MsgspecError):
        return None


def delete_successor(inbox: Path, service: str) -> None:
    """Delete the file of the swap."""
    (inbox / service).unlink(missing_ok=True)


def inbox_of(environment: dict[str, str]) -> Path | None:
    """Of the supervisor that started a process with this environment; None without one, or if it is another user's."""
    try:
        folder = Path(environment[INBOX_VARIABLE])
        return folder if folder.stat().st_uid == os.geteuid() else None
    except (KeyError, OSError):
        return None
