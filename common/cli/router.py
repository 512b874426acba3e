"""`spotter router`: an embedded Zenoh router, where no zenohd container is wanted."""

from __future__ import annotations

import errno
import json
import logging
import os
import re
import socket
import sys
import threading
from pathlib import Path
from typing import Annotated

import typer

from common.cli.connect import Namespace
from common.cli.fail import fail
from common.cli.site_option import SiteFile, read_site
from common.config import ConfigError, ZenohConfig
from common.launch import run_until_stopped, setup_logging
from common.security.router import router_config
from common.session import close_session, init_zenoh_log, nested_settings, open_session
from common.watchdog import Watchdog

log = logging.getLogger("router")
HEARTBEAT_S = 1.0
# Zenoh closes a link that was cut silently from one of its receiving threads, and waits up to 10 s there for what was
# not acknowledged (SO_LINGER). With the default of two threads, two dead neighbours stop everything on this host.
RUNTIME = "(rx: (worker_threads: 32))"


def router(
    listen: Annotated[
        list[str] | None, typer.Option("--listen", help="Endpoint to listen on; may be given several times.")
    ] = None,
    link: Annotated[
        list[str] | None, typer.Option("--link", help="Another host's router to link to; may be repeated.")
    ] = None,
    host: Annotated[str, typer.Option("--host", help="Be the router of this host of --site.")] = "",
    site_file: SiteFile = None,
    show: Annotated[
        bool, typer.Option("--show", help="Print the configuration as JSON5, for zenohd, and stop.")
    ] = False,
    namespace: Namespace = "spotter",
) -> None:
    """Run a router until Ctrl-C. Services on this host are its clients; routers link to each other."""
    if host:
        config = _of_site(host, site_file)
    else:
        # A router relays keys as they are: the namespace belongs to the sessions that speak, not to the relay.
        endpoints = tuple(listen or ["tcp/127.0.0.1:7447"])
        config = ZenohConfig(mode="router", listen=endpoints, connect=tuple(link or ()), namespace="")
    if show:
        sys.stdout.write(json.dumps(nested_settings(config), indent=2) + "\n")
        return
    setup_logging("router")
    init_zenoh_log("error")
    if host and not config.certificate:
        log.warning(OPEN_MODE, host)
    run_until_stopped(lambda: _serve(config))


OPEN_MODE = "OPEN MODE: [tls] enabled = false, so whoever reaches the ports of %s may read and say anything"


def _of_site(host: str, site_file: Path | None) -> ZenohConfig:
    site, keys = read_site(site_file)
    try:
        return router_config(site, host, keys)
    except ConfigError as error:
        fail(str(error), code=2)


def _serve(config: ZenohConfig) -> bool:
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)
    for endpoint in config.listen:
        _refuse_taken(endpoint)
    try:
        session = open_session(config)
    except ConfigError as error:
        fail(f"{error}; is another router or demo running on {', '.join(config.listen)}?", code=2)
    log.info("listening on %s", ", ".join(config.listen))
    watchdog = Watchdog("router")
    watchdog.ready("routing")
    try:
        while not threading.Event().wait(HEARTBEAT_S):
            session.info.transports()  # answers only while the session's own threads do
            watchdog.alive()
    finally:
        clean = close_session(session)
    return clean


def _refuse_taken(endpoint: str) -> None:
    """Zenoh would wait for a taken port as it waits for an address that is not there yet; only the latter is wanted."""
    found = re.fullmatch(r"(?:tcp|tls)/\[?([^\]]+?)\]?:(\d+)(?:[?#].*)?", endpoint)
    if found is None:
        return
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(found[1], int(found[2]), type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            fail(f"{endpoint}: the port is taken; is another router or demo running?", code=2)
