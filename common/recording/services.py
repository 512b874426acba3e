"""The running services with version and configuration: metadata of recordings and capsules."""

from __future__ import annotations

import json

import zenoh

from common.bus.vehicles import vehicles_on_bus
from common.codec import DecodeError, decode
from common.messages import ServiceInfo

ANSWER_LIMIT_S = 1.0


def running_services(session: zenoh.Session, host: str = "*") -> dict[str, dict[str, str]]:
    """By ``<host>/<service>``: version, config_hash, instance, source, source_kind, vehicle and, as JSON, config."""
    metadata, vehicles = {}, vehicles_on_bus(session)
    for reply in session.get(f"{host}/*/info", timeout=ANSWER_LIMIT_S):
        if reply.ok is None:
            continue
        try:
            info = decode(reply.ok.payload.to_bytes(), ServiceInfo)
        except DecodeError:
            continue
        metadata[f"{info.host}/{info.service}"] = {
            "version": info.version,
            "config_hash": info.config_hash,
            "instance": info.instance,
            "source": info.source,
            "source_kind": info.source_kind,
            "vehicle": vehicles.get(info.host, ""),
            "config": json.dumps(info.config, sort_keys=True),
        }
    return metadata
