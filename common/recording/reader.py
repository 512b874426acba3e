"""Reading our recordings, whole ones and those whose recorder was killed."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary as McapSummary
from zstandard import ZstdError

from common.recording.elapsed import Elapsed
from common.topics import find_topic

SPOTTER_SCHEMA = "spotter."
WRITTEN_BY = "written by"  # name of the metadata that say which recorder wrote a file, and as which of its files
HEAD_RECORDS = 3  # they are among the first
MAGIC = b"\x89MCAP0\r\n"
DAMAGE = (
    McapError,
    ZstdError,
    struct.error,
    EOFError,
    ValueError,
    LookupError,
    ArithmeticError,
    OSError,
    MemoryError,
)  # errors of the library for damaged bytes


class RecordingError(ValueError):
    """Not a recording, a damaged one, or one that cannot be read."""


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
    duration_s: float  # from the first message to the last, as if no clock had been set


def read(path: Path, start_ns: int | None = None, refused: Counter[str] | None = None) -> Iterator[Recorded]:
    """Our messages in order of arrival; CRCs are checked.

    ``refused`` counts, by key, the messages under a key of ours whose schema or encoding is not ours.

    Raises:
        RecordingError: a chunk fails its CRC, or the file cannot be read. (One without an end is read up to its last
            whole chunk.)
    """
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    for record in _records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message) and (start_ns is None or record.log_time >= start_ns):
            channel = channels.get(record.channel_id)
            if channel is None:
                raise RecordingError(f"{path}: damaged: a message of channel {record.channel_id}, which is not there")
            if _is_ours(schemas.get(channel.schema_id), channel):
                yield Recorded(channel.topic, record.data, record.log_time)
            else:
                _refuse(channel, refused)


def is_complete(path: Path) -> bool:
    """Whether the file is complete: it ends with the format's magic bytes.

    Raises:
        RecordingError: it does not begin as an MCAP file either, or it cannot be read at all.
    """
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise RecordingError(f"{path}: not an MCAP file")
            stream.seek(-len(MAGIC), 2)
            return stream.tell() > len(MAGIC) and stream.read() == MAGIC
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None


def files_in(path: Path) -> list[Path]:
    """The recording itself, or the files of a folder in the order in which they were written.

    Files of one recorder go by its own count, for the time in their names goes back where the clock was set back.
    Recorders, and files that do not say which wrote them, go by name.
    """
    if not path.is_dir():
        return [path]
    places = {file: _place(file) for file in path.glob("*.mcap")}
    first_of: dict[str, tuple[int, str]] = {}
    for file, (recorder, number) in places.items():
        first_of[recorder] = min(first_of.get(recorder, (number, file.name)), (number, file.name))
    return sorted(places, key=lambda file: (first_of[places[file][0]][1], places[file][1], file.name))


def _place(path: Path) -> tuple[str, int]:
    """Which recorder wrote a file, and as which of its files; without that entry, the file is on its own."""
    try:
        with path.open("rb") as stream:
            for record in islice(StreamReader(stream).records, HEAD_RECORDS):
                if isinstance(record, Metadata) and record.name == WRITTEN_BY:
                    return record.metadata["recorder"], int(record.metadata["file"])
    except DAMAGE:  # reported when it is read
        pass
    return path.name, 0


def expected_messages(path: Path) -> int:
    """How many messages of ours the index says there are; 0 when there is no index: for progress bars.

    Raises:
        RecordingError: not an MCAP file, or its index is damaged.
    """
    summary = _index(path)
    if summary is None or summary.statistics is None:
        return 0
    counts = summary.statistics.channel_message_counts
    ours = (one for one in summary.channels.values() if _is_ours(summary.schemas.get(one.schema_id), one))
    return sum(counts.get(channel.id, 0) for channel in ours)


def span_ns(path: Path) -> tuple[int, int]:
    """First and last log time by the index, (0, 0) when there is none. Raises as ``expected_messages``."""
    summary = _index(path)
    statistics = summary.statistics if summary else None
    return (statistics.message_start_time, statistics.message_end_time) if statistics else (0, 0)


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """The metadata records of a complete file; of one without its index none.

    Raises:
        RecordingError: not an MCAP file, or damaged.
    """
    if not is_complete(path):
        return {}
    try:
        with path.open("rb") as stream:
            return {one.name: dict(one.metadata) for one in make_reader(stream, validate_crcs=True).iter_metadata()}
    except DAMAGE as error:
        raise RecordingError(f"{path}: damaged: {error}") from None


def _index(path: Path) -> McapSummary | None:
    if not is_complete(path):
        return None
    try:
        with path.open("rb") as stream:
            return make_reader(stream, validate_crcs=True).get_summary()
    except DAMAGE as error:
        raise RecordingError(f"{path}: damaged: {error}") from None


def summarise(path: Path) -> Summary:
    """Times and counts; reads the whole file when its index is missing.

    Raises:
        RecordingError: not an MCAP file of ours, or empty.
    """
    counts: dict[str, int] = {}
    first_ns = last_ns = into_ns = 0
    elapsed = Elapsed()
    for recorded in read(path):
        into_ns = elapsed.at(recorded.log_ns)
        counts[recorded.key] = counts.get(recorded.key, 0) + 1
        first_ns = first_ns or recorded.log_ns
        last_ns = max(last_ns, recorded.log_ns)
    if not counts:
        raise RecordingError(f"{path}: holds none of our messages")
    return Summary(first_ns, last_ns, counts, is_complete(path), into_ns / 1e9)


def _records(path: Path) -> Iterator[McapRecord]:
    """In the order of the file, chunk by chunk; of a file without its end up to the first chunk that is not whole.

    Not by log time: where a clock was set back, that would mix what came before with what came after.
    """
    whole = is_complete(path)
    with path.open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True).records
        while True:
            try:
                record = next(records)
            except StopIteration:
                return
            except OSError as error:
                raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
            except DAMAGE as error:
                if not whole:
                    return
                raise RecordingError(f"{path}: damaged: {error}") from None
            yield record


def _is_ours(schema: Schema | None, channel: Channel) -> bool:
    return schema is not None and schema.name.startswith(SPOTTER_SCHEMA) and channel.message_encoding == "msgpack"


def _refuse(channel: Channel, refused: Counter[str] | None) -> None:
    if refused is not None and find_topic(channel.topic) is not None:
        refused[channel.topic] += 1
