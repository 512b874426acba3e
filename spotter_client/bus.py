"""The four questions one asks a running system: what is newest, what comes, who answers, who is there."""

from __future__ import annotations

import threading
import warnings
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, TypeVar, overload

import zenoh

from common.bus.published import why_silent
from common.bus.session import close_session
from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.messages import Message, ServiceInfo, ServiceState, ServiceStatus
from common.topics import ANY_TOKEN, find_topic, info_key, parse_token, status_topic
from spotter_client.recording import checked
from spotter_client.stream import Stream

M = TypeVar("M", bound=Message)
STREAM_RING = 256  # a slow loop skips the oldest, it never delays the rest
LONGEST_WAIT_S = 0.25  # Ctrl-C is heard at least this often


@dataclass(frozen=True)
class Received:
    """A message, where it came from, and when, on this machine's monotonic clock."""

    key: str
    message: Any
    arrived_s: float


@dataclass(frozen=True)
class ServiceOnBus:
    """A service that is there. ``info`` and ``status`` are None while its process does not answer."""

    host: str
    name: str
    instance: str
    info: ServiceInfo | None
    status: ServiceStatus | None

    @property
    def state(self) -> ServiceState | None:
        """The service's own state; None while it does not answer."""
        return self.status.state if self.status else None

    @property
    def reason(self) -> str:
        """Why it is not online, in a sentence for a person."""
        return self.status.reason if self.status else "the process is there but does not answer"


class Bus:
    """Typed access to what is published. Owns the session: ``close()`` it, or use it in a ``with`` statement.

    ``refused`` counts payloads that were no valid message, by key.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.refused: Counter[str] = Counter()
        self._stack = ExitStack()
        self._newest: dict[str, _Newest] = {}

    def __enter__(self) -> Bus:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bus. Closing twice does no harm."""
        self._stack.close()
        close_session(self.session)

    @overload
    def latest(self, key: str, *, timeout_s: float = ...) -> Any: ...
    @overload
    def latest(self, key: str, message_type: type[M], *, timeout_s: float = ...) -> M: ...

    def latest(self, key: str, message_type: type[Message] | None = None, *, timeout_s: float = 3.0) -> Any:
        """The newest message of a key; the first call subscribes and waits for one, later calls do not wait.

        Raises:
            TimeoutError: nothing came within ``timeout_s``.
            TypeError: the key carries another message than ``message_type``.
        """
        if key not in self._newest:
            self._newest[key] = _Newest(self.session, key)
            self._stack.callback(self._newest[key].close)
        sample = self._newest[key].get(timeout_s)
        if sample is None:
            raise TimeoutError(f"nothing on {key} within {timeout_s:g} s; `spotter ls` shows who is there")
        return checked(_decode(sample), message_type)

    @overload
    def stream(self, key: str, *, seconds: float | None = ..., count: int | None = ...) -> Stream[Any]: ...
    @overload
    def stream(
        self, key: str, message_type: type[M], *, seconds: float | None = ..., count: int | None = ...
    ) -> Stream[M]: ...

    def stream(
        self,
        key: str,
        message_type: type[Message] | None = None,
        *,
        seconds: float | None = None,
        count: int | None = None,
    ) -> Stream[Any]:
        """Messages as they come, for ever, for so many ``seconds`` or until there were ``count``.

        ``key`` may be an expression such as ``"*/fusion/verdict"`` or ``"jetson0/**"``. Undecodable payloads are
        counted in ``refused`` and skipped. ``stream(...).to_pandas()`` and ``to_polars()`` make a table of them.
        """
        arrivals = self.arrivals(key, seconds=seconds, count=count)
        return Stream((one.key, checked(one.message, message_type)) for one in arrivals)

    def arrivals(self, key: str, *, seconds: float | None = None, count: int | None = None) -> Iterator[Received]:
        """Like ``stream``, with the key and the time of arrival of every message.

        Warns (``UserWarning``) when it ends without a single one, and names the nearest key that is published.
        """
        end_s = None if seconds is None else monotonic_s() + seconds
        inbox = _Inbox()
        subscriber = self.session.declare_subscriber(key, inbox.put)
        given = 0
        try:
            while (count is None or given < count) and (end_s is None or monotonic_s() < end_s):
                sample = inbox.get(LONGEST_WAIT_S if end_s is None else min(LONGEST_WAIT_S, end_s - monotonic_s()))
                received = self._received(sample) if sample is not None else None
                if received is not None:
                    given += 1
                    yield received
            if not given and count != 0:
                self._warn_of_silence(key, seconds)
        finally:
            subscriber.undeclare()

    def _warn_of_silence(self, key: str, seconds: float | None) -> None:
        reason = why_silent(self.session, key) or f"nothing came on {key} within {seconds:g} s"
        warnings.warn(reason, stacklevel=3)

    @overload
    def query(self, key: str, *, timeout_s: float = ...) -> list[Any]: ...
    @overload
    def query(self, key: str, message_type: type[M], *, timeout_s: float = ...) -> list[M]: ...

    def query(self, key: str, message_type: type[Message] | None = None, *, timeout_s: float = 1.0) -> list[Any]:
        """Every answer to a question such as ``"*/*/info"`` or ``"pi0/radar/status"``; empty when nobody answers."""
        everybody, every_answer = zenoh.QueryTarget.ALL, zenoh.ConsolidationMode.NONE
        answers = []
        for reply in self.session.get(key, timeout=timeout_s, target=everybody, consolidation=every_answer):
            if reply.ok is None:
                continue
            try:
                answers.append(checked(_decode(reply.ok), message_type))
            except DecodeError:
                self.refused[str(reply.ok.key_expr)] += 1
        return answers

    def services(self, *, timeout_s: float = 1.0) -> list[ServiceOnBus]:
        """Who is there, by liveliness token, with what each says of itself."""
        replies = self.session.liveliness().get(ANY_TOKEN, timeout=timeout_s)
        tokens = sorted({parse_token(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None})
        return [self._service(*token, timeout_s) for token in tokens]

    def _service(self, host: str, name: str, instance: str, timeout_s: float) -> ServiceOnBus:
        info = [i for i in self.query(info_key(host, name), ServiceInfo, timeout_s=timeout_s) if i.instance == instance]
        key = status_topic(name).key(host)
        status = [s for s in self.query(key, ServiceStatus, timeout_s=timeout_s) if s.instance == instance]
        return ServiceOnBus(host, name, instance, info[0] if info else None, status[0] if status else None)

    def _received(self, sample: zenoh.Sample) -> Received | None:
        key = str(sample.key_expr)
        try:
            return Received(key, _decode(sample), monotonic_s())
        except DecodeError:
            self.refused[key] += 1
            return None


class _Inbox:
    """From Zenoh's thread to the reader's loop; when full, the oldest goes."""

    def __init__(self) -> None:
        self._samples: deque[zenoh.Sample] = deque(maxlen=STREAM_RING)
        self._ready = threading.Condition()

    def put(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            with self._ready:
                self._samples.append(sample)
                self._ready.notify()

    def get(self, wait_s: float) -> zenoh.Sample | None:
        with self._ready:
            self._ready.wait_for(lambda: self._samples, max(wait_s, 0.0))
            return self._samples.popleft() if self._samples else None


class _Newest:
    """Keeps the newest sample of one key."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._arrived = threading.Event()
        self._sample: zenoh.Sample | None = None
        self._subscriber = session.declare_subscriber(key, self._note)
        self.close = self._subscriber.undeclare

    def _note(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._sample = sample
            self._arrived.set()

    def get(self, timeout_s: float) -> zenoh.Sample | None:
        self._arrived.wait(timeout_s)
        return self._sample


def _decode(sample: zenoh.Sample) -> Message:
    """The message that the topics table says this key carries."""
    key, payload = str(sample.key_expr), sample.payload.to_bytes()
    if key.endswith("/info"):
        return decode(payload, ServiceInfo)
    topic = find_topic(key)
    if topic is None:
        raise DecodeError(f"{key}: no topic of ours")
    return decode(payload, topic.message, topic.max_bytes)
