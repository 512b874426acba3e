"""How a command of `spotter` reaches the bus: ``--connect``, ``--namespace``, or SPOTTER_CONNECT, SPOTTER_NAMESPACE.

A laptop at a router with TLS also sets SPOTTER_CERTIFICATE.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
import zenoh

from common.bus.namespace import settled
from common.bus.session import close_session, init_zenoh_log, open_session
from common.config import ConfigError, ZenohConfig
from common.security.router_config import with_certificate
from spotter_tools.cli.fail import fail

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
GIVE_UP_AFTER_S = 3.0


def _one_chunk(text: str) -> str:
    if not re.fullmatch("[a-z0-9_]*", text):
        raise typer.BadParameter(f"{text!r}: expected one chunk of a key, of a-z, 0-9 and _")
    return text


Connect = Annotated[
    str, typer.Option("--connect", envvar="SPOTTER_CONNECT", help="The router's endpoint; several with commas.")
]
Namespace = Annotated[
    str,
    typer.Option(
        "--namespace",
        envvar="SPOTTER_NAMESPACE",
        callback=_one_chunk,
        help="The site: first chunk of every key. Without it `spotter`, or `demo` where only a demo runs.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object a line, for programs.")]


def one_host(text: str) -> str:
    """For options that name a host: its name, or ``*`` for all.

    Raises:
        typer.BadParameter: neither.
    """
    if text != "*" and not re.fullmatch("[a-z0-9_]+", text):
        raise typer.BadParameter(f"{text!r}: expected the name of a host (a-z, 0-9 and _), or *")
    return text


def own_name(text: str) -> str:
    """For options that name a host or laptop, or nothing where they are not given.

    Raises:
        typer.BadParameter: no such name.
    """
    if text and not re.fullmatch("[a-z0-9_]+", text):
        raise typer.BadParameter(f"{text!r}: expected a name of a-z, 0-9 and _")
    return text


@contextmanager
def bus(connect: str, namespace: str) -> Iterator[zenoh.Session]:
    """A client session for a command; ends the program with one line when no router answers."""
    init_zenoh_log(None)
    try:
        session = open_session(_config(connect, namespace), give_up_after_s=GIVE_UP_AFTER_S)
    except (ConnectionError, ConfigError) as error:
        fail(str(error))
    try:
        yield session
    finally:
        close_session(session)


def namespace_in_use(connect: str, namespace: str) -> str:
    """The namespace that ``bus`` uses; ends the program with one line when no router answers."""
    try:
        return namespace or _config(connect, namespace).namespace
    except (ConnectionError, ConfigError) as error:
        fail(str(error))


def _config(connect: str, namespace: str) -> ZenohConfig:
    config = _certified(ZenohConfig(connect=tuple(connect.split(",")), namespace=namespace))
    return settled(config, GIVE_UP_AFTER_S)


def certified_name() -> str:
    """The name in SPOTTER_CERTIFICATE=keys/laptop1.crt; empty without one."""
    return Path(os.environ.get("SPOTTER_CERTIFICATE", "")).stem


def _certified(config: ZenohConfig) -> ZenohConfig:
    """SPOTTER_CERTIFICATE=keys/laptop1.crt; the key and ``ca.crt`` are beside it. Nothing in the open mode."""
    name = certified_name()
    return with_certificate(config, Path(os.environ["SPOTTER_CERTIFICATE"]).parent, name) if name else config
