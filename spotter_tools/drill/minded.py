"""A supervised service, as `spotter up` runs it, for faults that only the supervisor may repair."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import threading
from pathlib import Path

from common.host.supervisor import Child, Supervisor


class Minded:
    """Used like the ``subprocess.Popen`` of a service without a supervisor. Its output is appended to ``log``."""

    def __init__(self, child: Child, log: Path) -> None:
        self._child, self._log = child, log
        self._supervisor = Supervisor([child], write=self._write)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=lambda: asyncio.run(self._supervise()), name="supervisor", daemon=True)
        self._thread.start()

    def send_signal(self, signum: int) -> None:
        """To the process that runs now, if one does."""
        if self._child.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._child.pid, signum)

    def terminate(self) -> None:
        """Stop the supervisor, which stops the process."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._supervisor.stop)

    def kill(self) -> None:
        """The same: the supervisor kills what does not stop."""
        self.terminate()

    def wait(self, timeout: float | None = None) -> None:
        """Until the supervisor has ended; raises ``subprocess.TimeoutExpired``."""
        self._thread.join(timeout)
        if timeout is not None and self._thread.is_alive():
            raise subprocess.TimeoutExpired(self._child.command, timeout)

    async def _supervise(self) -> None:
        self._loop = asyncio.get_running_loop()
        await self._supervisor.run()

    def _write(self, text: str) -> None:
        with self._log.open("a") as log:
            log.write(text)
