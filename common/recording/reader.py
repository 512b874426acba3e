"""Reading our recordings, whole ones and those whose recorder was killed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

SPOTTER_SCHEMA = "spotter."


class RecordingError(ValueError):
    """Not a recording, or a damaged one."""


@dataclass(frozen=True)
class Recorded:
    """One of our messages as it was on the wire, and when it arrived at the recorder."""

    key: str
    payload: bytes
    log_ns: int


@dataclass(frozen=True)
class Summary:
    """What a file holds."""

    start_ns: int
    end_ns: int
    counts: dict[str, int]
    complete: bool  # False: the recorder was killed, the index is missing

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) / 1e9


def read(path: Path, start_ns: int | None = None) -> Iterator[Recorded]:
    """Our messages in order of arrival; CRCs are checked.

    Raises:
        RecordingError: a chunk fails its CRC. (A file without an end is read up to its last whole chunk.)
    """
    if not _has_index(path):
        yield from _read_cut(path, start_ns)
        return
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            for schema, channel, message in reader.iter_messages(start_time=start_ns):
                if (
                    schema is not None
                    and schema.name.startswith(SPOTTER_SCHEMA)
                    and channel.message_encoding == "msgpack"
                ):
                    yield Recorded(channel.topic, message.data, message.log_time)
    except McapError as error:
        raise RecordingError(f"{path}: {error}") from None


def summarise(path: Path) -> Summary:
    """Times and counts; reads the whole file when its index is missing.

    Raises:
        RecordingError: not an MCAP file of ours, or empty.
    """
    counts: dict[str, int] = {}
    first_ns = last_ns = 0
    complete = _has_index(path)
    for recorded in read(path):
        counts[recorded.key] = counts.get(recorded.key, 0) + 1
        first_ns = first_ns or recorded.log_ns
        last_ns = max(last_ns, recorded.log_ns)
    if not counts:
        raise RecordingError(f"{path}: holds none of our messages")
    return Summary(first_ns, last_ns, counts, complete)


def _has_index(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return make_reader(stream).get_summary() is not None
    except McapError:
        return False


def _read_cut(path: Path, start_ns: int | None) -> Iterator[Recorded]:
    """A file without its end: chunk by chunk, up to the first that is not whole."""
    from mcap.records import Channel, Message, Schema

    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    with path.open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True).records
        while True:
            try:
                record = next(records)
            except (StopIteration, McapError, EOFError):
                return
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                ours = schemas[channel.schema_id].name.startswith(SPOTTER_SCHEMA)
                late_enough = start_ns is None or record.log_time >= start_ns
                if ours and channel.message_encoding == "msgpack" and late_enough:
                    yield Recorded(channel.topic, record.data, record.log_time)
