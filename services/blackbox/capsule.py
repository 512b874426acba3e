"""Incident capsules on disk: written by one host, merged from all.

A host's capsule holds what arrived there in the window. Merging puts the capsules of all hosts on fusion's clock, with
the offsets that fusion had measured at the time; what several hosts kept is kept once.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from common.codec import DecodeError, decode
from common.messages import SystemHealth
from common.recording.file import RecordingFile
from common.recording.reader import Recorded, read
from common.topics import FUSION_HEALTH, find_topic
from services.blackbox.ring import Kept
from services.blackbox.trigger import NAME, Incident


@dataclass(frozen=True)
class HostClock:
    """A host's clock minus fusion's, true within ``bound_s``; None = it was not known."""

    offset_s: float | None
    bound_s: float | None


def write_capsule(folder: Path, host: str, incident: Incident, kept: Iterable[Kept], about: dict[str, str]) -> Path:
    """Write ``<folder>/<incident>/<host>.mcap``, under another name until it is complete."""
    target = folder / incident.name / f"{host}.mcap"
    target.parent.mkdir(parents=True, exist_ok=True)
    unfinished = target.with_suffix(".part")
    unfinished.unlink(missing_ok=True)
    metadata = {"incident": {"name": incident.name, "why": incident.why, "at_ns": str(incident.at_ns), "host": host}}
    with RecordingFile(unfinished, {**metadata, "spotter": about}) as file:
        for one in kept:
            topic = find_topic(one.key)
            if topic is not None:
                _add(file, Recorded(one.key, one.payload, one.log_ns), one.log_ns)
    unfinished.replace(target)
    return target


def incidents(folder: Path) -> list[str]:
    """Names of the incidents with a complete capsule, oldest first."""
    return sorted({path.parent.name for path in folder.glob("*/*.mcap") if NAME.match(path.parent.name)})


def keep_newest(folder: Path, count: int) -> None:
    """Remove the oldest incidents beyond ``count``."""
    for name in incidents(folder)[:-count]:
        shutil.rmtree(folder / name)


def merge(capsules: dict[str, Path], fusion_host: str, target: Path) -> dict[str, HostClock]:
    """One file from the capsules of all hosts, on fusion's clock; returns the offsets that were applied.

    Raises:
        RecordingError: a capsule is damaged.
        FileExistsError: the target is there already.
    """
    clocks = host_clocks(capsules, fusion_host)
    merged: dict[tuple[str, bytes], int] = {}
    for host in sorted(capsules, key=lambda name: name != fusion_host):  # fusion's own arrival times come first
        shift_ns = int((clocks[host].offset_s or 0.0) * 1e9)
        for one in read(capsules[host]):
            merged.setdefault((one.key, one.payload), one.log_ns - shift_ns)
    metadata = {"clocks": {host: json.dumps(vars(clock)) for host, clock in clocks.items()}}
    with RecordingFile(target, metadata) as file:
        for (key, payload), log_ns in sorted(merged.items(), key=lambda item: item[1]):
            _add(file, Recorded(key, payload, log_ns), log_ns)
    return clocks


def host_clocks(capsules: dict[str, Path], fusion_host: str) -> dict[str, HostClock]:
    """What fusion knew of each host's clock, from the last health message in its own capsule."""
    clocks = dict.fromkeys(capsules, HostClock(None, None))
    clocks[fusion_host] = HostClock(0.0, 0.0)
    for system in _health_messages(capsules.get(fusion_host)):
        for name, clock in system.clocks.items():
            host = name.split("/")[0]
            if host in clocks and host != fusion_host:
                clocks[host] = HostClock(clock.offset_ms / 1e3, clock.bound_ms / 1e3)
    return clocks


def _health_messages(path: Path | None) -> Iterable[SystemHealth]:
    for one in read(path) if path else ():
        if one.key.endswith(f"/{FUSION_HEALTH.name}"):
            try:
                yield decode(one.payload, SystemHealth)
            except DecodeError:
                continue


def _add(file: RecordingFile, one: Recorded, log_ns: int) -> None:
    topic = find_topic(one.key)
    if topic is None:
        return
    try:
        message = decode(one.payload, topic.message, topic.max_bytes)
    except DecodeError:
        return
    file.add(one.key, topic.message, one.payload, log_ns, message.sent_ns, message.seq)
    if _can_convert():
        from common.recording.foxglove import convert

        for name, converted in convert(one.key, message):
            file.add_foxglove(name, converted, log_ns, message.stamp_ns)


def _can_convert() -> bool:
    import importlib.util

    return importlib.util.find_spec("foxglove") is not None
