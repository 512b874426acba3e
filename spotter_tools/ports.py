"""Is a port free? Checked before anything starts, so that no service joins a router of another system."""

from __future__ import annotations

import errno
import random
import re
import socket
from pathlib import Path

from common.config import ConfigError

FIRST_PORT, TRIES = 10_000, 100
OUTGOING_PORTS = Path("/proc/sys/net/ipv4/ip_local_port_range")
USUAL_FIRST_OUTGOING_PORT = 32_768
_RANDOM = random.SystemRandom()  # no seed of a test gives two processes the same ports
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
    """A TCP port of this machine that is free, below those of outgoing connections.

    The system hands those out to any program: port 0 gave some that a connection had taken before they were used.

    Raises:
        OSError: a hundred of them are taken.
    """
    last = _first_outgoing_port() - 1
    for _ in range(TRIES - 1):
        try:
            return _bound_once(_RANDOM.randint(FIRST_PORT, last))
        except OSError:
            continue
    return _bound_once(_RANDOM.randint(FIRST_PORT, last))


def _bound_once(port: int) -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", port))
    return port


def _first_outgoing_port() -> int:
    try:
        return int(OUTGOING_PORTS.read_text().split()[0])
    except (OSError, ValueError, IndexError):
        return USUAL_FIRST_OUTGOING_PORT
