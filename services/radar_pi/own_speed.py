"""The vehicle's own speed from the radar alone: from echoes that stand still in the world.

A vehicle that stands: the static echoes beyond the leakage keep their phase from frame to frame (a millimetre turns it
by 140 degrees). A vehicle that moves at v: a standing echo at azimuth a has the radial velocity -v cos(a). Every
detection of the last frames proposes a v, the one that most agree with wins (RANSAC with one point a model, all tried),
and least squares over those that agree gives the value. Source: Kellner et al., Instantaneous ego-motion estimation
using Doppler radar, ITSC 2013, for one axis.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from services.radar_pi.axes import Axes
from services.radar_pi.config import OwnSpeedConfig
from services.radar_pi.detection import Detection

STILL_RAD = 0.3  # from frame to frame; noise of an echo 13 dB above its noise
STILL_HALF_RAD = 0.15  # from the first to the second half of a frame: 8 mm/s
FOLDED = 1.0 / 3.0  # of the folding range: what recedes beyond may be folded from up to 1 2/3 of that range
STRONG = 20.0  # power of a static echo over that of its noise
STILL_SIGMA_MPS = 0.01


class OwnMotion(NamedTuple):
    """Forward speed with its standard deviation, and how many echoes agree with it of how many there were."""

    speed_mps: float
    sigma_mps: float
    agreeing: int
    of: int


class OwnSpeed:
    """``update`` with every frame; None when too few echoes stand still or agree."""

    def __init__(self, config: OwnSpeedConfig, axes: Axes, frame_period_s: float) -> None:
        self._config, self._axes, self._period_s = config, axes, frame_period_s
        first = int(np.searchsorted(axes.range_m, config.leakage_range_m))
        self._far = slice(first, axes.far_bin)
        self._last: np.ndarray | None = None  # (rx, far bin) complex: mean over the chirps of the frame before
        self._echoes: deque[list[Detection]] = deque(maxlen=config.frames)  # newest first

    def reset(self) -> None:
        """The chip was restarted, or frames are missing: phases mean nothing."""
        self._last = None
        self._echoes.clear()

    def update(self, profiles: np.ndarray, detections: list[Detection]) -> OwnMotion | None:
        """The speed in this frame.

        Args:
            profiles: (rx, chirp, bin) complex range profiles, background not subtracted.
            detections: the bodies of this frame.
        """
        still = self._stands(profiles[:, :, self._far])
        if still is not None:
            self._echoes.clear()
            return still
        self._echoes.appendleft(detections)
        return self._moves()

    def _moves(self) -> OwnMotion | None:
        """From the newest frame alone if that is enough, else from a few: the older, the less sure."""
        echoes: list[Detection] = []
        for age, frame in enumerate(self._echoes):
            echoes += frame
            found = fit(echoes, self._config, self._axes)
            if found is not None:
                changed_mps = self._config.acceleration_mps2 * 0.5 * age * self._period_s
                return found._replace(sigma_mps=math.hypot(found.sigma_mps, changed_mps))
        return None

    def _stands(self, far: np.ndarray) -> OwnMotion | None:
        """Speed zero when enough static echoes keep their phase, within this frame and since the last."""
        mean = far.mean(axis=1)
        last, self._last = self._last, mean
        if last is None:
            return None
        power = _power(mean)
        noise = _power(far - mean[:, None, :], axis=(0, 1)) / far.shape[1] ** 2
        strong = (np.minimum(power, _power(last)) > STRONG * noise) & (power > 0.0)
        half = far.shape[1] // 2
        turned = np.abs(np.angle((last.conj() * mean).sum(axis=0)))
        turning = np.abs(np.angle((far[:, :half].mean(axis=1).conj() * far[:, half:].mean(axis=1)).sum(axis=0)))
        still = strong & (turned < STILL_RAD) & (turning < STILL_HALF_RAD)
        count, of = int(still.sum()), int(strong.sum())
        if count < self._config.min_still_bins or 2 * count < of:
            return None
        return OwnMotion(0.0, STILL_SIGMA_MPS, count, of)


def fit(echoes: list[Detection], config: OwnSpeedConfig, axes: Axes) -> OwnMotion | None:
    """The speed that most echoes agree with; None when they are too few, or all in one direction.

    Echoes in one direction may be one body that walks; in several directions only standing ones agree. What comes
    nearer from beyond the folding range shows up within it, going away: what goes away at a distance may contradict a
    speed and never supports one. So a vehicle that reverses is known to only by what is near.
    """
    known = [one for one in echoes if one.azimuth_rad is not None]
    if len(known) < config.min_echoes:
        return None
    azimuth = np.array([one.azimuth_rad for one in known], float)
    radial = np.array([one.velocity_mps for one in known])
    may_be_folded = (radial > 0.0) & (np.array([one.range_m for one in known]) > FOLDED * axes.fold_m)
    cosine = np.cos(azimuth)
    tolerance_mps = config.tolerance_bins * axes.velocity_bin_mps
    proposals = -radial / cosine
    misses = fold(radial[None, :] + proposals[:, None] * cosine[None, :], axes.v_max_mps)
    agrees = (np.abs(misses) <= tolerance_mps) & ~may_be_folded
    best = agrees[int(np.argmax(agrees.sum(axis=1)))]
    if best.sum() < config.min_echoes or best.mean() < config.min_share:
        return None
    if np.ptp(azimuth[best]) < config.min_spread_rad:
        return None
    weight = cosine[best]
    speed = -float(radial[best] @ weight) / float(weight @ weight)
    rms = math.sqrt(float(np.mean((radial[best] + speed * weight) ** 2)))
    sigma = max(rms, axes.velocity_bin_mps / math.sqrt(12)) / math.sqrt(float(weight @ weight))
    return OwnMotion(speed, sigma, int(best.sum()), len(known))


def fold(velocity_mps: np.ndarray, v_max_mps: float) -> np.ndarray:
    """The velocity as the radar shows it: in [-v_max, v_max)."""
    return np.asarray((velocity_mps + v_max_mps) % (2 * v_max_mps) - v_max_mps)


def _power(values: np.ndarray, axis: int | tuple[int, ...] = 0) -> np.ndarray:
    return np.asarray((values.real**2 + values.imag**2).sum(axis=axis))
