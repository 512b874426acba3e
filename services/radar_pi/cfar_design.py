"""Theory of the two detectors: threshold factor for a wanted false alarm probability.

A noise cell is the mean of ``looks`` independent squared magnitudes: Gamma(looks) / looks, times the noise power.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import betaincinv, gammaincc, gammaincinv


def ca_scale(p_fa: float, cells: int, looks: int = 1) -> float:
    """Factor on the mean of the training cells.

    The cell's share of cell plus training sum is Beta(looks, cells * looks); for one look this is the well-known
    ``cells * (p_fa ** (-1 / cells) - 1)``.
    """
    rest = float(betaincinv(cells * looks, looks, p_fa))
    return cells * (1 - rest) / rest


def os_p_fa(scale: float, rank: int, cells: int, looks: int = 1) -> float:
    """False alarm probability of ``cell > scale * rank-th smallest of cells``.

    The rank-th smallest of uniform variables is Beta(rank, cells - rank + 1): integrate over its quantiles.
    """
    quantile = (np.arange(4000) + 0.5) / 4000
    statistic = gammaincinv(looks, betaincinv(rank, cells - rank + 1, quantile))
    return float(np.mean(gammaincc(looks, scale * statistic)))


def os_scale(p_fa: float, rank: int, cells: int, looks: int = 1) -> float:
    """Factor on the order statistic for a false alarm probability."""

    def log_ratio(scale: float) -> float:
        return float(np.log(max(os_p_fa(scale, rank, cells, looks), 1e-300) / p_fa))

    return float(brentq(log_ratio, 0.01, 1000.0, xtol=1e-4))


def os_mean_ratio(rank: int, cells: int, looks: int = 1) -> float:
    """Order statistic over mean noise power, by its quantile."""
    return float(gammaincinv(looks, rank / (cells + 1)) / looks)
