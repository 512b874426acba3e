"""The article's tracker without loops over pairs: the same filter, gate and lifecycle as ``plain_infra_lidar.Tracker``.

With diagonal Q, R and initial covariance the six-state filter falls apart into three two-state filters that share one
covariance, so the squared Mahalanobis distance is |y|^2 / S and everything stacks into a few arrays.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment


class ArticleTracker:
    """Tracks as arrays: number, label (T,), state (T, 6), covariance p, c, v (T, 3) of position and velocity."""

    def __init__(self, dt_s: float = 0.1) -> None:
        self._dt_s = dt_s
        self.number, self.label = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self.state, self._cov = np.zeros((0, 6)), np.zeros((0, 3))
        self._hits, self._misses = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self.confirmed = np.zeros(0, bool)
        self._next = 0

    def update(self, centres: np.ndarray, labels: np.ndarray) -> None:
        """Detections (K, 3) with their class (K,)."""
        dt = self._dt_s
        self.state[:, :3] += dt * self.state[:, 3:]
        p, c, v = self._cov.T
        self._cov = np.stack([p + 2 * dt * c + dt * dt * v + 0.5, c + dt * v, v + 2.0], axis=1)
        taken = self._associate(centres, labels)
        hit = taken >= 0
        self._correct(hit, centres[taken[hit]])
        self._hits[hit] += 1
        self._misses = np.where(hit, 0, self._misses + 1)
        self.confirmed |= self._hits >= 2
        alive = self._misses < np.where(self.confirmed, 3, 1)
        free = np.setdiff1d(np.arange(len(centres)), taken[hit])
        self._keep_and_add(alive, centres[free], labels[free])

    def _associate(self, centres: np.ndarray, labels: np.ndarray) -> np.ndarray:
        apart = self.state[:, None, :3] - centres[None]
        d2 = np.einsum("tki,tki->tk", apart, apart) / (self._cov[:, 0] + 0.3)[:, None]
        allowed = (d2 <= 7.81) & (self.label[:, None] == labels[None])
        cost = np.where(allowed, np.sqrt(d2), 1e6)
        taken = np.full(len(self.state), -1)
        rows, columns = linear_sum_assignment(cost)
        good = cost[rows, columns] < 5.0
        taken[rows[good]] = columns[good]
        return taken

    def _correct(self, hit: np.ndarray, measured: np.ndarray) -> None:
        p, c, v = self._cov[hit].T
        gain_p, gain_v = p / (p + 0.3), c / (p + 0.3)
        y = measured - self.state[hit, :3]
        self.state[hit, :3] += gain_p[:, None] * y
        self.state[hit, 3:] += gain_v[:, None] * y
        self._cov[hit] = np.stack([(1 - gain_p) * p, (1 - gain_p) * c, v - gain_v * c], axis=1)

    def _keep_and_add(self, alive: np.ndarray, centres: np.ndarray, labels: np.ndarray) -> None:
        n = len(centres)
        self.number = np.append(self.number[alive], self._next + np.arange(n))
        self._next += n
        self.label = np.append(self.label[alive], labels)
        self.state = np.vstack([self.state[alive], np.hstack([centres, np.zeros((n, 3))])])
        self._cov = np.vstack([self._cov[alive], np.tile([0.5, 0.0, 10.0], (n, 1))])
        self._hits = np.append(self._hits[alive], np.ones(n, np.int64))
        self._misses = np.append(self._misses[alive], np.zeros(n, np.int64))
        self.confirmed = np.append(self.confirmed[alive], np.zeros(n, bool))
