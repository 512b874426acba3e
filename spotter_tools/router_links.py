"""Finds out which hosts cannot be linked because of clock or certificate.

Each fault is logged once; services and commands of this host can query ``<host>/router/links``.
"""

from __future__ import annotations

import logging
import threading
from pathlib import Path

import zenoh

from common.clock import utc_ns
from common.codec import encode_for_readers, encoding_of
from common.config import ZenohConfig
from common.host.site import Site
from common.messages import LinkFault, RouterLinks
from common.topics import links_key, token_key
from spotter_tools.doctor.link_faults import OwnFiles, link_fault

log = logging.getLogger("router")
PERIOD_S = 3.0


class LinkWatch:
    """Checks every few seconds, in a thread, the hosts without any visible service; ends with the session."""

    def __init__(self, session: zenoh.Session, site: Site, host: str, config: ZenohConfig) -> None:
        self._session, self._site, self._host = session, site, host
        self._files = OwnFiles(Path(config.ca_certificate), Path(config.certificate), Path(config.private_key))
        self._faults: dict[str, LinkFault] = {}
        self._pause = threading.Event()
        self._key = f"{site.namespace}/{links_key(host)}"
        self._queryable = session.declare_queryable(self._key, self._answer)
        threading.Thread(target=self._look, name="links", daemon=True).start()

    def close(self) -> None:
        """Stop the checks."""
        self._pause.set()

    def _look(self) -> None:
        while not self._pause.is_set():
            try:
                faults = {name: fault for name in self._site.hosts if (fault := self._fault(name)) is not None}
            except zenoh.ZError:
                return  # the session is closed
            for name, fault in faults.items():
                if self._faults.get(name) != fault:
                    log.error("%s is not linked: %s", name, fault.why)
            self._faults = faults
            self._pause.wait(PERIOD_S)

    def _fault(self, name: str) -> LinkFault | None:
        if name == self._host or self._is_heard(name):
            return None
        other = self._site.host(name)
        return link_fault(self._files, name, other.address, other.port)

    def _is_heard(self, name: str) -> bool:
        tokens = f"{self._site.namespace}/{token_key(name, '*', '*')}"
        return any(reply.ok is not None for reply in self._session.liveliness().get(tokens, timeout=1.0))

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            message = RouterLinks(stamp_ns=utc_ns(), faults=self._faults)
            query.reply(self._key, encode_for_readers(message)[0], encoding=encoding_of(RouterLinks))
