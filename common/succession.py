"""Who speaks for a service after ``spotter swap``: what the swap leaves for the supervisor of that host.

Every process of a supervisor is told of a private folder (SPOTTER_SUPERVISOR). Before a swap stops the old process, it
writes there who has taken over; the supervisor then minds that one, although it is no child of its own. Until the swap
keeps the new one for good, its end brings the old command back: also when the swap itself was killed meanwhile.
"""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

import msgspec

TOLD = "SPOTTER_SUPERVISOR"


class Successor(msgspec.Struct, frozen=True):
    """A process that took over, and how to start it once more; ``kept``: also after its end."""

    pid: int
    command: list[str]
    environment: dict[str, str]
    folder: str
    kept: bool = False


class Adopted:
    """A process that somebody else started, with what a supervisor uses of asyncio's own."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def send_signal(self, signum: int) -> None:
        signal.pidfd_send_signal(self._descriptor, signum)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    async def wait(self) -> None:
        """Until it has ended; how, only its parent is told."""
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        loop.add_reader(self._descriptor, ended.set)
        try:
            await ended.wait()
        finally:
            loop.remove_reader(self._descriptor)
            os.close(self._descriptor)


def adopt(pid: int) -> Adopted | None:
    """By a descriptor that stays with this process, whoever gets its number later; None when it has ended."""
    try:
        return Adopted(os.pidfd_open(pid))
    except ProcessLookupError:
        return None


def leave(inbox: Path, service: str, successor: Successor) -> None:
    """Tell the supervisor; whole or not at all, and readable by its user alone (an environment may hold secrets)."""
    written = inbox / f".{service}"
    written.touch(0o600)
    written.write_bytes(msgspec.json.encode(successor))
    written.replace(inbox / service)


def left(inbox: Path, service: str) -> Successor | None:
    """What the last swap of this service left; None when there was none."""
    try:
        return msgspec.json.decode((inbox / service).read_bytes(), type=Successor)
    except (OSError, msgspec.MsgspecError):
        return None


def forget(inbox: Path, service: str) -> None:
    """What it left is done with."""
    (inbox / service).unlink(missing_ok=True)


def inbox_of(environment: dict[str, str]) -> Path | None:
    """Of the supervisor that started a process with this environment; None without one, or if it is another user's."""
    try:
        folder = Path(environment[TOLD])
        return folder if folder.stat().st_uid == os.geteuid() else None
    except (KeyError, OSError):
        return None
