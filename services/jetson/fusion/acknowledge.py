"""A person's word that a place is free: ends the alarms that no sensor sees now and none can refute."""

from __future__ import annotations

import logging
import threading

import zenoh

from common.bus.runtime import Service

log = logging.getLogger(__name__)

NAME = "acknowledge"
ANSWER = "taken: alarms that no sensor sees now are ended"


class Acknowledgement:
    """The service's side: ``taken()`` is true once after each request."""

    def __init__(self, service: Service) -> None:
        self._asked = threading.Event()
        self._wake = service.wake
        self._key = f"{service.host}/{service.name}/{NAME}"
        self._queryable = service.session.declare_queryable(self._key, self._answer)

    def taken(self) -> bool:
        """Whether somebody has acknowledged since the last call."""
        if not self._asked.is_set():
            return False
        self._asked.clear()
        log.warning("a person acknowledges: alarms that no sensor sees now are ended")
        return True

    def _answer(self, query: zenoh.Query) -> None:
        self._asked.set()
        self._wake.set()
        with query:
            query.reply(self._key, ANSWER)
