"""The sensor's millisecond clock, which starts again at 30000, laid along the host's clock."""

from __future__ import annotations

import math

MODULUS_MS = 30_000
MAX_DRIFT = 100e-6  # two crystals: how fast the offset may creep
STEP_S, WINDOW_MS = 0.05, 5000  # each packet of so long is late by more: the host's clock was set forward
RESTART_S = 1.0  # off the host's clock by more, at once or little by little: a restarted sensor or another clock


class DeviceClock:
    """Unwraps packet timestamps and finds the offset to UTC that transport delay does not blur.

    A packet can only arrive late, never early. So the smallest difference between arrival and sensor time is the best
    one; it is allowed to creep upwards with the drift of two crystals (Cristian 1989, one-way minimum filter). When the
    host's clock is set forward, or slewed, none is as small any more: then the smallest of the last seconds counts.

    Args:
        max_drift: the creep allowed, as a share; a replay that is slower than life needs 1 or more.
    """

    def __init__(self, max_drift: float = MAX_DRIFT) -> None:
        self.restarts = 0
        self._max_drift = max_drift
        self._last_ms: int | None = None
        self._device_ms = 0
        self._last_arrival_ns = 0
        self._offset_ns = 0.0
        self._least_ns, self._window_ms = math.inf, 0  # the smallest offset since then

    def advance(self, timestamp_ms: int, arrival_ns: int) -> tuple[int, int]:
        """(sensor time in ms, continuous; the same instant as UTC ns) of a packet that arrived at ``arrival_ns``."""
        if self._last_ms is None:
            self._start(timestamp_ms, arrival_ns)
            return self._device_ms, arrival_ns
        elapsed_s = (arrival_ns - self._last_arrival_ns) * 1e-9
        step_ms = (timestamp_ms - self._last_ms) % MODULUS_MS
        step_ms += MODULUS_MS * max(0, round((elapsed_s * 1e3 - step_ms) / MODULUS_MS))
        candidate_ns = arrival_ns - (self._device_ms + step_ms) * 1e6
        runs_away = abs(candidate_ns - self._offset_ns) > RESTART_S * 1e9
        if runs_away or abs(step_ms * 1e-3 - elapsed_s) > RESTART_S:
            self.restarts += 1
            self._start(timestamp_ms, arrival_ns)
            return self._device_ms, arrival_ns
        self._last_ms, self._last_arrival_ns = timestamp_ms, arrival_ns
        self._device_ms += step_ms
        self._offset_ns = min(self._offset_ns + step_ms * 1e6 * self._max_drift, candidate_ns)
        self._follow_step(candidate_ns)
        return self._device_ms, int(self._offset_ns + self._device_ms * 1e6)

    def _follow_step(self, candidate_ns: float) -> None:
        self._least_ns = min(self._least_ns, candidate_ns)
        if self._device_ms - self._window_ms < WINDOW_MS:
            return
        if self._least_ns - self._offset_ns > STEP_S * 1e9:
            self._offset_ns = self._least_ns
        self._least_ns, self._window_ms = math.inf, self._device_ms

    def _start(self, timestamp_ms: int, arrival_ns: int) -> None:
        self._last_ms, self._last_arrival_ns = timestamp_ms, arrival_ns
        self._offset_ns = arrival_ns - self._device_ms * 1e6
        self._least_ns, self._window_ms = math.inf, self._device_ms
