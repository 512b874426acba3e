"""A recording (MCAP) as streams of typed messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar, overload

import zenoh

from common.codec import DecodeError, decode
from common.messages import Message
from common.topics import find_topic
from spotter_client.stream import Stream

try:
    from common.recording.reader import files_in, read
except ImportError as _error:  # the extra `record` is not installed
    _MISSING = str(_error)
else:
    _MISSING = ""

M = TypeVar("M", bound=Message)


class Recording:
    """``open_recording`` makes it. ``refused`` counts payloads that were no valid message, by key."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.refused: Counter[str] = Counter()

    @overload
    def stream(self, key: str = ...) -> Stream[Any]: ...
    @overload
    def stream(self, key: str, message_type: type[M]) -> Stream[M]: ...

    def stream(self, key: str = "**", message_type: type[Message] | None = None) -> Stream[Any]:
        """The messages of a key or expression, in the order in which they were recorded.

        Raises:
            RecordingError: while reading: not an MCAP file, or a damaged one.
            TypeError: while reading: a key carries another message than ``message_type``.
        """
        return Stream(self._messages(zenoh.KeyExpr(key), message_type))

    def _messages(self, wanted: zenoh.KeyExpr, message_type: type[Message] | None) -> Iterator[tuple[str, Message]]:
        for file in files_in(self._path):
            for recorded in read(file, refused=self.refused):
                topic = find_topic(recorded.key)
                if topic is None or not wanted.includes(recorded.key):
                    continue
                try:
                    message = decode(recorded.payload, topic.message, topic.max_bytes)
                except DecodeError:
                    self.refused[recorded.key] += 1
                    continue
                yield recorded.key, checked(message, message_type)


def open_recording(path: str | Path) -> Recording:
    """A recording or incident, or a folder of them.

    Raises:
        FileNotFoundError: there is none.
        ImportError: the extra ``record`` is not installed.
    """
    if _MISSING:
        raise ImportError(f"recordings need the extra `record`: {_MISSING}")
    if not Path(path).exists():
        raise FileNotFoundError(f"{path}: no such recording")
    return Recording(Path(path))


def checked(message: Message, message_type: type[Message] | None) -> Message:
    """The message, if it is of this type. Raises ``TypeError``."""
    if message_type is not None and not isinstance(message, message_type):
        raise TypeError(f"expected {message_type.__name__}, this key carries {type(message).__name__}")
    return message
