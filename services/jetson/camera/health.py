"""Is the picture a view? Dark, frozen, covered, overexposed, blurred, too rare: with evidence, hysteresis and count."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from services.jetson.camera.config import HealthConfig

WIDTH_PX = 320  # pictures are judged at this width, so that limits do not depend on the camera's resolution
SATURATED = 250


class Measures(NamedTuple):
    """What one picture says about the view."""

    brightness: float  # mean grey level, 0..255
    contrast: float  # standard deviation of the grey levels over their mean
    detail: float  # standard deviation of the Laplacian over that of the grey levels
    saturated: float  # share of pixels at 250 or more
    difference: float | None  # mean absolute difference to the picture before; None = there was none


class ViewState(NamedTuple):
    """``blind``: what a network would find in this picture must not be believed."""

    degraded: bool
    blind: bool
    reason: str


def reduce(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 BGR to grey (h, 320) uint8; smaller pictures keep their size."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    rows, columns = grey.shape
    if columns <= WIDTH_PX:
        return grey
    return cv2.resize(grey, (WIDTH_PX, max(1, round(rows * WIDTH_PX / columns))), interpolation=cv2.INTER_AREA)


def measure(grey: np.ndarray, previous: np.ndarray | None) -> Measures:
    """Figures of a reduced picture and of its difference to the one before."""
    mean, deviation = (float(value[0, 0]) for value in cv2.meanStdDev(grey))
    _, laplacian = (float(value[0, 0]) for value in cv2.meanStdDev(cv2.Laplacian(grey, cv2.CV_32F)))
    difference = None
    if previous is not None and previous.shape == grey.shape:
        difference = float(cv2.norm(grey, previous, cv2.NORM_L1)) / grey.size
    return Measures(
        brightness=mean,
        contrast=deviation / max(mean, 1.0),
        detail=laplacian / max(deviation, 1.0),
        saturated=float(np.count_nonzero(grey >= SATURATED)) / grey.size,
        difference=difference,
    )


@dataclass
class _Condition:
    """One fault with its count: raised after ``raise_frames`` bad pictures, cleared after as many good ones."""

    name: str
    blind: bool
    raise_frames: int
    raised: bool = False
    count: int = 0  # consecutive pictures that speak against the present state
    evidence: str = ""

    def update(self, bad: bool, good: bool, clear_frames: int, evidence: str) -> None:
        """``bad`` and ``good`` are both False between the two limits of the hysteresis."""
        against = good if self.raised else bad
        self.count = self.count + 1 if against else 0
        if self.count >= (clear_frames if self.raised else self.raise_frames):
            self.raised, self.count = not self.raised, 0
            self.evidence = evidence  # as it was when it was raised: a reason that changes all the time is no news


class ViewMonitor:
    """Judges picture after picture; the state it holds is only counts and the last change."""

    def __init__(self, config: HealthConfig) -> None:
        self._config = config
        self._changed_ns: int | None = None
        self._last_ns: int | None = None
        slow = config.raise_frames
        self._dark = _Condition("dark", True, raise_frames=1)
        self._frozen = _Condition("frozen", True, raise_frames=1)
        self._covered = _Condition("covered or fogged", True, raise_frames=slow)
        self._overexposed = _Condition("overexposed", False, raise_frames=slow)
        self._blurred = _Condition("blurred", False, raise_frames=slow)
        self._slow = _Condition("too slow", False, raise_frames=slow)

    def update(self, stamp_ns: int, measures: Measures) -> ViewState:
        """The state after this picture; of several faults the first in the order above is reported."""
        self._judge_frozen(stamp_ns, measures.difference)
        self._judge_below(self._dark, measures.brightness, self._config.dark_below, "mean brightness {:.0f}")
        self._judge_below(self._covered, measures.contrast, self._config.contrast_below, "contrast {:.2f}")
        self._judge_below(self._blurred, measures.detail, self._config.detail_below, "fine detail {:.3f}")
        self._judge_overexposed(measures.saturated)
        self._judge_slow(stamp_ns)
        conditions = (self._dark, self._frozen, self._overexposed, self._covered, self._blurred, self._slow)
        raised = [condition for condition in conditions if condition.raised]
        if not raised:
            return ViewState(False, False, "")
        return ViewState(True, any(c.blind for c in raised), f"{raised[0].name}: {raised[0].evidence}")

    def _judge_below(self, condition: _Condition, value: float, limit: float, evidence: str) -> None:
        enough = limit * (1 + self._config.hysteresis)
        text = f"{evidence.format(value)}, needs {limit:g}"
        condition.update(value < limit, value >= enough, self._config.clear_frames, text)

    def _judge_overexposed(self, saturated: float) -> None:
        limit = self._config.saturated_above
        text = f"{saturated:.0%} of the picture is saturated, allowed {limit:.0%}"
        little = limit * (1 - self._config.hysteresis)
        self._overexposed.update(saturated > limit, saturated <= little, self._config.clear_frames, text)

    def _judge_slow(self, stamp_ns: int) -> None:
        """By the time between two pictures that were judged: a slow network counts as well as a slow camera."""
        since_s = (stamp_ns - self._last_ns) / 1e9 if self._last_ns is not None else 0.0
        self._last_ns = stamp_ns
        limit_hz = self._config.slow_below_hz
        if since_s <= 0.0:
            return
        rate_hz, enough_hz = 1.0 / since_s, limit_hz * (1 + self._config.hysteresis)
        text = f"{rate_hz:.1f} pictures a second, needs {limit_hz:g}; more light, a smaller picture or network"
        self._slow.update(rate_hz < limit_hz, rate_hz >= enough_hz, self._config.clear_frames, text)

    def _judge_frozen(self, stamp_ns: int, difference: float | None) -> None:
        if self._changed_ns is not None and self._last_ns is not None and stamp_ns < self._last_ns:
            self._changed_ns -= self._last_ns - stamp_ns  # the clock was set back: how long is kept
        changed = difference is None or difference > self._config.frozen_difference
        if changed or self._changed_ns is None:
            self._changed_ns = stamp_ns
        still_s = (stamp_ns - self._changed_ns) / 1e9
        if self._frozen.raised and not changed and still_s <= self._config.frozen_after_s / 4:
            return  # a video may hold a picture twice: that speaks neither for nor against
        text = f"the same picture for {still_s:.1f} s"
        frozen = 0 < self._config.frozen_after_s <= still_s
        self._frozen.update(frozen, changed, self._config.clear_frames, text)
