"""Who is there, by service: worked out once per change of the liveliness tokens, not at every verdict."""

from __future__ import annotations

from collections import defaultdict

from common.bus.presence import Instance, claimants


class Roster:
    """The processes that claim each service, those that are being replaced, and the hosts that have any."""

    def __init__(self) -> None:
        self._present: frozenset[Instance] = frozenset()
        self.hosts: frozenset[str] = frozenset()
        self.services: dict[str, tuple[str, ...]] = {}  # by "<host>/<service>"
        self.handing_over: frozenset[str] = frozenset()  # the same names: the old one is still there, its successor too

    def update(self, present: frozenset[Instance]) -> None:
        """Take the tokens that are up now. One whose announced successor is there no longer claims the service."""
        if present == self._present:
            return
        self._present = present
        grouped: defaultdict[str, list[str]] = defaultdict(list)
        for host, service, instance in present:
            grouped[f"{host}/{service}"].append(instance)
        self.services = {name: tuple(sorted(claimants(instances))) for name, instances in grouped.items()}
        self.handing_over = frozenset(name for name, there in grouped.items() if len(there) > len(self.services[name]))
        self.hosts = frozenset(host for host, _, _ in present)
