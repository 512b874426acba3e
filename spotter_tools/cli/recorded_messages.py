"""A recording's messages for an export, typed; what cannot be read is counted. Opens the file."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from common.codec import DecodeError, decode
from common.messages import Message, ObjectTracks
from common.topics import INFRA_TRACKS, find_topic
from spotter_tools.cli.fail import fail, needs_extra
from spotter_tools.cli.progress import Progress


def messages(file: Path, unreadable: Counter[str]) -> Iterator[tuple[str, Message, int]]:
    """(key, message, UTC ns of the first message's arrival); ends the program where the file cannot be read."""
    try:
        from common.recording.reader import RecordingError, expected_messages, read
    except ImportError:
        needs_extra("exporting needs", "record")
    if not file.exists():
        fail(f"{file}: no such file", code=2)
    progress, first_ns = Progress(), 0
    try:
        say_if_cut(file)
        of = expected_messages(file)
        for done, recorded in enumerate(read(file, refused=unreadable)):
            first_ns = first_ns or recorded.log_ns
            progress.share(done, of, f"{(recorded.log_ns - first_ns) / 1e9:.0f} s")
            topic = find_topic(recorded.key)
            if topic is None:
                continue
            try:
                message = decode(recorded.payload, topic.message, topic.max_bytes)
            except DecodeError:
                unreadable[recorded.key] += 1
                continue
            yield recorded.key, message, first_ns
    except RecordingError as error:
        fail(str(error))
    finally:
        progress.close()
    if not first_ns and not unreadable:
        fail(f"{file}: holds none of our messages")


def say_if_cut(recording: Path) -> None:
    """A file without an end, or one in the folder, is used as far as it goes; whoever uses it is told so.

    Raises:
        RecordingError: it cannot be read at all.
    """
    from common.recording.reader import files_in, is_complete

    for file in files_in(recording):
        if not is_complete(file):
            print(f"spotter: {file} has no end: cut off, or still written; what may follow is missing", file=sys.stderr)


def by_key(counts: Counter[str]) -> str:
    """``3 of pi0/radar/tracks, 1 of jetson0/lidar/zones``."""
    return ", ".join(f"{count} of {key}" for key, count in counts.most_common())


def tracks(file: Path, unreadable: Counter[str], host: str) -> Iterator[tuple[str, ObjectTracks]]:
    """(host, tracks) of the roadside hosts, or of ``host``; ends the program where there are none."""
    seen: set[str] = set()
    for key, message, _ in messages(file, unreadable):
        own = key.partition("/")[0]
        if isinstance(message, ObjectTracks) and key == INFRA_TRACKS.key(own):
            seen.add(own)
            if host in ("", own):
                yield own, message
    lost = Counter({key: n for key, n in unreadable.items() if key == INFRA_TRACKS.key(key.partition("/")[0])})
    if not seen and lost:
        fail(f"{file}: {lost.total()} messages could not be read, no others of their kind are there: {by_key(lost)}")
    if not seen:
        fail(f"{file}: holds no {INFRA_TRACKS.name}: these are the tracks that this form is made of")
    if host and host not in seen:
        fail(f"{file}: --host {host}: no tracks of it; of: {', '.join(sorted(seen))}", code=2)


def one_host(recorded: Iterator[tuple[str, ObjectTracks]], why: str) -> Iterator[tuple[str, ObjectTracks]]:
    """The same; ends the program where a second host's tracks come."""
    first = ""
    for host, message in recorded:
        first = first or host
        if host != first:
            fail(f"tracks of {first} and {host}, and {why}: choose with --host", code=2)
        yield host, message
