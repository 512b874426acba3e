"""Plays a recording back on the bus at any pace, under a namespace of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import zenoh

from common.clock import monotonic_s, utc_ns
from common.codec import DecodeError, decode, encode, encoding_of
from common.messages import least_live
from common.recording.elapsed import Elapsed
from common.recording.reader import Recorded, read
from common.topics import find_topic, token_key

INSTANCE = "replayed"
LONGEST_WAIT_S = 0.25  # a stop request is checked at least this often


@dataclass(frozen=True)
class Pace:
    """``rate`` 2.0 is twice as fast; ``seek_s`` skips the beginning; ``shift`` makes the stamps those of now."""

    rate: float = 1.0
    seek_s: float = 0.0
    loop: bool = False
    shift: bool = True

    def due_ns(self, into_ns: int) -> int:
        """When a message is due that was recorded so long after the first; at rate 1 exactly then."""
        return into_ns if self.rate == 1.0 else round(into_ns / self.rate)


class Player:
    """Publishes recorded messages unchanged, with a token for every service in the recording.

    After a clock step, or a long pause to the next recording, it continues at once (see ``Elapsed``).
    """

    def __init__(self, session: zenoh.Session, paths: list[Path], pace: Pace) -> None:
        self._session = session
        self._paths = paths
        self._pace = pace
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self.played = 0

    def run(self, stop: threading.Event, on_progress: Callable[[float], None] = lambda _: None) -> None:
        """Play until the end, or again and again with ``loop``; ``on_progress`` gets the seconds into the recording.

        A recording without messages to play ends at once, also with ``loop``.
        """
        while not stop.is_set():
            played = self.played
            self._play_once(stop, on_progress)
            if not self._pace.loop or self.played == played:
                return

    def _play_once(self, stop: threading.Event, on_progress: Callable[[float], None]) -> None:
        origin_ns: int | None = None
        started_s, started_ns = monotonic_s(), utc_ns()
        for at_ns, recorded in self._recorded():
            if origin_ns is None:
                origin_ns = at_ns
            due_ns = self._pace.due_ns(at_ns - origin_ns)
            if not self._wait(stop, started_s + due_ns / 1e9):
                return
            self._put(recorded, started_ns + due_ns - recorded.log_ns if self._pace.shift else 0)
            on_progress((at_ns - origin_ns) / 1e9 + self._pace.seek_s)

    def _recorded(self) -> Iterator[tuple[int, Recorded]]:
        """Each message with the ns at which it is due after the first one of all recordings."""
        elapsed = Elapsed()
        for path in self._paths:
            for recorded in read(path):
                at_ns = elapsed.at(recorded.log_ns)
                if at_ns >= self._pace.seek_s * 1e9:
                    yield at_ns, recorded

    @staticmethod
    def _wait(stop: threading.Event, due_s: float) -> bool:
        while (left_s := due_s - monotonic_s()) > 0:
            if stop.wait(min(left_s, LONGEST_WAIT_S)):
                return False
        return not stop.is_set()

    def _put(self, recorded: Recorded, shift_ns: int) -> None:
        topic = find_topic(recorded.key)
        if topic is None:
            return
        self._be_present(recorded.key)
        try:
            message = decode(recorded.payload, topic.message, topic.max_bytes)
        except DecodeError:
            return
        message.source_kind = least_live((message.source_kind, "recorded"))
        if shift_ns:
            # At every rate the stamps keep their distance to the moment at which they are played.
            for name in ("stamp_ns", "received_ns", "sent_ns"):
                if name == "stamp_ns" or getattr(message, name):  # 0 in the others means unknown
                    setattr(message, name, getattr(message, name) + shift_ns)
        self._publisher(recorded.key, encoding_of(topic.message)).put(encode(message))
        self.played += 1

    def _publisher(self, key: str, encoding: str) -> zenoh.Publisher:
        if key not in self._publishers:
            self._publishers[key] = self._session.declare_publisher(key, encoding=encoding)
        return self._publishers[key]

    def _be_present(self, key: str) -> None:
        host, service, _ = key.split("/")
        token = token_key(host, service, INSTANCE)
        if token not in self._tokens:
            self._tokens[token] = self._session.liveliness().declare_token(token)
