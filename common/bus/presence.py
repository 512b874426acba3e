"""Which services are present: liveliness tokens as a live set of (host, service, instance).

A token says that a process runs, not that it works. Consumers must also check the age of the data.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection

import zenoh

from common.bus.session import undeclare
from common.topics import ANY_TOKEN, parse_token

Instance = tuple[str, str, str]  # host, service, instance


AFTER = "-after-"


def successor(instance: str, predecessor: str) -> str:
    """The instance id of a process that announces that it takes over from another one."""
    return f"{instance}{AFTER}{predecessor.partition(AFTER)[0]}"


def claimants(instances: Collection[str]) -> set[str]:
    """Instances that claim a service, without those whose announced successor is present."""
    succeeded = {instance.partition(AFTER)[2] for instance in instances}
    return {one for one in instances if one.partition(AFTER)[0] not in succeeded} or set(instances)


class Presence:
    """Keeps the set of tokens up to date; ``on_change`` is called from its own thread after every change."""

    def __init__(
        self,
        session: zenoh.Session,
        on_change: Callable[[Presence], None] = lambda _: None,
        key_expr: str = ANY_TOKEN,
    ) -> None:
        self._lock = threading.Lock()
        self._alive: set[Instance] = set()
        self._on_change = on_change
        self._subscriber = session.liveliness().declare_subscriber(
            key_expr, zenoh.handlers.FifoChannel(1024), history=True
        )
        self._thread = threading.Thread(target=self._receive, name="presence", daemon=True)
        self._thread.start()

    def instances(self, host: str | None = None, service: str | None = None) -> set[Instance]:
        """The tokens now up, of one host or service if named."""
        with self._lock:
            return {i for i in self._alive if host in (None, i[0]) and service in (None, i[1])}

    def close(self) -> None:
        """End the subscription."""
        undeclare(self._subscriber)

    def _receive(self) -> None:
        try:
            for sample in self._subscriber:
                try:
                    instance = parse_token(str(sample.key_expr))
                except ValueError:
                    continue  # not a token of ours
                with self._lock:
                    if sample.kind == zenoh.SampleKind.PUT:
                        self._alive.add(instance)
                    else:
                        self._alive.discard(instance)
                self._on_change(self)
        except zenoh.ZError:
            return  # the session is closed
