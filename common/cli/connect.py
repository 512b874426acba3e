"""How a command of `spotter` reaches the bus: ``--connect``, ``--namespace``, or SPOTTER_CONNECT, SPOTTER_NAMESPACE."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer
import zenoh

from common.cli.fail import fail
from common.config import ConfigError, ZenohConfig
from common.session import close_session, init_zenoh_log, open_session

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
GIVE_UP_AFTER_S = 3.0

Connect = Annotated[
    str, typer.Option("--connect", envvar="SPOTTER_CONNECT", help="The router's endpoint; several with commas.")
]
Namespace = Annotated[
    str, typer.Option("--namespace", envvar="SPOTTER_NAMESPACE", help="The site: first chunk of every key.")
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object a line, for programs.")]


@contextmanager
def bus(connect: str, namespace: str) -> Iterator[zenoh.Session]:
    """A client session for a command; ends the program with one line when nobody answers."""
    init_zenoh_log(None)
    config = ZenohConfig(connect=tuple(connect.split(",")), namespace=namespace)
    try:
        session = open_session(config, give_up_after_s=GIVE_UP_AFTER_S)
    except (ConnectionError, ConfigError) as error:
        fail(str(error))
    try:
        yield session
    finally:
        close_session(session)
