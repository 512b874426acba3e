"""Which detection belongs to which track: gate, cost, Hungarian.

Cost of a pair = d2 + ln det S + w * class term. d2 is the squared Mahalanobis distance of the innovation and has to
pass the gate; ln det S keeps a track that knows little from winning every tie; the class term is -ln of the chance
that track and detection are of one class, so that another class costs something and forbids nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.optimize import linear_sum_assignment

from services.infra_lidar.tracking_filter import innovation

FORBIDDEN = 1e6
_jit = njit(nogil=True, cache=True, error_model="numpy")


def associate(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (track indices, detection indices) of least total cost among as many allowed pairs as possible.

    Two that are allowed nobody but each other need no Hungarian: it is left with the contested ones.
    """
    rows, columns, contested_rows, contested_columns = _easy_pairs(cost)
    if len(contested_rows):
        rest = cost[np.ix_(contested_rows, contested_columns)]
        r, c = linear_sum_assignment(rest)
        allowed = rest[r, c] < FORBIDDEN
        rows = np.concatenate((rows, contested_rows[r[allowed]]))
        columns = np.concatenate((columns, contested_columns[c[allowed]]))
    return rows, columns


@_jit
def _easy_pairs(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows and columns of the pairs that have no alternative, then the rows and columns that have one."""
    n, k = cost.shape
    in_row, in_column, only = np.zeros(n, np.int64), np.zeros(k, np.int64), np.zeros(n, np.int64)
    for t in range(n):
        for d in range(k):
            if cost[t, d] < FORBIDDEN:
                in_row[t], in_column[d], only[t] = in_row[t] + 1, in_column[d] + 1, d
    easy = np.zeros(n, np.bool_)
    for t in range(n):
        easy[t] = in_row[t] == 1 and in_column[only[t]] == 1
        if easy[t]:
            in_row[t] = in_column[only[t]] = 0
    rows = np.flatnonzero(easy)
    return rows, only[rows], np.flatnonzero(in_row), np.flatnonzero(in_column)


@_jit
def _another_size(known: np.ndarray, seen: np.ndarray) -> bool:
    """A track may lose most of its visible part, but does not become several times as large in one turn."""
    return max(seen[0], seen[1]) > 2.5 * max(known[0], known[1]) + 1.0


@_jit
def pair_costs(
    tracks: np.ndarray, position: np.ndarray, size: np.ndarray, yaw: np.ndarray, chances: np.ndarray,
    sigma: float, height_sigma: float, gate: float, class_weight: float, visible: bool,
) -> np.ndarray:  # fmt: skip
    """(N, K) cost, ``FORBIDDEN`` outside the gate. ``chances`` (K, C): the class probabilities of the detections."""
    cost = np.full((len(tracks), len(position)), FORBIDDEN)
    pair = np.empty(5)
    for t in range(len(tracks)):
        track = tracks[t]
        mean, cov, votes = track.mean, track.cov, track.votes
        total = votes.sum()
        own = 0.5 * (track.size[0] + track.size[1]) if visible else 0.0
        reach = own + 4.0 * math.sqrt(max(cov[0, 0], cov[1, 1]) + sigma * sigma) * math.sqrt(gate / 7.81)
        for d in range(len(position)):
            beyond = reach + (0.5 * (size[d, 0] + size[d, 1]) if visible else 0.0)
            if abs(position[d, 0] - mean[0]) > beyond or abs(position[d, 1] - mean[1]) > beyond:
                continue
            if visible and _another_size(track.size, size[d]):
                continue
            innovation(mean, track.size, track.yaw, position[d], size[d], yaw[d], sigma, visible, pair)
            sxx, sxy, syy = cov[0, 0] + pair[2], cov[0, 1] + pair[3], cov[1, 1] + pair[4]
            szz = cov[2, 2] + height_sigma * height_sigma
            det = sxx * syy - sxy * sxy
            dz = position[d, 2] - mean[2]
            d2 = (pair[0] ** 2 * syy - 2.0 * pair[0] * pair[1] * sxy + pair[1] ** 2 * sxx) / det + dz * dz / szz
            if d2 > gate:
                continue
            same = 0.0
            for c in range(len(votes)):
                same += votes[c] * chances[d, c]
            cost[t, d] = d2 + math.log(det * szz) - class_weight * math.log(same / total + 0.02)
    return cost
