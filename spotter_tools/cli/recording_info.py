"""What a recording holds, for `spotter info FILE`: when, which keys, and whether its data were live when recorded."""

from __future__ import annotations

from collections import Counter, defaultdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from common.messages import SourceKind
from common.recording.elapsed import Elapsed
from common.recording.reader import is_complete, read, read_metadata


class _Header(msgspec.Struct):
    """The one field of a message that is looked at; the rest is not decoded."""

    source_kind: SourceKind = "unknown"


def describe(path: Path) -> dict[str, Any]:
    """Begin, length, services, and by key how many messages of which origin.

    Raises:
        RecordingError: not a recording, or a damaged one.
    """
    kinds: dict[str, Counter[str]] = defaultdict(Counter)
    first_ns = into_ns = 0
    elapsed = Elapsed()
    for recorded in read(path):
        try:
            kind: str = msgspec.msgpack.decode(recorded.payload, type=_Header).source_kind
        except msgspec.DecodeError:
            kind = "unreadable"
        kinds[recorded.key][kind] += 1
        first_ns, into_ns = first_ns or recorded.log_ns, elapsed.at(recorded.log_ns)
    metadata = read_metadata(path)
    return {
        "file": str(path),
        "begin": datetime.fromtimestamp(first_ns / 1e9, UTC).isoformat(timespec="milliseconds") if first_ns else "",
        "duration_s": round(into_ns / 1e9, 3),
        "complete": is_complete(path),
        "services": {
            name: {key: values[key] for key in ("vehicle", "version", "source", "source_kind") if values.get(key)}
            for name, values in metadata.items()
            if "instance" in values
        },
        "messages": {key: dict(kinds[key]) for key in sorted(kinds)},
    }
