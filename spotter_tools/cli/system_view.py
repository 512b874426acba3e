"""What `spotter top` and `spotter metrics` show: services, topics, and what each fusion says, from the bus.

The age of a topic is the time since its last message arrived here, on this machine's monotonic clock. Latency is from
a measurement's stamp to the sending of the first verdict that used it, by the clocks' offsets as fusion measures them.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import dataclass, field
from functools import partial

import msgspec
import zenoh

from common import topics
from common.bus.presence import Presence
from common.bus.session import pass_on_samples, undeclare
from common.bus.vehicles import vehicles_on_bus
from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.messages import ServiceState, ServiceStatus, SystemHealth, Verdict
from common.topics import DATA_TOPICS, RECORDER, find_topic, status_topic, token_key
from spotter_tools.cli.fusion_view import FusionView, FusionWatch

RATE_WINDOW_S = 3.0
STATUS_AGE_LIMIT_S = status_topic(RECORDER).age_limit_s or math.inf
CPU_SPAN_NS = 800_000_000


class ServiceView(msgspec.Struct, kw_only=True):
    """One service. ``cpu_share`` is of one core, over about a second."""

    host: str
    vehicle: str  # empty where no vehicle has a name
    service: str
    instances: int  # 0: its process is gone, 2: two claim the same topics
    state: ServiceState | None
    reason: str
    rate_hz: float
    last_frame_age_s: float | None
    cpu_share: float | None
    cpu_s: float
    rss_mb: float
    published: int
    dropped: int
    bad_input: int
    slowest_stage: str
    slowest_stage_ms: float | None


class TopicView(msgspec.Struct, kw_only=True):
    """One key on which messages have arrived."""

    key: str
    rate_hz: float
    bytes_per_s: float
    age_s: float
    age_limit_s: float | None
    messages: int

    @property
    def stale(self) -> bool:
        """Whether the newest message is older than its limit."""
        return self.age_limit_s is not None and self.age_s > self.age_limit_s


class Overview(msgspec.Struct, kw_only=True):
    """The whole system at one moment. ``fusions`` has one entry per fusion found, and at least one."""

    fusions: list[FusionView]
    services: list[ServiceView]
    topics: list[TopicView]


@dataclass
class _Arrivals:
    """Of one key: when and how large."""

    messages: int = 0
    last_s: float = 0.0
    window: deque[tuple[float, int]] = field(default_factory=deque)

    def note(self, now_s: float, size: int) -> None:
        """Count a message of ``size`` bytes."""
        self.messages += 1
        self.last_s = now_s
        self.window.append((now_s, size))
        self.forget(now_s)

    def forget(self, now_s: float) -> None:
        """Drop what is older than the window of the rate."""
        while self.window and self.window[0][0] < now_s - RATE_WINDOW_S:
            self.window.popleft()


class Observer:
    """Listens from now on; ``overview`` may be called at any time and from any thread. ``host``: of one host only."""

    def __init__(self, session: zenoh.Session, host: str = "*") -> None:
        self._lock = threading.Lock()
        self._host = host
        self._started_s = monotonic_s()
        self._arrivals: dict[str, _Arrivals] = {}
        self._status: dict[str, ServiceStatus] = {}
        self._cpu_share: dict[str, float] = {}
        self._cpu_since: dict[str, ServiceStatus] = {}
        self._fusions: dict[str, FusionWatch] = {}
        self._vehicles: dict[str, str] = {}
        self._session = session
        self._presence = Presence(session, key_expr=f"{host}/*/alive/*")
        self._decides = Presence(session, self._learn_vehicles, token_key("*", "fusion", "*"))
        # On-demand topics are left alone: listening would make the services produce them.
        watched = [topic for topic in DATA_TOPICS if not topic.on_demand] + [status_topic("*")]
        self._subscribers = [
            session.declare_subscriber(topic.key(host), zenoh.handlers.FifoChannel(4096)) for topic in watched
        ]
        for subscriber in self._subscribers:
            feed = partial(pass_on_samples, subscriber, self._note)
            threading.Thread(target=feed, name="observer", daemon=True).start()

    def close(self) -> None:
        """Stop listening."""
        self._presence.close()
        self._decides.close()
        for subscriber in self._subscribers:
            undeclare(subscriber)

    def complete(self) -> bool:
        """Whether every service with a token has sent a status, and fusion, if it has one, a verdict."""
        there = {(host, service) for host, service, _ in self._presence.instances()}
        with self._lock:
            reported = all(topics.status_topic(service).key(host) in self._status for host, service in there)
            decided = all(
                host in self._fusions and self._fusions[host].has_decided
                for host, service in there
                if service == "fusion"
            )
        return bool(there) and reported and decided

    def overview(self) -> Overview:
        """Everything as of now."""
        with self._lock:
            now_s = monotonic_s()  # in here: a message that comes while we wait would be younger than now
            fusions = self._fusions or {"": FusionWatch(self._started_s)}
            return Overview(
                fusions=[fusions[host].view(host, self._vehicles.get(host, ""), now_s) for host in sorted(fusions)],
                services=self._service_views(),
                topics=[self._topic_view(key, self._arrivals[key], now_s) for key in sorted(self._arrivals)],
            )

    def vehicles(self) -> dict[str, str]:
        """Vehicle by host, as the fusions say it; empty where no vehicle has a name."""
        with self._lock:
            return dict(self._vehicles)

    def _learn_vehicles(self, _: Presence) -> None:
        """A fusion came or went: ask again who belongs to whom."""
        try:
            found = vehicles_on_bus(self._session)
        except zenoh.ZError:
            return  # the session is closed
        with self._lock:
            self._vehicles |= found

    def _service_views(self) -> list[ServiceView]:
        instances: dict[tuple[str, str], int] = {}
        for host, service, _ in self._presence.instances():
            instances[host, service] = instances.get((host, service), 0) + 1
        known = {tuple(key.split("/")[:2]) for key in self._status} | set(instances)
        return [self._service_view(host, service, instances.get((host, service), 0)) for host, service in sorted(known)]

    def _service_view(self, host: str, service: str, instances: int) -> ServiceView:
        key = status_topic(service).key(host)
        status, gone = self._status.get(key), self._why_gone(host, service, instances)
        if status is None:
            return ServiceView(
                host=host, vehicle=self._vehicles.get(host, ""), service=service, instances=instances, state=None,
                reason="no status received yet",
                rate_hz=0.0, last_frame_age_s=None, cpu_share=None, cpu_s=0.0, rss_mb=0.0, published=0, dropped=0,
                bad_input=0, slowest_stage="", slowest_stage_ms=None,
            )  # fmt: skip
        slowest = max(status.stage_ms, key=status.stage_ms.__getitem__, default="")
        return ServiceView(
            host=host,
            vehicle=self._vehicles.get(host, ""),
            service=service,
            instances=instances,
            state="disconnected" if gone else status.state,
            reason=gone or status.reason,
            rate_hz=0.0 if gone else status.rate_hz,
            last_frame_age_s=status.last_frame_age_s,
            cpu_share=self._cpu_share.get(key),
            cpu_s=status.cpu_s,
            rss_mb=status.rss_mb,
            published=status.published,
            dropped=status.dropped,
            bad_input=status.bad_input,
            slowest_stage=slowest,
            slowest_stage_ms=status.stage_ms.get(slowest),
        )

    def _why_gone(self, host: str, service: str, instances: int) -> str:
        """Why its last status says nothing of now; empty while it does.

        A laptop's recorder has no token where the rules deny it one: it is there while its status arrives.
        """
        arrivals = self._arrivals.get(status_topic(service).key(host))
        silent_s = math.inf if arrivals is None else monotonic_s() - arrivals.last_s
        if not instances and (service != RECORDER or silent_s >= STATUS_AGE_LIMIT_S):
            return "the process is gone"
        if silent_s >= STATUS_AGE_LIMIT_S:
            return f"does not answer: no status for {silent_s:.0f} s, its process is there"
        return ""

    @staticmethod
    def _topic_view(key: str, arrivals: _Arrivals, now_s: float) -> TopicView:
        arrivals.forget(now_s)
        times_s = [at_s for at_s, _ in arrivals.window]
        span_s = max(now_s - times_s[0], 1e-3) if len(times_s) > 1 else math.inf
        topic = find_topic(key)
        return TopicView(
            key=key,
            rate_hz=(len(times_s) - 1) / span_s if len(times_s) > 1 else 0.0,
            bytes_per_s=sum(size for _, size in list(arrivals.window)[1:]) / span_s if len(times_s) > 1 else 0.0,
            age_s=now_s - arrivals.last_s,
            age_limit_s=topic.age_limit_s if topic else None,
            messages=arrivals.messages,
        )

    def _note(self, key: str, payload: bytes) -> None:
        topic, now_s = find_topic(key), monotonic_s()
        if topic is None:
            return
        message = None
        if topic.message in (Verdict, SystemHealth, ServiceStatus):
            try:
                message = decode(payload, topic.message)
            except DecodeError:
                message = None  # its messages arrive nevertheless
        with self._lock:
            self._arrivals.setdefault(key, _Arrivals()).note(now_s, len(payload))
            host = key.partition("/")[0]
            if isinstance(message, Verdict):
                self._fusions.setdefault(host, FusionWatch(now_s)).note_verdict(message, now_s)
            elif isinstance(message, SystemHealth):
                self._fusions.setdefault(host, FusionWatch(self._started_s)).note_health(message, now_s)
            elif isinstance(message, ServiceStatus):
                self._note_status(key, message)

    def _note_status(self, key: str, status: ServiceStatus) -> None:
        since = self._cpu_since.setdefault(key, status)
        span_ns = status.stamp_ns - since.stamp_ns
        if since.instance != status.instance or span_ns < 0:
            self._cpu_since[key] = status
            self._cpu_share.pop(key, None)
        elif span_ns >= CPU_SPAN_NS:  # a status on change may follow another at once: too short to divide by
            self._cpu_share[key] = 1e9 * (status.cpu_s - since.cpu_s) / span_ns
            self._cpu_since[key] = status
        self._status[key] = status
