"""The noise level of each range row: a low quantile over Doppler, which no body and no standing clutter reaches."""

from __future__ import annotations

import math

import numpy as np

from services.radar_pi.cfar_design import os_mean_ratio

QUANTILE = 0.4


class RowNoise:
    """Mean noise power per range row of an (R, D) map that is the mean of ``looks`` receivers."""

    def __init__(self, columns: int, looks: int) -> None:
        rank = max(1, round(QUANTILE * columns))
        self._index = rank - 1
        self._per_level = np.float32(1.0 / os_mean_ratio(rank, columns, looks))

    def estimate(self, power: np.ndarray) -> np.ndarray:
        """(R, D) -> (R, 1) mean noise power per cell."""
        level: np.ndarray = np.sort(power, axis=1)[:, self._index : self._index + 1]
        return level * self._per_level


def noise_floor_db(row_noise: np.ndarray) -> float:
    """Noise of the whole map per ADC sample: dB over one squared step."""
    middle = float(np.sort(row_noise, axis=0)[len(row_noise) // 2, 0])
    return 10 * math.log10(max(middle, 1e-12))
