"""Is a port free? Checked before anything starts, so that no service joins a router of another system."""

from __future__ import annotations

import errno
import re
import socket

from common.config import ConfigError

_ENDPOINT = re.compile(r"(?:tcp|tls)/\[?([^\]]+?)\]?:(\d+)(?:[?#].*)?")


def refuse_taken(endpoint: str, what_to_do: str) -> None:
    """Bind and let go. Zenoh itself would wait for a taken port as it waits for an address that is not there yet.

    Endpoints that are neither tcp nor tls are left to Zenoh.

    Raises:
        ConfigError: no endpoint at all, or another process listens there; then the message ends with ``what_to_do``.
    """
    if "/" not in endpoint:
        raise ConfigError(f"{endpoint!r} is no endpoint: expected PROTOCOL/HOST:PORT, e.g. tcp/127.0.0.1:7447")
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None:
        return
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(found[1], int(found[2]), type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ConfigError(f"{endpoint}: the port is taken; {what_to_do}") from None


def free_port() -> int:
    """A TCP port of this machine that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
