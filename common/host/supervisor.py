"""Runs the processes of one host: starts them, restarts one that dies or falls silent, prefixes their logs.

No library fits: honcho ends everything when one process ends, supervisord neither prefixes nor embeds, and
systemd or compose (which deploy the real hosts) are not on every laptop. So: asyncio's subprocesses and this file.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from common.backoff import Backoff
from common.host.adoption import INBOX_VARIABLE, Adopted, Successor, adopt, delete_successor, read_successor
from common.host.heartbeat import Heartbeat

Process = asyncio.subprocess.Process | Adopted

FIRST_BACKOFF_S = 0.2
LONGEST_BACKOFF_S = 10.0
STEADY_AFTER_S = 10.0  # a process that lived this long starts again with the first back-off
STOP_BUDGET_S = 3.0
SILENT_LIMIT_S = 10.0  # a process that was ready and gives no sign of life for this long is replaced
LISTEN_PERIOD_S = 0.25
EXIT_WRONG_CONFIG = 2
_OF_ANOTHER_SUPERVISOR = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
_PR_SET_PDEATHSIG = 1
_COLOURS = (36, 32, 33, 35, 34, 31, 96, 92, 93)


@dataclass
class Child:
    """One process to keep alive; ``starts`` counts its starts, ``pid`` is that of the running process."""

    name: str
    command: list[str]
    starts: int = 0
    pid: int | None = None
    exit_code: int | None = None
    environment: dict[str, str] | None = field(default=None, repr=False)
    folder: str | None = None  # where it runs
    heartbeat: Heartbeat | None = field(default=None, repr=False)

    def become(self, successor: Successor) -> None:
        """From its next start on."""
        self.command, self.environment, self.folder = successor.command, successor.environment, successor.folder


class Supervisor:
    """``await run()`` returns when every child has done its work, when stopped, or when a child's config is wrong.

    The exit code is 0, or 2 when a child refused its configuration: a broken file never runs half a system. A
    process that replaces a child by `spotter swap` is supervised in its place (common/host/adoption.py).
    """

    def __init__(self, children: list[Child], *, write: Callable[[str], None] | None = None) -> None:
        self.children = children
        self._write = write or write_stderr
        self._width = max((len(child.name) for child in children), default=0)
        self._stop = asyncio.Event()
        self._exit_code = 0
        self._inbox: Path | None = None

    def stop(self) -> None:
        """Stop every child; ``run`` then returns."""
        self._stop.set()

    async def run(self) -> int:
        """Keep every child running; returns the exit code."""
        with contextlib.ExitStack() as stack:
            with contextlib.suppress(OSError):  # a full disk must not prevent the start
                self._inbox = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="spotter-")))
                self._listen(stack, self._inbox)
            keepers = [asyncio.create_task(self._keep(child, i)) for i, child in enumerate(self.children)]
            await asyncio.gather(*keepers)
        return self._exit_code

    def _listen(self, stack: contextlib.ExitStack, folder: Path) -> None:
        """For signs of life of every child."""
        for child in self.children:
            child.heartbeat = Heartbeat(folder / f"{child.name}.notify", SILENT_LIMIT_S)
            stack.callback(child.heartbeat.close)

    async def _keep(self, child: Child, index: int) -> None:
        backoff = Backoff(FIRST_BACKOFF_S, LONGEST_BACKOFF_S)
        while not self._stop.is_set():
            lived_s = await self._run_once(child, index) + await self._mind_successors(child, index)
            if self._stop.is_set():
                return
            signalled = child.heartbeat is not None and child.heartbeat.was_signalled()
            if child.exit_code == 0 and not signalled:
                self._say(child, index, "has done its work and ended")
                return
            if child.exit_code == EXIT_WRONG_CONFIG:
                self._exit_code = EXIT_WRONG_CONFIG
                self.stop()
                return
            if lived_s > STEADY_AFTER_S:
                backoff.reset()
            backoff_s = backoff.next_s()
            self._say(child, index, f"{_how(child.exit_code, signalled)}; starting it again in {backoff_s:.1f} s")
            await self._sleep(backoff_s)

    async def _run_once(self, child: Child, index: int) -> float:
        """Start, forward the output, wait; returns how long it lived in seconds."""
        loop = asyncio.get_running_loop()
        if shutil.which(child.command[0]) is None:
            self._say(child, index, f"{child.command[0]} is not installed here; is this host's extra installed?")
            child.exit_code = EXIT_WRONG_CONFIG
            return 0.0
        if child.heartbeat is not None:
            child.heartbeat.begin()  # before it starts, because its first message may come at once
        try:
            process = await asyncio.create_subprocess_exec(
                *child.command,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                env=self._environment(child),
                cwd=child.folder,
                start_new_session=True,  # Ctrl-C reaches us alone, and we stop them in order
                preexec_fn=_die_with_parent,
            )
        except OSError as error:  # out of memory, or its folder is gone: the others go on
            self._say(child, index, f"cannot be started: {error.filename or child.command[0]}: {error.strerror}")
            child.exit_code = None
            return 0.0
        started_s = loop.time()
        child.starts, child.pid, child.exit_code = child.starts + 1, process.pid, None
        forwarding = asyncio.create_task(self._forward(process, child, index))
        child.exit_code, child.pid = await self._mind(process, child, index), None
        await forwarding
        return loop.time() - started_s

    async def _mind(self, process: Process, child: Child, index: int) -> int | None:
        """Until it ends, falls silent or everything is stopped.

        Returns its exit code; None for a process of another parent and for one that had to be ended.
        """
        stopping = asyncio.create_task(self._stop.wait())
        silent = asyncio.create_task(_fallen_silent(child.heartbeat))
        ended: asyncio.Task[int | None] = asyncio.create_task(process.wait())
        await asyncio.wait({ended, stopping, silent}, return_when=asyncio.FIRST_COMPLETED)
        replaced = silent.done() and not ended.done() and not self._stop.is_set()
        if replaced:
            self._say(child, index, f"does not answer: no sign of life for {SILENT_LIMIT_S:.0f} s; it is replaced")
        if not ended.done():
            await self._end(process, ended, child, index)
        stopping.cancel()
        silent.cancel()
        exit_code = await ended
        return None if replaced else exit_code

    async def _mind_successors(self, child: Child, index: int) -> float:
        """Watch the successors of this child, one after the other; returns how long they lived, in seconds."""
        started_s, ended_pid = asyncio.get_running_loop().time(), None
        while self._inbox is not None and (successor := read_successor(self._inbox, child.name)) is not None:
            if successor.pid != ended_pid and (process := adopt(successor.pid)) is not None:
                self._say(child, index, f"process {successor.pid} has taken over")
                child.pid = ended_pid = successor.pid
                await self._mind(process, child, index)
                continue
            delete_successor(self._inbox, child.name)
            child.exit_code, child.pid = None, None
            if successor.kept:
                child.become(successor)
        return asyncio.get_running_loop().time() - started_s

    def _environment(self, child: Child) -> dict[str, str] | None:
        """The environment of a child, with the folder in which a swap writes its successor and where to show life."""
        if self._inbox is None:
            return child.environment
        own = {INBOX_VARIABLE: str(self._inbox), **(child.heartbeat.environment if child.heartbeat else {})}
        given = os.environ if child.environment is None else child.environment
        return {**{name: value for name, value in given.items() if name not in _OF_ANOTHER_SUPERVISOR}, **own}

    async def _end(self, process: Process, ended: asyncio.Task[int | None], child: Child, index: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
            process.send_signal(signal.SIGCONT)  # a stopped process does not handle the first one
        done, _ = await asyncio.wait({ended}, timeout=STOP_BUDGET_S)
        if not done:
            self._say(child, index, f"did not stop within {STOP_BUDGET_S:.0f} s; killed")
            with contextlib.suppress(ProcessLookupError):
                process.kill()

    async def _forward(self, process: asyncio.subprocess.Process, child: Child, index: int) -> None:
        assert process.stdout is not None
        while chunk := await _read_line(process.stdout):
            self._say(child, index, chunk)

    async def _sleep(self, seconds: float) -> None:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._stop.wait(), seconds)

    def _say(self, child: Child, index: int, line: str) -> None:
        prefix = f"{child.name:<{self._width}} |"
        if sys.stderr.isatty():
            prefix = f"\033[{_COLOURS[index % len(_COLOURS)]}m{prefix}\033[0m"
        self._write(f"{prefix} {line.rstrip()}\n")


def run_supervised(supervisor: Supervisor) -> int:
    """Run until Ctrl-C or SIGTERM; both stop every child first."""

    async def supervise() -> int:
        loop = asyncio.get_running_loop()
        for signum in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(signum, supervisor.stop)
        return await supervisor.run()

    return asyncio.run(supervise())


async def _fallen_silent(heartbeat: Heartbeat | None) -> None:
    """Returns when the process was ready and has shown no sign of life for longer than the limit."""
    if heartbeat is None:
        await asyncio.Event().wait()
        return
    loop = asyncio.get_running_loop()
    while heartbeat.silent_s(loop.time()) <= heartbeat.limit_s:
        await asyncio.sleep(LISTEN_PERIOD_S)


async def _read_line(stream: asyncio.StreamReader) -> str:
    try:
        line = await stream.readline()
    except ValueError:  # a line longer than the buffer: skip it, keep reading
        return "(an overlong line was left out)"
    return line.decode("utf-8", errors="replace")


def _how(exit_code: int | None, signalled: bool) -> str:
    if exit_code is None:
        return "ended"
    if exit_code == 0 and signalled:
        return "was told to end by somebody else"
    if exit_code < 0:
        return f"killed by {signal.Signals(-exit_code).name}"
    return f"exited with code {exit_code}"


def _die_with_parent() -> None:
    """Ask the kernel to end this child when the supervisor dies, however it dies (prctl(2), Linux)."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def write_stderr(text: str) -> None:
    """Ignore write errors: a log on a full disk loses lines, and the services go on."""
    with contextlib.suppress(OSError):
        sys.stderr.write(text)
        sys.stderr.flush()
