"""After a swap without a supervisor: the command supervises the new process until it is stopped."""

from __future__ import annotations

from collections.abc import Callable

from common.host.supervisor import Child, Supervisor, run_supervised
from spotter_tools.swap.candidate import Live


def keep(service: str, live: Live, say: Callable[[str], None]) -> int:
    """Start the process again whenever it dies; Ctrl-C (SIGTERM and SIGHUP act the same) stops it.

    Returns the exit code.

    One that ends by itself (code 0: another swap has replaced it, or its recording is over) is left alone.
    """
    try:
        code = live.process.wait()
    except KeyboardInterrupt:
        live.stop()
        return 0
    if code == 0:
        say(f"{service} ended by itself")
        return 0
    say(f"{service} ended with code {code}; starting it again")
    return run_supervised(Supervisor([Child(service, live.words, environment=live.environment)]))
