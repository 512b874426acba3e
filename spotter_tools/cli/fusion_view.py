"""What one fusion says, for `spotter top` and `spotter metrics`: its verdict, its sensors, and how late they are.

A site with several vehicles has one for each.
"""

from __future__ import annotations

import math
from collections import deque

import msgspec

from common.clock import WRONG_CLOCK_S
from common.messages import SensorState, SourceKind, SystemHealth, Verdict
from common.topics import FUSION_HEALTH, FUSION_VERDICT

LATENCY_WINDOW_S = 60.0
MAX_LATENCIES = 20_000
VERDICT_AGE_LIMIT_S = FUSION_VERDICT.age_limit_s or math.inf
HEALTH_AGE_LIMIT_S = FUSION_HEALTH.age_limit_s or math.inf
UNKNOWN = "health unknown: fusion does not publish"


class SensorView(msgspec.Struct, kw_only=True):
    """How fusion sees one sensor."""

    state: SensorState
    reason: str
    source_kind: SourceKind
    latency_p50_ms: float | None
    latency_p99_ms: float | None


class FusionView(msgspec.Struct, kw_only=True):
    """One fusion. ``host`` is empty if none was found; ``verdict`` is None when the newest is too old; then
    ``colour`` is empty and there are no ``sensors`` either, each by the health's own limit.
    """

    host: str
    vehicle: str
    verdict: Verdict | None
    verdict_silent_s: float
    colour: str
    summary: str
    sensors: dict[str, SensorView]

    @property
    def name(self) -> str:
        """``car1``, or the host where the vehicle has no name."""
        return self.vehicle or self.host


class FusionWatch:
    """Keeps the newest verdict and health of one fusion. All times are monotonic seconds."""

    def __init__(self, started_s: float) -> None:
        self._at_s = started_s
        self._verdict: Verdict | None = None
        self._health: SystemHealth | None = None
        self._health_at_s = started_s
        self._last_stamp_ns: dict[str, int] = {}
        self._latencies_ms: dict[str, deque[tuple[float, float]]] = {}

    @property
    def has_decided(self) -> bool:
        """Whether a verdict has come."""
        return self._verdict is not None

    def note_verdict(self, verdict: Verdict, now_s: float) -> None:
        """Take a verdict, and from it how long after the measurement it was sent."""
        self._verdict, self._at_s = verdict, now_s
        for name, used in verdict.inputs.items():
            if used.stamp_ns and self._last_stamp_ns.get(name) != used.stamp_ns:
                self._last_stamp_ns[name] = used.stamp_ns
                latency_ms = (verdict.sent_ns - used.stamp_ns) / 1e6 + self._clock_ahead_ms(name)
                if abs(latency_ms) < WRONG_CLOCK_S * 1e3:  # else their clock is wrong, and not measured yet
                    recent = self._latencies_ms.setdefault(name, deque(maxlen=MAX_LATENCIES))
                    recent.append((now_s, latency_ms))

    def _clock_ahead_ms(self, sensor: str) -> float:
        """The sensor's clock minus fusion's, as fusion has measured it; 0 where it has not."""
        clocks = self._health.clocks if self._health else {}
        return next((one.offset_ms for name, one in clocks.items() if name.endswith(f"/{sensor}")), 0.0)

    def note_health(self, health: SystemHealth, now_s: float) -> None:
        """Take in the newest health message."""
        self._health, self._health_at_s = health, now_s

    def view(self, host: str, vehicle: str, now_s: float) -> FusionView:
        """What is to be shown at this moment."""
        silent_s = now_s - self._at_s
        health = self._health if now_s - self._health_at_s <= HEALTH_AGE_LIMIT_S else None
        unknown = UNKNOWN if self._health else ""
        return FusionView(
            host=host,
            vehicle=vehicle,
            verdict=self._verdict if silent_s <= VERDICT_AGE_LIMIT_S else None,
            verdict_silent_s=silent_s,
            colour=health.colour if health else "",
            summary=health.summary if health else unknown,
            sensors=self._sensors(health, now_s) if health else {},
        )

    def _sensors(self, health: SystemHealth, now_s: float) -> dict[str, SensorView]:
        views = {}
        for name, sensor in health.sensors.items():
            recent = self._latencies_ms.get(name, deque())
            while recent and recent[0][0] < now_s - LATENCY_WINDOW_S:
                recent.popleft()
            values = sorted(ms for _, ms in recent)
            views[name] = SensorView(
                state=sensor.state,
                reason=sensor.reason,
                source_kind=sensor.source_kind,
                latency_p50_ms=quantile(values, 0.50),
                latency_p99_ms=quantile(values, 0.99),
            )
        return views


def quantile(ordered: list[float], fraction: float) -> float | None:
    """The nearest-rank quantile of sorted values; None of none."""
    return ordered[max(0, math.ceil(fraction * len(ordered)) - 1)] if ordered else None
