"""`spotter router`: an embedded Zenoh router, where no zenohd container is wanted."""

from __future__ import annotations

import logging
import threading
from typing import Annotated

import typer

from common.cli.connect import Namespace
from common.cli.fail import fail
from common.config import ConfigError, ZenohConfig
from common.launch import run_until_stopped, setup_logging
from common.session import close_session, init_zenoh_log, open_session

log = logging.getLogger("router")


def router(
    listen: Annotated[
        list[str] | None, typer.Option("--listen", help="Endpoint to listen on; may be given several times.")
    ] = None,
    link: Annotated[
        list[str] | None, typer.Option("--link", help="Another host's router to link to; may be repeated.")
    ] = None,
    namespace: Namespace = "spotter",
) -> None:
    """Run a router until Ctrl-C. Services on this host are its clients; routers link to each other."""
    endpoints = tuple(listen or ["tcp/127.0.0.1:7447"])
    # A router relays keys as they are: the namespace belongs to the sessions that speak, not to the relay.
    config = ZenohConfig(mode="router", listen=endpoints, connect=tuple(link or ()), namespace="")
    setup_logging("router")
    init_zenoh_log("error")
    run_until_stopped(lambda: _serve(config))


def _serve(config: ZenohConfig) -> bool:
    try:
        session = open_session(config)
    except ConfigError as error:
        fail(f"{error}; is another router or demo running on {', '.join(config.listen)}?", code=2)
    log.info("listening on %s", ", ".join(config.listen))
    try:
        threading.Event().wait()
    finally:
        clean = close_session(session)
    return clean
