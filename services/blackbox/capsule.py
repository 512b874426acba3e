"""Incident capsules on disk: written by one host, merged from all.

A host's capsule holds what arrived there in the window. Merging puts the capsules of all hosts on fusion's clock, with
the offsets that the host itself or fusion had measured at the time; what several hosts kept is kept once. Messages stay
byte for byte what they were, for `verify`; what is drawn from them for Foxglove is on the one clock, too.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from common.codec import DecodeError, decode
from common.messages import SystemHealth
from common.recording.file import RecordingFile
from common.recording.reader import Recorded, read, read_metadata
from common.topics import FUSION_HEALTH, find_topic
from services.blackbox.ring import Kept
from services.blackbox.trigger import NAME, Incident


@dataclass(frozen=True)
class HostClock:
    """A host's clock minus fusion's, true within ``bound_s``; None = it was not known."""

    offset_s: float | None
    bound_s: float | None


UNKNOWN = HostClock(None, None)


def write_capsule(
    folder: Path,
    host: str,
    incident: Incident,
    kept: Iterable[Kept],
    about: dict[str, dict[str, str]],
    clock: HostClock = UNKNOWN,
) -> Path:
    """Write ``<folder>/<incident>/<host>.mcap``, under another name until it is complete.

    ``about``: further metadata, by name: who spoke, with which version and configuration.

    Raises:
        OSError: the folder or the disk takes no file; nothing of it is left.
    """
    target = folder / incident.name / f"{host}.mcap"
    target.parent.mkdir(parents=True, exist_ok=True)
    unfinished = target.with_suffix(".part")
    unfinished.unlink(missing_ok=True)
    metadata = {"incident": {"name": incident.name, "why": incident.why, "at_ns": str(incident.at_ns), "host": host}}
    said = {**metadata, **about, "clock": {"json": json.dumps(vars(clock))}}
    try:
        with RecordingFile(unfinished, said, whole=True) as file:  # half a capsule would only fill the disk further
            for one in kept:
                _add(file, Recorded(one.key, one.payload, one.log_ns))
        unfinished.replace(target)
    except OSError:
        with suppress(OSError):  # there may be something else in it
            target.parent.rmdir()
        raise
    return target


def incidents(folder: Path) -> list[str]:
    """Names of the incidents with a complete capsule, oldest first."""
    return sorted({path.parent.name for path in folder.glob("*/*.mcap") if NAME.match(path.parent.name)})


def keep_newest(folder: Path, count: int, written: Sequence[str]) -> None:
    """Remove the oldest incidents beyond ``count``.

    written: names in the order in which this process wrote them. They are newer than all others, whatever a clock that
    was set back has made of their names.
    """
    found = sorted(incidents(folder), key=lambda name: written.index(name) if name in written else -1)
    for name in found[:-count]:
        shutil.rmtree(folder / name)


def merge(capsules: dict[str, Path], fusion_host: str, target: Path) -> dict[str, HostClock]:
    """One file from the capsules of all hosts, on fusion's clock; returns the offsets that were applied.

    Raises:
        RecordingError: a capsule is damaged.
        FileExistsError: the target is there already.
        OSError: the disk takes no such file; nothing of it is left.
    """
    clocks = host_clocks(capsules, fusion_host)
    ahead_ns = {host: int((clock.offset_s or 0.0) * 1e9) for host, clock in clocks.items()}
    merged: dict[tuple[str, bytes], int] = {}
    for host in sorted(capsules, key=lambda name: name != fusion_host):  # fusion's own arrival times come first
        for one in read(capsules[host]):
            merged.setdefault((one.key, one.payload), one.log_ns - ahead_ns[host])
    with RecordingFile(target, _metadata_of(capsules, clocks), whole=True) as file:
        for (key, payload), log_ns in sorted(merged.items(), key=lambda item: item[1]):
            _add(file, Recorded(key, payload, log_ns), ahead_ns.get(key.partition("/")[0], 0))
    return clocks


def _metadata_of(capsules: dict[str, Path], clocks: dict[str, HostClock]) -> dict[str, dict[str, str]]:
    """The clocks that were applied, and what the capsules say: of their services as it is, of themselves by host."""
    metadata = {"clocks": {host: json.dumps(vars(clock)) for host, clock in clocks.items()}}
    for host, path in capsules.items():
        for name, values in read_metadata(path).items():
            metadata[name if "/" in name else f"{name} of {host}"] = values
    return metadata


def host_clocks(capsules: dict[str, Path], fusion_host: str) -> dict[str, HostClock]:
    """The tightest of what each host and fusion knew: the capsules' own words, and the last health message."""
    clocks = {host: _own_word(path) for host, path in capsules.items()}
    for system in _health_messages(capsules.get(fusion_host)):
        for name, clock in system.clocks.items():
            measured, host = HostClock(clock.offset_ms / 1e3, clock.bound_ms / 1e3), name.partition("/")[0]
            if host in clocks and _bound_s(measured) <= _bound_s(clocks[host]):
                clocks[host] = measured
    clocks[fusion_host] = HostClock(0.0, 0.0)
    return clocks


def _own_word(path: Path) -> HostClock:
    """What the host had measured itself; unknown where the capsule does not say, or not sensibly."""
    try:
        return msgspec.json.decode(read_metadata(path).get("clock", {}).get("json", "{}"), type=HostClock)
    except msgspec.DecodeError:
        return UNKNOWN


def _bound_s(clock: HostClock) -> float:
    return float("inf") if clock.bound_s is None else clock.bound_s


def _health_messages(path: Path | None) -> Iterable[SystemHealth]:
    for one in read(path) if path else ():
        if one.key.endswith(f"/{FUSION_HEALTH.name}"):
            try:
                yield decode(one.payload, SystemHealth)
            except DecodeError:
                continue


def _add(file: RecordingFile, one: Recorded, ahead_ns: int = 0) -> None:
    """``ahead_ns``: by how much the clock of the message's author was ahead of the file's."""
    topic = find_topic(one.key)
    if topic is None:
        return
    try:
        message = decode(one.payload, topic.message, topic.max_bytes)
    except DecodeError:
        return
    sent_ns = message.sent_ns - ahead_ns if message.sent_ns else 0
    file.add(one.key, topic.message, one.payload, one.log_ns, sent_ns, message.seq)
    if _can_convert():
        from common.recording.foxglove import convert

        message.stamp_ns = max(0, message.stamp_ns - ahead_ns)
        for name, converted in convert(one.key, message):
            file.add_foxglove(name, converted, one.log_ns, message.stamp_ns)


def _can_convert() -> bool:
    import importlib.util

    return importlib.util.find_spec("foxglove") is not None
