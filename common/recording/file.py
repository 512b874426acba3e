"""One MCAP file while it is being written.

Our messages go in as they came from the wire (message encoding ``msgpack``, a JSON schema beside them), with the time
they arrived as log time. A chunk is closed every half second, so a killed recorder loses less than a second.
"""

from __future__ import annotations

import os
from contextlib import suppress
from io import BufferedWriter
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from common.messages import Message
from common.recording.schemas import json_schema, schema_name

CHUNK_BYTES = 1 << 20


class RecordingFile:
    """Use it in a ``with`` statement; leaving it writes the index and the statistics.

    A file without a single message, because the disk was full, is removed. With ``whole``, every file that is not
    completed is removed.

    Raises:
        FileExistsError: never overwrites a recording.
        OSError: it cannot be begun; nothing is left of it.
    """

    def __init__(self, path: Path, metadata: dict[str, dict[str, str]], *, whole: bool = False) -> None:
        self.path = path
        self._whole = whole
        self.messages = 0
        self.held_ns = 0  # log time of the newest message that was handed to the kernel; 0 = none
        self._newest_ns = 0
        self._stream: BufferedWriter = path.open("xb")
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        try:
            self._begin(metadata)
        except OSError:
            self.abandon()
            raise

    def _begin(self, metadata: dict[str, dict[str, str]]) -> None:
        self._writer.start(profile="spotter", library="spotter")
        for name, values in metadata.items():
            self._writer.add_metadata(name, values)

    def __enter__(self) -> RecordingFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and (self._whole or issubclass(kind, OSError)):
            self.abandon()
        else:
            self.close()

    @property
    def size_bytes(self) -> int:
        """Bytes written so far."""
        return self._stream.tell()

    def add(self, key: str, message_type: type[Message], payload: bytes, log_ns: int, sent_ns: int, seq: int) -> None:
        """One of our messages, byte for byte."""
        channel = self._channel(key, "msgpack", schema_name(message_type), "jsonschema", json_schema(message_type))
        self._writer.add_message(channel, log_ns, payload, sent_ns or log_ns, seq & 0xFFFFFFFF)
        self.messages += 1
        self._newest_ns = log_ns

    def add_foxglove(self, topic: str, message: Any, log_ns: int, publish_ns: int) -> None:
        """A message of Foxglove's own schemas, protobuf-encoded by its SDK."""
        schema = type(message).get_schema()
        channel = self._channel(topic, "protobuf", schema.name, schema.encoding, schema.data)
        self._writer.add_message(channel, log_ns, message.encode(), publish_ns)

    def add_json(self, topic: str, schema: str, payload: bytes, log_ns: int) -> None:
        """A small JSON message, for numbers that Foxglove can plot; ``schema`` is only a name."""
        channel = self._channel(topic, "json", schema, "jsonschema", b'{"type":"object"}')
        self._writer.add_message(channel, log_ns, payload, log_ns)

    def flush(self) -> None:
        """Close the chunk and write everything to the kernel: earlier messages survive a kill -9."""
        self._writer.flush()
        self.held_ns = self._newest_ns

    def sync(self) -> None:
        """Sync to the disk: earlier messages survive a power cut."""
        os.fdatasync(self._stream.fileno())

    def close(self) -> None:
        """Write the index and close the file."""
        if not self._stream.closed:
            try:
                self._writer.finish()
                self._stream.flush()
                self.sync()
            except OSError:
                self.abandon()
                raise
            self._stream.close()

    def abandon(self) -> None:
        """Close a file that can no longer be written. What is left has no index and is readable up to ``held_ns``."""
        with suppress(OSError):  # what the stream still buffers does not fit either
            self._stream.close()
        if self._whole or not self.messages:
            self.path.unlink(missing_ok=True)

    def _channel(self, topic: str, message_encoding: str, schema: str, encoding: str, data: bytes) -> int:
        if topic not in self._channels:
            if schema not in self._schemas:
                self._schemas[schema] = self._writer.register_schema(schema, encoding, data)
            self._channels[topic] = self._writer.register_channel(topic, message_encoding, self._schemas[schema])
        return self._channels[topic]
