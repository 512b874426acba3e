"""The article's tracker by plain loops: the same filter, gate and lifecycle as ``plain_infra_lidar.Tracker``.

With diagonal Q, R and initial covariance the six-state filter falls apart into three two-state filters that share one
covariance, so the squared Mahalanobis distance is |y|^2 / S.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from services.infra_lidar.jit import kernel

Q_POSITION, Q_VELOCITY, R = 0.5, 2.0, 0.3  # added by a step, and of a measurement
NEW_POSITION, NEW_VELOCITY = 0.5, 10.0  # variances of a new track
GATE, MOST_COST, NO_PAIR = 7.81, 5.0, 1e6
CONFIRMED_HITS, TENTATIVE_MISSES, CONFIRMED_MISSES = 2, 1, 3


class Tracks(NamedTuple):
    """T tracks: number, label, hits, misses (T,) int64, confirmed (T,) bool, state (T, 6) position and velocity, and
    covariance (T, 3): variance of the position, covariance of position and velocity, variance of the velocity."""

    number: np.ndarray
    label: np.ndarray
    hits: np.ndarray
    misses: np.ndarray
    confirmed: np.ndarray
    state: np.ndarray
    covariance: np.ndarray


class ArticleTracker:
    """``tracks`` from one frame to the next."""

    def __init__(self, dt_s: float = 0.1) -> None:
        self._dt_s, self._next, self.tracks = dt_s, 0, _no_tracks(0)

    def update(self, centres: np.ndarray, labels: np.ndarray) -> None:
        """Detections (K, 3) with their class (K,)."""
        tracks, centres = self.tracks, np.ascontiguousarray(centres, np.float64)
        _predict(tracks, self._dt_s)
        cost = _costs(tracks, centres, labels)
        rows, columns = linear_sum_assignment(cost)
        taken = np.full(len(tracks.number), -1)
        taken[rows] = np.where(cost[rows, columns] < MOST_COST, columns, -1)
        alive = _correct(tracks, centres, taken)
        self.tracks = _with_new(tracks, alive, centres, labels, taken, self._next)
        self._next += len(centres) - np.count_nonzero(taken >= 0)


@kernel
def _no_tracks(n: int) -> Tracks:
    """n tracks, all zero."""
    return Tracks(
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64),
        np.zeros(n, np.bool_), np.zeros((n, 6)), np.zeros((n, 3)),
    )  # fmt: skip


@kernel
def _predict(tracks: Tracks, dt_s: float) -> None:
    for t in range(len(tracks.number)):
        for axis in range(3):
            tracks.state[t, axis] += dt_s * tracks.state[t, 3 + axis]
        p, c, v = tracks.covariance[t]
        tracks.covariance[t, 0] = p + 2.0 * dt_s * c + dt_s * dt_s * v + Q_POSITION
        tracks.covariance[t, 1], tracks.covariance[t, 2] = c + dt_s * v, v + Q_VELOCITY


@kernel
def _costs(tracks: Tracks, centres: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """(T, K) Mahalanobis distance of detections of the same class within the gate, else ``NO_PAIR``."""
    cost = np.full((len(tracks.number), len(centres)), NO_PAIR)
    for t in range(len(tracks.number)):
        for k in range(len(centres)):
            if labels[k] == tracks.label[t]:
                squared = 0.0
                for axis in range(3):
                    squared += (centres[k, axis] - tracks.state[t, axis]) ** 2
                squared /= tracks.covariance[t, 0] + R
                if squared <= GATE:
                    cost[t, k] = np.sqrt(squared)
    return cost


@kernel
def _correct(tracks: Tracks, centres: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Update the tracks with the detection that each has taken (T,), -1 = none; returns (T,) bool, which live on."""
    alive = np.empty(len(taken), np.bool_)
    for t in range(len(taken)):
        if taken[t] >= 0:
            p, c, v = tracks.covariance[t]
            gain_p, gain_v = p / (p + R), c / (p + R)
            for axis in range(3):
                y = centres[taken[t], axis] - tracks.state[t, axis]
                tracks.state[t, axis] += gain_p * y
                tracks.state[t, 3 + axis] += gain_v * y
            tracks.covariance[t, 0], tracks.covariance[t, 1] = (1.0 - gain_p) * p, (1.0 - gain_p) * c
            tracks.covariance[t, 2] = v - gain_v * c
            tracks.hits[t] += 1
        tracks.misses[t] = 0 if taken[t] >= 0 else tracks.misses[t] + 1
        tracks.confirmed[t] |= tracks.hits[t] >= CONFIRMED_HITS
        alive[t] = tracks.misses[t] < (CONFIRMED_MISSES if tracks.confirmed[t] else TENTATIVE_MISSES)
    return alive


@kernel
def _with_new(
    tracks: Tracks, alive: np.ndarray, centres: np.ndarray, labels: np.ndarray, taken: np.ndarray, number: int
) -> Tracks:
    """The tracks that live on, then one for each detection that none has taken, numbered from ``number`` on."""
    free = np.ones(len(centres), np.bool_)
    for k in taken:
        if k >= 0:
            free[k] = False
    kept, new = np.flatnonzero(alive), np.flatnonzero(free)
    out = _no_tracks(len(kept) + len(new))
    for i in range(len(kept)):
        t = kept[i]
        out.number[i], out.label[i], out.hits[i] = tracks.number[t], tracks.label[t], tracks.hits[t]
        out.misses[i], out.confirmed[i] = tracks.misses[t], tracks.confirmed[t]
        out.state[i], out.covariance[i] = tracks.state[t], tracks.covariance[t]
    for i in range(len(new)):
        to = len(kept) + i
        out.number[to], out.label[to], out.hits[to] = number + i, labels[new[i]], 1
        out.state[to, :3] = centres[new[i]]
        out.covariance[to, 0], out.covariance[to, 2] = NEW_POSITION, NEW_VELOCITY
    return out
