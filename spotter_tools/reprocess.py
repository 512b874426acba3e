"""Runs a sensor's service again over the raw bytes of a recording; the results must equal the recorded ones."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec

from common import topics
from common.bus.raw_tap import with_changes
from common.bus.status import Report
from common.codec import DecodeError, decode, encode, to_builtins
from common.config import ConfigError, load
from common.messages import Message
from common.recording.raw import pieces
from common.recording.reader import files_in, read, read_metadata
from common.source_url import SourceUrl
from common.topics import Topic

NOT_COMPARED = ("seq", "sent_ns", "received_ns", "stage_ms", "source_kind")  # of the run, not of the measurement
OF_THE_LOAD = "processing takes"  # a reason that depends on it too: state and reason are then not compared


@dataclass(frozen=True)
class Reprocessed:
    """Where a service's ``reprocess`` and its configuration are, what goes in and what comes out."""

    package: str
    config: str
    raw: Topic
    result: Topic


SERVICES = {
    "lidar": Reprocessed("services.jetson.lidar", "LidarConfig", topics.LIDAR_RAW, topics.LIDAR_ZONES),
    "radar": Reprocessed("services.radar_pi", "RadarConfig", topics.RADAR_RAW, topics.RADAR_TRACKS),
    "camera": Reprocessed("services.jetson.camera", "CameraConfig", topics.CAMERA_RAW, topics.CAMERA_DETECTIONS),
    "infra_lidar": Reprocessed("services.infra_lidar", "InfraLidarConfig", topics.INFRA_RAW, topics.INFRA_TRACKS),
}


@dataclass
class Outcome:
    """``identical`` of ``compared`` messages; ``difference`` is the first one, empty if there is none."""

    compared: int = 0
    identical: int = 0
    difference: str = ""


def verify_service(service: str, path: Path, config: Path | None = None) -> Outcome:
    """Run the service over the recording's raw bytes and compare its recorded messages with the new ones.

    Raises:
        ConfigError: no raw bytes of it in the recording, not from their beginning, pieces lost, a result that cannot
            be read, or a wrong config.
        RecordingError: the recording is damaged.
    """
    one = SERVICES[service]
    _whole(SourceUrl("mcap", str(path)), one.raw)
    config_type: Any = getattr(import_module(f"{one.package}.config"), one.config)
    source = f"mcap:{path}?rate=0"
    chosen = load(config_type, config) if config else _recorded_config(path, one, config_type)
    effective = msgspec.structs.replace(chosen, source=source)
    again = import_module(f"{one.package}.reprocess").reprocess(effective, Report("reprocess"))
    return compare(_recorded(path, one.result), again)


def _recorded_config(path: Path, one: Reprocessed, config_type: Any) -> Any:
    """The configuration that the service ran with, from the recording's metadata; the defaults where it has none."""
    for file in files_in(path):
        for name, values in read_metadata(file).items():
            if name.partition("/")[2] == one.raw.service and "config" in values:
                return with_changes(config_type(), json.loads(values["config"]))
    return config_type()


def compare(recorded: Iterable[Message], again: Iterable[Message]) -> Outcome:
    """Message by message, matched by their stamps.

    What was recorded before the first and after the last result of the new run has no bytes in the recording.
    """
    said = {message.stamp_ns: message for message in recorded}
    outcome, first_ns, last_ns = Outcome(), None, 0
    for message in again:
        first_ns, last_ns = message.stamp_ns if first_ns is None else first_ns, message.stamp_ns
        before = said.pop(message.stamp_ns, None)
        if before is None:
            continue  # not recorded: the recording ended before it was published
        outcome.compared += 1
        found = _difference(before, decode(encode(message), type(message)))
        outcome.identical += not found
        outcome.difference = outcome.difference or found
    unexplained = [stamp_ns for stamp_ns in said if first_ns is not None and first_ns <= stamp_ns <= last_ns]
    if unexplained and not outcome.difference:
        outcome.difference = f"{len(unexplained)} recorded results do not come again, the first at {unexplained[0]} ns"
    return outcome


def _recorded(path: Path, topic: Topic) -> Iterator[Message]:
    for one in (one for file in files_in(path) for one in read(file)):
        if one.key.partition("/")[2] != topic.name:
            continue
        try:
            yield decode(one.payload, topic.message, topic.max_bytes)
        except DecodeError as error:
            raise ConfigError(f"{path}: {one.key} of {one.log_ns} ns cannot be read: {error}") from None


def _whole(url: SourceUrl, topic: Topic) -> None:
    """Raise ``ConfigError`` unless every piece from the first one on is there."""
    for expected, piece in enumerate(pieces(url, topic)):
        if piece.index != expected:
            where = "begin" if expected == 0 else f"go on after piece {expected - 1}"
            raise ConfigError(
                f"{url.target}: the raw bytes of {topic.service} {where} with piece {piece.index}, so the results "
                "cannot be the same; start `spotter record --raw` before the service"
            )


def _difference(before: Message, after: Message) -> str:
    old, new = to_builtins(before), to_builtins(after)
    loaded = any(OF_THE_LOAD in one.get("reason", "") for one in (old, new))
    left_out = (*NOT_COMPARED, "state", "reason") if loaded else NOT_COMPARED
    for name in old:
        if name not in left_out and old[name] != new[name]:
            return f"at {before.stamp_ns} ns: {name} was {old[name]!r}, now it is {new[name]!r}"
    return ""
