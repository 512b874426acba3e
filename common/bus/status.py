"""The status of a service: state with reason, counts, rate, age, memory."""

from __future__ import annotations

import resource
import threading
from collections import Counter, deque
from pathlib import Path

from common.clock import monotonic_s, utc_ns
from common.messages import SensorMessage, ServiceState, ServiceStatus, SourceKind

RATE_WINDOW_S = 3.0
ENDED = "ended: "  # so begins the last reason of a recorder that was stopped: nobody misses it
_PAGE_BYTES = resource.getpagesize()


class Report:
    """Thread-safe record of a service's state; ``changed`` is set whenever state or reason change.

    Sources call ``state("disconnected", why)`` while a device is away; publishing good data says "online" again.
    """

    def __init__(self, instance: str, source_kind: SourceKind = "unknown") -> None:
        self.source_kind: SourceKind = source_kind
        self.changed = threading.Event()
        self._lock = threading.Lock()
        self._instance = instance
        self._state: ServiceState = "starting"
        self._reason = "starting"
        self._conflict = ""
        self._published = 0
        self._dropped = 0
        self._bad_input = 0
        self._counters: Counter[str] = Counter()
        self._stage_ms: dict[str, float] = {}
        self._publish_times_s: deque[float] = deque()
        self._last_frame_s: float | None = None
        self._progress_s = monotonic_s()

    def beat(self) -> None:
        """The main loop makes progress. Every report of a source or a pipeline counts as well."""
        self._progress_s = monotonic_s()

    def silent_s(self) -> float:
        """Seconds since the main loop last made progress: it may be stuck while other threads run."""
        return monotonic_s() - self._progress_s

    def state(self, state: ServiceState, reason: str = "") -> None:
        """Set the state; ``reason`` is a sentence for a person, empty only when online."""
        self.beat()
        with self._lock:
            if (state, reason) != (self._state, self._reason):
                self._state, self._reason = state, reason
                self.changed.set()

    def conflict(self, text: str) -> None:
        """Another process claims the same topics (empty text: no longer)."""
        with self._lock:
            if text != self._conflict:
                self._conflict = text
                self.changed.set()

    def bad_input(self, name: str, count: int = 1) -> None:
        """Count rejected input, under a short name of the fault."""
        self.beat()
        if count:
            with self._lock:
                self._bad_input += count
                self._counters[name] += count

    def count(self, name: str, count: int = 1) -> None:
        """Count an event that is not an error."""
        if count:
            with self._lock:
                self._counters[name] += count

    def dropped(self, count: int = 1) -> None:
        """Count frames that were skipped because newer ones were there."""
        with self._lock:
            self._dropped += count

    def stages(self, stage_ms: dict[str, float]) -> None:
        """Timings of a service whose messages carry none of their own."""
        with self._lock:
            self._stage_ms = stage_ms

    def published(self, message: object, *, primary: bool) -> None:
        """Called by the publisher after each put; ``primary`` marks the topic with an age limit."""
        self.beat()
        now_s = monotonic_s()
        with self._lock:
            self._published += 1
            if not primary:
                return
            self._last_frame_s = now_s
            self._publish_times_s.append(now_s)
            self._forget_before(now_s - RATE_WINDOW_S)
        if isinstance(message, SensorMessage):
            self._stage_ms = message.stage_ms
            self.state(message.state, message.reason)
        else:
            self.state("online")

    def snapshot(self) -> ServiceStatus:
        """The status message as of now."""
        now_s = monotonic_s()
        with self._lock:
            self._forget_before(now_s - RATE_WINDOW_S)
            state, reason = self._state, self._reason
            if self._conflict:
                state = "degraded" if state == "online" else state
                reason = f"{reason}; {self._conflict}" if reason else self._conflict
            return ServiceStatus(
                stamp_ns=utc_ns(),
                state=state,
                reason=reason,
                published=self._published,
                dropped=self._dropped,
                bad_input=self._bad_input,
                rate_hz=self._rate_hz(now_s),
                last_frame_age_s=None if self._last_frame_s is None else now_s - self._last_frame_s,
                stage_ms=self._stage_ms,
                rss_mb=_resident_mb(),
                instance=self._instance,
                cpu_s=_cpu_s(),
                counters=dict(self._counters),
                source_kind=self.source_kind,
            )

    def _forget_before(self, limit_s: float) -> None:
        while self._publish_times_s and self._publish_times_s[0] < limit_s:
            self._publish_times_s.popleft()

    def _rate_hz(self, now_s: float) -> float:
        times_s = self._publish_times_s
        if len(times_s) < 2:
            return 0.0
        return (len(times_s) - 1) / max(now_s - times_s[0], 1e-3)


def _resident_mb() -> float:
    """Present memory; the greatest so far if that cannot be read, for example without a free file descriptor."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    return pages * _PAGE_BYTES / 1e6


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime
