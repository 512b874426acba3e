"""A router that is killed and started again at random moments: how soon afterwards everybody sees everybody again.

    python -m benchmarks.system.restarts [COUNT]        # 50 restarts, some minutes

Three services and an onlooker are clients of one router process. After each start it is measured how long it takes
until the onlooker sees each service's token once and none besides, and each service answers.
"""

from __future__ import annotations

import random
import subprocess
import sys
import threading
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import zenoh

from benchmarks.waiting import wait_for
from common.bus.presence import Presence
from common.bus.runtime import Service
from common.bus.session import close_session, open_session
from common.clock import monotonic_s
from common.config import ServiceConfig, ZenohConfig
from common.topics import info_key
from spotter_tools.ports import free_port

SERVICES = (("pi0", "radar"), ("jetson0", "lidar"), ("jetson0", "fusion"))
LONGEST_PAUSE_S = 1.5  # between a restart that is over and the next one


class Onlooker:
    """Sees the tokens as they come and go, and asks the services."""

    def __init__(self, session: zenoh.Session, instances: set[tuple[str, str, str]]) -> None:
        self._session, self._instances = session, instances
        self._presence = Presence(session)

    def sees_nobody(self) -> bool:
        """No token is left."""
        return not self._presence.instances()

    def sees_all(self) -> bool:
        """Exactly the tokens of the services that run, and an answer from each."""
        return self._presence.instances() == self._instances and all(
            any(reply.ok is not None for reply in self._session.get(info_key(host, name), timeout=0.5))
            for host, name, _ in self._instances
        )


def restart_often(count: int, seed: int = 0) -> list[float]:
    """Seconds from each start of the router's process to the moment when all is right again.

    Raises:
        TimeoutError: it did not become right.
    """
    dice, pause, endpoint = random.Random(seed), threading.Event(), f"tcp/127.0.0.1:{free_port()}"
    bus, took_s = ZenohConfig(connect=(endpoint,)), []
    with ExitStack() as stack:
        router = Router(endpoint)
        stack.callback(lambda: router.kill())
        services = [stack.enter_context(Service(name, ServiceConfig(host=host, zenoh=bus))) for host, name in SERVICES]
        session = open_session(bus)
        stack.callback(close_session, session)
        onlooker = Onlooker(session, {(one.host, one.name, one.instance) for one in services})
        wait_for(onlooker.sees_all)
        for _ in range(count):
            pause.wait(dice.uniform(0.0, LONGEST_PAUSE_S))
            router.kill()
            wait_for(onlooker.sees_nobody)
            pause.wait(dice.uniform(0.0, LONGEST_PAUSE_S))
            begun_s = monotonic_s()
            router = Router(endpoint)
            listening_s = monotonic_s() - begun_s
            took_s.append(listening_s + wait_for(onlooker.sees_all))
    return took_s


class Router:
    """A router in a process of its own that listens once it is made."""

    def __init__(self, endpoint: str) -> None:
        command = [str(Path(sys.executable).with_name("spotter")), "router", "--listen", endpoint]
        self._process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert self._process.stderr is not None
        while "listening on" not in (line := self._process.stderr.readline()):
            if not line:
                raise RuntimeError("the router has ended")

    def kill(self) -> None:
        """SIGKILL: it says nothing to anybody."""
        self._process.kill()
        self._process.communicate()


def main() -> None:
    """The command above."""
    count = int(sys.argv[1]) if sys.argv[1:] else 50
    took_s = restart_often(count)
    middle_s, late_s = np.percentile(took_s, (50, 95))
    print(
        f"{count} restarts: all right again after {middle_s:.2f} s (median), {late_s:.2f} s (p95), {max(took_s):.2f} s"
    )


if __name__ == "__main__":
    main()
