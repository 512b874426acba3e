"""Processes: the candidate that is started, the old service that is stopped, and the way back."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from common.bus.handover import PROMOTE
from common.host.adoption import INBOX_VARIABLE, Successor, inbox_of, write_successor
from common.host.process_plan import service_environment
from common.security.rules import SHADOW

STOP_BUDGET_S = 5.0
# Services of other makers read these to find host, router and namespace.
OF_A_SERVICE = ("SPOTTER_HOST", "SPOTTER_CONNECT", "SPOTTER_NAMESPACE", INBOX_VARIABLE)


def command_line(command: str, host: str, connect: str, namespace: str) -> list[str]:
    """The candidate\'s command line. Our own services get host and router as settings, others from the environment.

    A console script that is not on the PATH is searched beside this interpreter.
    """
    words = shlex.split(command)
    sibling = Path(sys.executable).parent / words[0]
    if Path(words[0]).name.startswith("spotter-"):
        if shutil.which(words[0]) is None and sibling.is_file():
            words[0] = str(sibling)
        for setting in (f"host={host}", f'zenoh.connect=["{connect}"]', f"zenoh.namespace={namespace}"):
            words += ["--set", setting]
    return words


@dataclass(frozen=True)
class Live:
    """A process that runs a service without a supervisor, with its command and environment."""

    process: subprocess.Popen[bytes]
    words: list[str]
    environment: dict[str, str]

    @classmethod
    def start(cls, words: list[str], environment: dict[str, str], output: IO[bytes]) -> Live:
        """In a session of its own, so that Ctrl-C here does not reach it."""
        process = subprocess.Popen(
            words, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
        )
        return cls(process, words, _without_swap(environment))

    def stop(self) -> None:
        """SIGTERM, then SIGKILL if it has not ended in time."""
        if self.process.poll() is not None:
            return
        self.process.terminate()
        try:
            self.process.wait(STOP_BUDGET_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


class Candidate:
    """A process that publishes in the shadow. Its log goes to a file."""

    def __init__(self, words: list[str], variables: dict[str, str], succeeds: str, log: Path) -> None:
        environment = {**service_environment(), **variables, "SPOTTER_SHADOW": SHADOW, "SPOTTER_SUCCEEDS": succeeds}
        self.log = log
        with log.open("wb") as output:
            self.live = Live.start(words, environment, output)

    @property
    def pid(self) -> int:
        """Process id."""
        return self.live.process.pid

    def ended(self) -> str:
        """How it ended, with the last line of its log; empty while it runs."""
        code = self.live.process.poll()
        if code is None:
            return ""
        lines = self.log.read_text(errors="replace").strip().splitlines()
        return f"it ended with code {code}: {lines[-1] if lines else 'no output'}"

    def promote(self) -> None:
        """Make it publish under the live keys."""
        self.live.process.send_signal(PROMOTE)

    def stop(self) -> None:
        self.live.stop()


class Predecessor:
    """The running service: stopped by a signal or by its supervisor's command, started again if need be.

    ``inbox`` is the folder in which `spotter up` or `spotter demo`, if one of them started it, reads the successor.
    """

    def __init__(self, service: str, pid: int, stop_command: str, start_command: str) -> None:
        self.service, self.pid = service, pid
        self.live: Live | None = None  # when it was started again from here
        self._stop_command, self._start_command = shlex.split(stop_command), shlex.split(start_command)
        self._words, self._environment = _remember(pid)
        self.inbox = None if stop_command else inbox_of(self._environment)

    @property
    def reachable(self) -> bool:
        """Can be stopped from here."""
        return bool(self._stop_command or self._words)

    @property
    def inherited(self) -> dict[str, str]:
        """Variables of the candidate, so that the next swap finds the same supervisor."""
        return {INBOX_VARIABLE: str(self.inbox)} if self.inbox is not None else {}

    def inform_supervisor(self, new: Live, *, kept: bool) -> None:
        """Give the supervisor the new process. Until it is ``kept``, the old command is started again when it ends."""
        if self.inbox is not None:
            known = Successor(new.process.pid, new.words, new.environment, str(Path.cwd()), kept)
            write_successor(self.inbox, self.service, known)

    def stop(self) -> None:
        """Stop it by its stop command, or by a signal; one that has ended by itself is stopped.

        Raises:
            OSError, subprocess.SubprocessError: it cannot be stopped and still runs.
        """
        if self._stop_command:
            subprocess.run(self._stop_command, check=True, timeout=30, stdout=subprocess.DEVNULL)
            return
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGTERM)

    def start_again(self, log: Path) -> bool:
        """By its supervisor, or with its old command line and environment; False when that is not possible."""
        if self.inbox is not None:
            return True  # done as soon as the new one has ended
        try:
            if self._start_command:
                return subprocess.run(self._start_command, timeout=30, check=False).returncode == 0
            if not self._words:
                return False
            with log.open("ab") as output:
                self.live = Live.start(self._words, self._environment, output)
        except (OSError, subprocess.SubprocessError):
            return False
        return True


def _remember(pid: int) -> tuple[list[str], dict[str, str]]:
    """Command line and environment of a service\'s process, read before it is stopped; empty if not on this machine.

    The process id is that of the service\'s machine. Another program may have it here, and must not be stopped.
    """
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")[:-1]
        pairs = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")[:-1]
    except OSError:
        return [], {}
    environment = dict(pair.decode(errors="surrogateescape").split("=", 1) for pair in pairs if b"=" in pair)
    if not any(b"spotter" in word for word in words) and not any(name in environment for name in OF_A_SERVICE):
        return [], {}
    return [word.decode(errors="surrogateescape") for word in words], _without_swap(environment)


def _without_swap(environment: dict[str, str]) -> dict[str, str]:
    """The environment without the variables of a shadow or a supervisor."""
    gone = ("SPOTTER_SHADOW", "SPOTTER_SUCCEEDS", "NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC")
    return {name: value for name, value in environment.items() if name not in gone}
