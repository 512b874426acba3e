"""Writes messages from the bus to files: queue, loss counter, rotation, disk guard."""

from __future__ import annotations

import json
import queue
import shutil
import threading
import uuid
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import zenoh

from common.bus.session import undeclare
from common.clock import monotonic_s, utc_ns
from common.codec import DecodeError, decode
from common.messages import Message
from common.periodic import Periodic
from common.recording.file import RecordingFile
from common.recording.reader import WRITTEN_BY
from common.topics import RECORDER, Topic, find_topic

FLUSH_PERIOD_S = 0.5
SYNC_PERIOD_S = 1.0
QUEUE_MESSAGES = 20_000
RING_PER_TOPIC = 512
STOP_LIMIT_S = 1.0


@dataclass(frozen=True)
class RecorderOptions:
    """Where and how much. ``keep_free_bytes`` is never used up; a file ends at ``rotate_bytes`` or ``rotate_s``."""

    folder: Path
    keep_free_bytes: int = 2_000_000_000
    rotate_bytes: int = 1_000_000_000
    rotate_s: float = 3600.0
    foxglove: bool = True


@dataclass
class RecorderStatus:
    """Counts since the start; the same numbers go into the file once a second."""

    messages: int = 0
    bytes: int = 0
    dropped: int = 0
    undecodable: int = 0
    free_bytes: int = 0
    file: str = ""
    from_services: int = 0  # of the messages, without the status of recorders


class DiskFull(RuntimeError):
    """The disk is full or below the reserve; the text says what is recorded."""


@dataclass(frozen=True)
class Arrival:
    """One message as it came: key, bytes, and UTC ns when it was taken from the bus."""

    key: str
    payload: bytes
    log_ns: int


class Recorder:
    """Records topics of a session until it is stopped. ``run`` works in the caller's thread."""

    def __init__(
        self,
        session: zenoh.Session,
        topics: Iterable[Topic],
        options: RecorderOptions,
        metadata: dict[str, dict[str, str]],
    ) -> None:
        self.status = RecorderStatus()
        self._options = options
        self._metadata = metadata
        self._queue: queue.Queue[Arrival] = queue.Queue(QUEUE_MESSAGES)
        self._overflow = 0
        self._next_seq: dict[str, int] = {}
        self._gaps: Counter[str] = Counter()
        self._name, self._index = uuid.uuid4().hex, 0  # in its files: which belong together, in which order
        self._subscribers = [
            session.declare_subscriber(topic.any_host, zenoh.handlers.RingChannel(RING_PER_TOPIC)) for topic in topics
        ]
        self._threads = [
            threading.Thread(target=self._receive, args=(subscriber,), name="recorder", daemon=True)
            for subscriber in self._subscribers
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End the subscriptions and their threads, which must not outlive the interpreter."""
        for subscriber in self._subscribers:
            undeclare(subscriber)
        for thread in self._threads:
            thread.join(STOP_LIMIT_S)

    def run(self, stop: threading.Event, on_status: Callable[[RecorderStatus], None] = lambda _: None) -> None:
        """Write until ``stop`` is set; ``on_status`` is called about once a second.

        Raises:
            DiskFull: the disk guard stepped in and the file is complete, or the disk took no more and the text says
                up to when the file holds.
        """
        self._options.folder.mkdir(parents=True, exist_ok=True)
        while not stop.is_set():
            self._guard_disk()
            file: RecordingFile | None = None
            try:
                file = self._new_file()
                with file:
                    self._fill(file, stop, on_status)
            except OSError as error:
                raise DiskFull(self._what_is_held(file, error)) from None

    def _what_is_held(self, file: RecordingFile | None, error: OSError) -> str:
        """One line for a full disk: the reason, the file, and up to when it is complete."""
        if file is None:
            return f"{self._options.folder}: {error.strerror}; no new file could be begun"
        if not file.messages:
            return f"{file.path}: {error.strerror}; recording stopped before the first message, no file is left"
        if not file.held_ns:
            return f"{file.path}: {error.strerror}; recording stopped, the file holds nothing"
        until = datetime.fromtimestamp(file.held_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S")
        return f"{file.path}: {error.strerror}; recording stopped, the file holds everything up to {until} UTC"

    def _fill(self, file: RecordingFile, stop: threading.Event, on_status: Callable[[RecorderStatus], None]) -> None:
        """One file, until it is full, old, or the recording ends."""
        opened_s = monotonic_s()
        sync = Periodic(SYNC_PERIOD_S, opened_s)
        while not stop.is_set():
            self._drain(file, until_s=monotonic_s() + FLUSH_PERIOD_S)
            now_s = monotonic_s()
            file.flush()
            if not sync.due(now_s):
                continue
            self._note_status(file)
            file.sync()
            on_status(self.status)
            self._guard_disk()
            if file.size_bytes > self._options.rotate_bytes or now_s - opened_s > self._options.rotate_s:
                return
        for _ in range(self._queue.qsize()):  # what came before the stop belongs to the recording
            self._write(file, self._queue.get_nowait())
        self._note_status(file)

    def _drain(self, file: RecordingFile, until_s: float) -> None:
        """Write messages until a given time, even under overload: flush and stop must not wait."""
        while (left_s := until_s - monotonic_s()) > 0:
            try:
                arrival = self._queue.get(timeout=left_s)
            except queue.Empty:
                return
            self._write(file, arrival)

    def _write(self, file: RecordingFile, arrival: Arrival) -> None:
        topic = find_topic(arrival.key)
        if topic is None:
            return
        try:
            message = decode(arrival.payload, topic.message, topic.max_bytes)
        except DecodeError:
            self.status.undecodable += 1
            return
        self._count_gap(arrival.key, message)
        file.add(arrival.key, topic.message, arrival.payload, arrival.log_ns, message.sent_ns, message.seq)
        self.status.messages += 1
        self.status.from_services += topic.service != RECORDER
        self.status.bytes += len(arrival.payload)
        if self._options.foxglove:
            self._write_foxglove(file, arrival, message)

    def _write_foxglove(self, file: RecordingFile, arrival: Arrival, message: Message) -> None:
        from common.messages import Verdict
        from common.recording.foxglove import convert

        for name, converted in convert(arrival.key, message):
            file.add_foxglove(name, converted, arrival.log_ns, message.stamp_ns)
        if isinstance(message, Verdict):
            number = {"SAFE": 0, "CAUTION": 1, "IMMINENT": 2}[message.level]
            ages_ms = {name: one.age_ms for name, one in message.inputs.items()}
            payload = json.dumps({"level": number, "age_ms": ages_ms}).encode()
            file.add_json(f"/plot/{arrival.key}", "spotter.VerdictNumbers", payload, arrival.log_ns)

    def _count_gap(self, key: str, message: Message) -> None:
        """Messages that never reached us, by the publisher's own count; a restart begins again at zero."""
        expected = self._next_seq.get(key)
        if expected is not None and message.seq > expected:
            self._gaps[key] += message.seq - expected
        self._next_seq[key] = message.seq + 1
        self.status.dropped = sum(self._gaps.values()) + self._overflow

    def _note_status(self, file: RecordingFile) -> None:
        """The drop counter inside the file: it distinguishes a quiet bus from a lossy recording."""
        self.status.file = str(file.path)
        self.status.free_bytes = shutil.disk_usage(self._options.folder).free
        content = {
            "messages": self.status.messages,
            "dropped": self.status.dropped,
            "dropped_by_key": dict(self._gaps),
            "queue_overflow": self._overflow,
            "undecodable": self.status.undecodable,
            "free_bytes": self.status.free_bytes,
        }
        file.add_json("/recorder/status", "spotter.RecorderStatus", json.dumps(content).encode(), utc_ns())

    def _new_file(self) -> RecordingFile:
        file = self._begin_file()
        if self._options.foxglove:
            from common.recording.foxglove import static_transforms

            now_ns = utc_ns()
            for transform in static_transforms(now_ns):
                file.add_foxglove("/tf", transform, now_ns, now_ns)
        self.status.file = str(file.path)
        return file

    def _begin_file(self) -> RecordingFile:
        """Open a file under an unused name: another recorder may have started one here in the same second."""
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        while True:
            path = self._options.folder / f"spotter-{stamp}-{self._index:03d}.mcap"
            written_by = {"recorder": self._name, "file": str(self._index)}
            self._index += 1
            with suppress(FileExistsError):
                return RecordingFile(path, {WRITTEN_BY: written_by, **self._metadata})

    def _guard_disk(self) -> None:
        free = shutil.disk_usage(self._options.folder).free
        if free < self._options.keep_free_bytes:
            raise DiskFull(
                f"{self._options.folder}: {free / 1e9:.2f} GB free, "
                f"{self._options.keep_free_bytes / 1e9:.2f} GB of it not to be used (--keep-free); "
                "recording stopped, the files are complete"
            )

    def _receive(self, subscriber: Iterable[zenoh.Sample]) -> None:
        try:
            for sample in subscriber:
                arrival = Arrival(str(sample.key_expr), sample.payload.to_bytes(), utc_ns())
                try:
                    self._queue.put_nowait(arrival)
                except queue.Full:
                    self._overflow += 1
        except zenoh.ZError:
            return  # the session is closed
