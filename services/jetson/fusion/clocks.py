"""Trust in clocks: how far another process's clock is from ours, and how sure we are of it.

One measurement is the exchange of NTP (RFC 5905, section 8): asked at t0, received at t1, answered at t2, back at t3;
offset = ((t1 - t0) + (t2 - t3)) / 2, true within half the round trip ((t3 - t0) - (t2 - t1)) / 2 whatever the network
did. Measurements whose intervals do not overlap prove that a clock has stepped.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from common.messages import ClockHealth
from services.jetson.fusion.config import ClocksConfig

HISTORY = 16


@dataclass(frozen=True, slots=True)
class ClockSample:
    """One exchange with ``<host>/<service>``: their clock minus ours, true within ``bound_s``."""

    name: str
    at_s: float  # monotonic
    offset_s: float
    bound_s: float


def measure(name: str, at_s: float, t0_ns: int, t1_ns: int, t2_ns: int, t3_ns: int) -> ClockSample:
    """The four stamps of one exchange; t0 and t3 ours, t1 and t2 theirs."""
    offset_s = ((t1_ns - t0_ns) + (t2_ns - t3_ns)) / 2e9
    bound_s = max(0.0, ((t3_ns - t0_ns) - (t2_ns - t1_ns)) / 2e9)
    return ClockSample(name, at_s, offset_s, bound_s)


class ClockWatch:
    """The clock of one process. Never measured is not the same as lost: then stamps are judged as they are."""

    def __init__(self, config: ClocksConfig) -> None:
        self._config = config
        self._samples: deque[ClockSample] = deque(maxlen=HISTORY)
        self._settling = 0
        self._why = ""

    def add(self, sample: ClockSample) -> None:
        """Take a measurement; one that contradicts the earlier ones is a step and starts the history again."""
        if sample.bound_s > self._config.max_bound_ms * 1e-3:
            return  # too wide to say anything; if nothing better comes the bound is lost
        best = self.estimate(sample.at_s)
        if best is not None and abs(sample.offset_s - best.offset_s) > sample.bound_s + best.bound_s:
            self.restart(f"clock stepped by {sample.offset_s - best.offset_s:+.3f} s")
        self._samples.append(sample)
        self._settling = max(0, self._settling - 1)

    def restart(self, why: str) -> None:
        """Forget the history because of a step; the clock is trusted again after some agreeing measurements."""
        self._samples.clear()
        self._settling = self._config.settle_samples
        self._why = why

    def forget(self) -> None:
        """The process is gone; its successor starts unmeasured."""
        self._samples.clear()
        self._settling = 0

    def estimate(self, now_s: float) -> ClockSample | None:
        """The tightest measurement, its bound widened by what the clocks may have drifted apart since."""
        drift = self._config.drift_ppm * 1e-6
        aged = [
            ClockSample(s.name, s.at_s, s.offset_s, s.bound_s + drift * max(0.0, now_s - s.at_s)) for s in self._samples
        ]
        return min(aged, key=lambda sample: sample.bound_s, default=None)

    def distrust(self, now_s: float) -> str:
        """Why this clock cannot be trusted; empty when it can, or when it was never measured."""
        if self._settling:
            return f"{self._why}, measuring again"
        if self._samples and now_s - self._samples[-1].at_s > self._config.max_age_s:
            return f"clock offset not measured for {now_s - self._samples[-1].at_s:.0f} s"
        return ""

    def health(self, now_s: float) -> ClockHealth | None:
        """What people are told of this clock; None while it was never measured."""
        best = self.estimate(now_s)
        if best is None:
            return None
        return ClockHealth(
            offset_ms=best.offset_s * 1e3,
            bound_ms=best.bound_s * 1e3,
            age_s=max(0.0, now_s - self._samples[-1].at_s),
            trusted=not self.distrust(now_s),
        )


class OwnClock:
    """Our own UTC clock against the monotonic one: the difference stands still unless somebody sets the clock."""

    def __init__(self, config: ClocksConfig) -> None:
        self._limit_s = config.step_ms * 1e-3
        self._difference_s: float | None = None

    def step(self, now_s: float, now_ns: int) -> float:
        """Seconds the UTC clock has jumped since the last call, 0.0 when it has not."""
        difference_s = now_ns * 1e-9 - now_s
        last_s, self._difference_s = self._difference_s, difference_s
        if last_s is None or abs(difference_s - last_s) < self._limit_s:
            return 0.0
        return difference_s - last_s
