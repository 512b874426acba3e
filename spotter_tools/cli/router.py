"""`spotter router`: an embedded Zenoh router, where no zenohd container is wanted."""

from __future__ import annotations

import json
import logging
import os
import sys
import threading
from pathlib import Path
from typing import Annotated, NoReturn

import typer
import zenoh

from common.bus.service_app import run_until_stopped, setup_logging
from common.bus.session import build, close_session, init_zenoh_log, nested_settings, open_session
from common.bus.tcp_timeout import set_tcp_user_timeout
from common.bus.watchdog import Watchdog
from common.config import ConfigError, ZenohConfig
from common.host.site import keys_folder, load_site
from common.security.names import NamesWatch
from common.security.router_config import router_config
from spotter_tools.cli.connect import Namespace
from spotter_tools.cli.fail import fail
from spotter_tools.cli.site_option import SiteFile
from spotter_tools.ports import refuse_taken
from spotter_tools.router_links import LinkWatch

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
    of_site: _OfSite | None = None
    if host:
        try:
            of_site = _OfSite(host, site_file)
        except ConfigError as error:
            fail(str(error), code=2)
        config = of_site.config
    else:
        # A router relays keys as they are: the namespace belongs to the publishing sessions, not to the relay.
        endpoints = tuple(listen or ["tcp/127.0.0.1:7447"])
        config = ZenohConfig(mode="router", listen=endpoints, connect=tuple(link or ()), namespace="")
    if show:
        sys.stdout.write(json.dumps(nested_settings(config), indent=2) + "\n")
        return
    setup_logging("router")
    init_zenoh_log("error")
    if host and not config.certificate:
        log.warning(OPEN_MODE, host)
    run_until_stopped(lambda: _serve(config, of_site))


OPEN_MODE = "OPEN MODE: [tls] enabled = false, so whoever reaches the ports of %s may read and say anything"


class _OfSite:
    """The router of a host of the site, and whether another one is wanted by now.

    Zenoh reads its rules once, so new ones call for a new router: but not before it would find all that it needs.
    """

    def __init__(self, host: str, site_file: Path | None) -> None:
        self._host = host
        self._site_file = site_file.absolute() if site_file else None  # zenohd reads the paths from another folder
        self._error_text = ""
        self.config, self._watch = self._read()
        self._links: LinkWatch | None = None

    def _read(self) -> tuple[ZenohConfig, NamesWatch]:
        self._site = load_site(self._site_file)
        folder = keys_folder(self._site, self._site_file)
        watch = NamesWatch(folder)
        return router_config(self._site, self._host, folder), watch

    def watch_links(self, session: zenoh.Session) -> None:
        """Report from now on why another host cannot be linked. Without TLS only the network can be the reason."""
        if self.config.certificate:
            self._links = LinkWatch(session, self._site, self._host, self.config)

    def outdated(self) -> bool:
        """A name was revoked, or has another certificate."""
        try:
            if not self._watch.changed():
                return False
            self._read()
        except ConfigError as error:
            if str(error) != self._error_text:
                log.error("%s; until it is corrected the old rules stay", error)
                self._error_text = str(error)
            return False
        log.warning("the names of the site have changed: starting again with new rules")
        return True


def _serve(config: ZenohConfig, of_site: _OfSite | None) -> NoReturn:
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)
    try:
        for endpoint in config.listen:
            refuse_taken(endpoint, "is another router or demo running?")
        build(config)  # an error in the settings is not the fault of another process
    except ConfigError as error:
        fail(str(error), code=2)
    try:
        session = open_session(config)
    except ConfigError as error:
        fail(f"{error}; is another router or demo running on {', '.join(config.listen)}?", code=2)
    log.info("listening on %s", ", ".join(config.listen))
    if of_site is not None:
        of_site.watch_links(session)
    watchdog = Watchdog("router")
    watchdog.ready("routing")
    try:
        while of_site is None or not of_site.outdated():
            threading.Event().wait(HEARTBEAT_S)
            set_tcp_user_timeout(config.lease_ms / 1e3)  # again and again: neighbours come and go
            session.info.transports()  # answers only while the session's own threads do
            watchdog.alive()
    finally:
        close_session(session)
    _begin_again()


def _begin_again() -> NoReturn:
    """As the same process, so that no supervisor has to know."""
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
