"""A demo on this machine: one router, all hosts' services, no site. Checked for what a demo should do."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import zenoh

from common import topics
from common.bus.session import close_session, open_session
from common.config import ZenohConfig
from common.host.site import Site
from spotter_tools.doctor.bus import OPEN_S, check_services_of
from spotter_tools.doctor.findings import Finding, ok

TOKENS_S = 1.0


def check_demo(site: Site, endpoint: str, namespace: str) -> list[Finding]:
    """Findings about a demo at this endpoint; empty when none runs there.

    In a demo every service of the table is alive on one router, and no other host's router listens. ``site`` is the
    site without a file, all of it on this machine, whose hosts have a router each.
    """
    if _listening(site) > 1:
        return []
    try:
        session = open_session(ZenohConfig(connect=(endpoint,), namespace=namespace), give_up_after_s=OPEN_S)
    except ConnectionError:
        return []
    try:
        alive = _alive(session)
        if not {(row.host, row.name) for row in topics.SERVICES} <= alive:
            return []
        return [ok("demo", f"a demo runs at {endpoint}; no site is checked"), *_services(session)]
    finally:
        close_session(session)


def _services(session: zenoh.Session) -> Iterator[Finding]:
    for host in dict.fromkeys(row.host for row in topics.SERVICES):
        yield from check_services_of(session, host, [row.name for row in topics.SERVICES if row.host == host])


def _alive(session: zenoh.Session) -> set[tuple[str, str]]:
    replies = session.liveliness().get(topics.ANY_TOKEN, timeout=TOKENS_S)
    return {topics.parse_token(str(reply.ok.key_expr))[:2] for reply in replies if reply.ok is not None}


def _listening(site: Site) -> int:
    """How many hosts of a site on one machine have a router."""
    return sum(_connects(host.local_port) for host in site.hosts.values())


def _connects(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=0.5).close()
    except OSError:
        return False
    return True
