"""Moving target indication: a slow complex background per receiver and range bin, subtracted from every chirp.

The background is one value per receiver and bin (the mean over a frame's chirps). A background *per chirp* would cancel
moving targets too, whenever they advance by whole half wavelengths between two frames: every 2.5 cm/s at 10 Hz.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

FALLEN = 0.1  # share of the learned power: a body that stays fades by interference of its parts, but not so far
FORGET = 0.5  # share of an echo that is forgotten in each frame once it has fallen ...
STILL = 0.1  # change from frame to frame, as a share of what is left of the echo
FORGET_FRAMES = 6  # ... for so long


class Clutter:
    """background <- memory * background + (1 - memory) * mean over the frame's chirps. Memory 0 = frame difference.

    ``body_bins``: how many bins a body spreads to either side of its strongest one.
    """

    def __init__(self, memory: float, settling_frames: int, body_bins: int = 0, *, subtract: bool = True) -> None:
        self._body_bins = body_bins
        self._memory = np.float32(memory)
        self._settling_frames = settling_frames
        self._subtract = subtract
        self.reset()

    def reset(self) -> None:
        """Forget the background: the chip was restarted, or the waveform has changed."""
        self.background: np.ndarray | None = None  # (rx, bin) complex64
        self.frames = 0
        self.fallen: np.ndarray | None = None  # (bin,) bool: see ``remove``
        self._forgetting: np.ndarray | int = 0  # (bin,) frames left
        self._last: np.ndarray | None = None  # (rx, bin) the standing echo of the frame before

    @property
    def settled(self) -> bool:
        """False for the first ``settling_frames`` frames."""
        return self.frames > self._settling_frames

    def remove(self, profiles: np.ndarray) -> np.ndarray:
        """Subtract what earlier frames have learned, then learn from this one: (rx, chirp, bin) complex64.

        ``fallen`` tells afterwards in which bins the standing echo has fallen far below what was learned: what is left
        there after the subtraction is the absence of a body that has gone, not a body. It is forgotten quickly.
        """
        chirps = profiles.shape[1]
        mean = np.full(chirps, 1.0 / chirps, np.complex64) @ profiles  # a product: three times faster than mean()
        before = mean if self.background is None else self.background
        fallen = self._has_fallen(mean, before)
        self.fallen = fallen if self._subtract else None
        learn = np.where(fallen, np.float32(FORGET), 1 - self._memory)
        self.background = before + learn * (mean - before)
        self.frames += 1
        moving: np.ndarray = profiles - before[:, None, :] if self._subtract else np.ascontiguousarray(profiles)
        return moving

    def _has_fallen(self, mean: np.ndarray, before: np.ndarray) -> np.ndarray:
        """(bin,) bool, from the standing echo now and as learned, (rx, bin) each.

        Around a place where the echo has fallen, as wide as a body, everything that does not change from frame to frame
        is what the body has left behind. What changes is a body: one that creeps leaves one bin and enters the next.
        """
        fallen = _power(mean) < FALLEN * _power(before)
        around = maximum_filter1d(fallen, 2 * self._body_bins + 1)
        self._forgetting = np.where(around, FORGET_FRAMES, np.maximum(self._forgetting - 1, 0))
        last = mean if self._last is None else self._last
        still = _power(mean - last) < STILL * _power(mean - before)
        self._last = mean
        return np.asarray((self._forgetting > 0) & (fallen | still))


def _power(profile: np.ndarray) -> np.ndarray:
    """(rx, bin) -> (bin,) power over the receivers."""
    return np.asarray((profile.real**2 + profile.imag**2).sum(axis=0))
