"""Azimuth from the phase difference of the horizontal receiver pair.

The beat phase grows with the path, so a target on the left has less phase at the left receiver:
``sin(azimuth) = wavelength * (phase_right - phase_left) / (2 pi spacing)``, left positive.
"""

from __future__ import annotations

import numpy as np

from services.radar_pi.config import AzimuthConfig


class PairAzimuth:
    """The pair's place in the frame; ``available`` is False when the waveform does not use both receivers."""

    def __init__(self, config: AzimuthConfig, rx: tuple[int, ...], wavelength_m: float) -> None:
        self.available = config.left_rx in rx and config.right_rx in rx and config.left_rx != config.right_rx
        self._left = rx.index(config.left_rx) if self.available else 0
        self._right = rx.index(config.right_rx) if self.available else 0
        self._turn_back = np.exp(-1j * config.phase_offset_rad)
        self._sine_per_rad = wavelength_m / (2 * np.pi * config.spacing_m)

    def measure(self, spectrum: np.ndarray, bins: np.ndarray, doppler: np.ndarray) -> np.ndarray:
        """Azimuth of the cells (bins[i], doppler[i]) of a (rx, doppler, bin) spectrum, (N,) radians; NaN = not to tell.

        Neighbours in Doppler are added coherently: they hold the same target.
        """
        if not self.available:
            return np.full(len(bins), np.nan)
        around = (doppler[:, None] + np.array([-1, 0, 1])) % spectrum.shape[1]
        left = spectrum[self._left, around, bins[:, None]]
        right = spectrum[self._right, around, bins[:, None]]
        phase = np.angle((right * left.conj()).sum(axis=1) * self._turn_back)
        return np.arcsin(np.minimum(np.maximum(phase * self._sine_per_rad, -1.0), 1.0))
