"""When a frame was measured, from when its last interrupt was seen. No clock is read here."""

from __future__ import annotations

from services.radar_pi.chip.packing import COUNTER_SPAN
from services.radar_pi.chip.waveform import Timing

CRYSTAL_ERROR = 1e-4  # chip against host, both together; generous


class FrameStamps:
    """Moments of the last samples, on the host's monotonic clock.

    What is seen is never early, only late (scheduling, polling). The chip's frame counter and period bound how late a
    frame can really have ended after an earlier one: the earlier of the two is kept.
    """

    def __init__(self, timing: Timing) -> None:
        self._period_s = timing.frame_period_s * (1.0 + CRYSTAL_ERROR)
        self._last: tuple[int, float] | None = None

    def end_s(self, count: int, seen_s: float) -> float:
        """End of frame number ``count`` (modulo 4096), whose last words were seen at ``seen_s``."""
        if self._last is not None:
            passed = (count - self._last[0]) % COUNTER_SPAN
            seen_s = min(seen_s, self._last[1] + passed * self._period_s)
        self._last = (count, seen_s)
        return seen_s
