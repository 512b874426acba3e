"""Which host belongs to which vehicle, asked from the fusions on the bus: each knows its vehicle's hosts."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import zenoh

from common.codec import DecodeError, decode
from common.messages import ServiceInfo
from common.topics import info_key

ANSWER_LIMIT_S = 1.0
ROADSIDE = "roadside"


def vehicles_on_bus(session: zenoh.Session) -> dict[str, str]:
    """Ask every fusion. ``{"pi0": "car0", ...}``; empty where no vehicle has a name."""
    replies = session.get(
        info_key("*", "fusion"),
        timeout=ANSWER_LIMIT_S,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    return vehicles_in([reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None])


def vehicles_in(answers: Iterable[bytes]) -> dict[str, str]:
    """From the ``ServiceInfo`` of the fusions; undecodable ones are left out."""
    found: dict[str, str] = {}
    for answer in answers:
        try:
            vehicle: Any = decode(answer, ServiceInfo).config.get("vehicle")
        except DecodeError:
            continue
        if isinstance(vehicle, dict) and vehicle.get("name"):
            found |= {host: ROADSIDE for host in _names(vehicle.get("roadside_hosts")) if host not in found}
            found |= {host: str(vehicle["name"]) for host in _names(vehicle.get("hosts"))}
    return found


def _names(hosts: object) -> list[str]:
    """Of a list; a fusion of another version may have something else there."""
    return [str(host) for host in hosts] if isinstance(hosts, list | tuple) else []
