"""Answers queries for capsules: a list, and a file in parts; and takes requests to save one now."""

from __future__ import annotations

import json
import queue
from dataclasses import dataclass
from pathlib import Path

import zenoh

from common.bus.runtime import Service
from common.clock import utc_ns
from services.blackbox.capsule import incidents
from services.blackbox.trigger import NAME, Incident, incident_name

PART_BYTES = 1_000_000


@dataclass(frozen=True)
class SaveRequest:
    """A query that waits for its answer: the main loop knows whether an incident is open already."""

    query: zenoh.Query
    incident: Incident


class CapsuleServer:
    """Queryables ``<host>/blackbox/incidents``, ``.../capsule?name=...;part=...`` and ``.../save?why=...``."""

    def __init__(self, service: Service, folder: Path) -> None:
        self.requests: queue.Queue[SaveRequest] = queue.Queue(16)
        self._host = service.host
        self._folder = folder
        self._base = base = f"{service.host}/blackbox"
        # The list is declared last: who gets an answer to it finds the other two as well.
        self._queryables = [
            service.session.declare_queryable(f"{base}/capsule", self._capsule),
            service.session.declare_queryable(f"{base}/save", self._save),
            service.session.declare_queryable(f"{base}/incidents", self._list),
        ]

    def _list(self, query: zenoh.Query) -> None:
        with query:
            names = [name for name in incidents(self._folder) if self._path(name).is_file()]
            query.reply(f"{self._base}/incidents", json.dumps(names), encoding="application/json")

    def _capsule(self, query: zenoh.Query) -> None:
        with query:
            name = query.parameters.get("name") or ""
            part = query.parameters.get("part") or "0"
            if not NAME.match(name) or not part.isdecimal() or not self._path(name).is_file():
                query.reply_err(b"no such capsule here")
                return
            with self._path(name).open("rb") as stream:
                stream.seek(int(part) * PART_BYTES)
                query.reply(f"{self._base}/capsule", stream.read(PART_BYTES))

    def _save(self, query: zenoh.Query) -> None:
        """Every host takes the asker's time and words, so that all capsules carry one name."""
        why = (query.parameters.get("why") or "asked for")[:200]
        at = query.parameters.get("at_ns") or ""
        at_ns = int(at) if at.isdecimal() and len(at) < 20 else utc_ns()
        try:
            self.requests.put_nowait(SaveRequest(query, Incident(incident_name(at_ns, "saved"), at_ns, why)))
        except queue.Full:
            with query:
                query.reply_err(b"too many requests at once")

    def answer(self, request: SaveRequest, opened: Incident) -> None:
        """Name the incident that will be written: the requested one, or the one that was open already."""
        said = {"incident": opened.name, "new": opened is request.incident}
        with request.query as query:
            query.reply(f"{self._base}/save", json.dumps(said), encoding="application/json")

    def _path(self, name: str) -> Path:
        return self._folder / name / f"{self._host}.mcap"
