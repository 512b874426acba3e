"""``spotter-infra-lidar recalibrate``: ask the running service to find the road again."""

from __future__ import annotations

import sys
import threading

import typer
import zenoh

from common.bus.runtime import Service
from common.bus.service_app import load_config
from common.bus.session import close_session, open_session
from common.config import ZenohConfig
from services.infra_lidar.config import InfraLidarConfig

ANSWER = "begun; the next frames decide"
ASK_FOR_S = 3.0


def command_key(host: str) -> str:
    """The key at which a host's roadside lidar answers to this command."""
    return f"{host}/infra_lidar/recalibrate"


class RecalibrationRequest:
    """The service's side: ``taken()`` is true once after each request."""

    def __init__(self, service: Service) -> None:
        self._asked = threading.Event()
        self._key = command_key(service.host)
        self._queryable = service.session.declare_queryable(self._key, self._answer)

    def taken(self) -> bool:
        """Whether there was a request since the last call."""
        if not self._asked.is_set():
            return False
        self._asked.clear()
        return True

    def _answer(self, query: zenoh.Query) -> None:
        self._asked.set()
        with query:
            query.reply(self._key, ANSWER)


def ask(config: ZenohConfig, host: str) -> str | None:
    """Ask the service on ``host``; its answer, or None when nobody answers."""
    session = open_session(config, give_up_after_s=ASK_FOR_S)
    try:
        for reply in session.get(command_key(host), timeout=ASK_FOR_S):
            if reply.ok is not None:
                return str(reply.ok.payload.to_string())
        return None
    finally:
        close_session(session)


def recalibrate(context: typer.Context) -> None:
    """Make the running service forget its calibration and background and find the road again."""
    config = load_config(InfraLidarConfig, *context.obj)
    try:
        answer = ask(config.zenoh, config.host)
    except ConnectionError as error:
        answer = None
        sys.stderr.write(f"spotter: {error}\n")
    if answer is None:
        sys.stderr.write(f"spotter: no infra_lidar service answers on {config.host}\n")
        raise typer.Exit(1)
    sys.stdout.write(f"{config.host}: {answer}\n")
