"""``mcap:PATH?rate=1&loop=1&host=jetson0``: raw bytes of a recording (a file, or a folder) as a source.

At ``rate=1`` all stamps move by one and the same time, so that they are those of now; ``rate=0`` does not wait and
keeps the stamps as recorded. Either way the results are those of the recording, if it begins with the first piece.
Where the clock was set while it was recorded, the pieces are played as if it had not been.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec

from common.bus.raw_tap import C, with_changes
from common.clock import monotonic_s, utc_ns
from common.codec import DecodeError, decode
from common.config import ConfigError
from common.messages import Motion, RawBytes
from common.pacing import Wait, wait_until
from common.recording.elapsed import Elapsed
from common.source_url import SourceUrl
from common.topics import Topic

MCAP_PARAMETERS = ("rate", "loop", "host")
PERIOD_NS = 100_000_000  # between the last piece and the first one of the next turn
FARTHEST_S = 3600.0  # a sensor may have been away for so long


def replayed(url: SourceUrl, topic: Topic, wait: Wait | None = None) -> Iterator[RawBytes]:
    """The pieces of ``topic``, each when it is due.

    Raises:
        ConfigError: no such file, not a recording, damaged, or one without raw bytes of this service.
    """
    rate = url.number("rate", 1.0)
    start_s, start_ns, turn_ns, into_ns = monotonic_s(), utc_ns(), 0, 0
    while True:
        elapsed = Elapsed(FARTHEST_S)
        for piece in pieces(url, topic):
            into_ns = turn_ns + elapsed.at(piece.stamp_ns)
            if rate > 0:
                due_ns = into_ns if rate == 1.0 else round(into_ns / rate)
                wait_until(start_s + due_ns * 1e-9, wait)
                _move(piece, start_ns + due_ns)
            yield piece
        if not url.flag("loop"):
            return
        turn_ns = into_ns + PERIOD_NS


def pieces(url: SourceUrl, topic: Topic) -> Iterator[RawBytes]:
    """The pieces as they were recorded, at once.

    Raises:
        ConfigError: as ``replayed``.
    """
    try:
        from common.recording.reader import RecordingError, files_in, read
    except ImportError as error:
        raise ConfigError(f"source {url}: reading recordings needs the extra `record`: {error}") from None
    wanted, host = url.params.get("host", ""), ""
    try:
        files = files_in(Path(url.target).expanduser())
        for recorded in (one for file in files for one in read(file)):
            at, _, name = recorded.key.partition("/")
            if name != topic.name or (wanted and at != wanted):
                continue
            if host not in ("", at):
                raise ConfigError(f"source {url}: {topic.name} of both {host} and {at}; choose one with ?host=")
            host = at
            yield decode(recorded.payload, RawBytes, topic.max_bytes)
    except (OSError, RecordingError, DecodeError) as error:
        raise ConfigError(f"source {url}: {error}") from None
    if not host:
        raise ConfigError(f"source {url}: no {topic.name} in it; record with `spotter record --raw {topic.service}`")


def first_piece(url: SourceUrl, topic: Topic) -> RawBytes:
    """The first piece, for what it says about the rest.

    Raises:
        ConfigError: as ``replayed``.
    """
    for piece in pieces(url, topic):
        return piece
    raise ConfigError(f"source {url}: no {topic.name} of this host in it")


def fitted_as_recorded(config: C, url: SourceUrl, topic: Topic) -> C:
    """The configuration with what the recorded service's own source knew of itself: a simulator its lens and place.

    Raises:
        ConfigError: as ``replayed``, or it does not fit.
    """
    changed = first_piece(url, topic).about.get("fitted")
    return with_changes(config, changed) if isinstance(changed, dict) else config


def recorded_motion(piece: RawBytes) -> Motion | None:
    """How the vehicle was known to move when this piece was processed; None = unknown."""
    try:
        return msgspec.convert(piece.about.get("motion"), Motion | None)
    except msgspec.ValidationError as error:
        raise ConfigError(f"a recorded piece of {piece.kind}: motion: {error}") from None


def _move(piece: RawBytes, stamp_ns: int) -> None:
    shift_ns = stamp_ns - piece.stamp_ns
    piece.stamp_ns = stamp_ns
    if piece.received_ns:
        piece.received_ns += shift_ns
