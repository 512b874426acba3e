"""Which detection belongs to which track: gate, cost, Hungarian.

Cost of a pair = d2 + ln det S + w * class term. d2 is the squared Mahalanobis distance of the innovation and has to
pass the gate; ln det S keeps a track that knows little from winning every tie; the class term is -ln of the chance
that track and detection are of one class, so that another class costs something and forbids nothing. The article's
cost is a setting: the distance alone, and another class is forbidden.

Only pairs within reach are looked at: detections are sorted along x, and a track looks into its own stretch.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from services.infra_lidar.jit import inner
from services.infra_lidar.ordering import places_of, rising
from services.infra_lidar.tracking_filter import innovation

FORBIDDEN = 1e6


_NONE = np.zeros(0, np.int64)


def cheapest(costs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (A,) of the least total cost: the Hungarian, for those that are contested; most are not."""
    return linear_sum_assignment(costs) if costs.size else (_NONE, _NONE)


@inner
def chosen_pairs(
    sure_t: np.ndarray, sure_d: np.ndarray, contested_t: np.ndarray, contested_d: np.ndarray, costs: np.ndarray,
    r: np.ndarray, c: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Pairs (track indices, detection indices) of least total cost among as many allowed pairs as possible: the sure
    ones, from what ``easy_pairs`` says, and those of contested tracks r and detections c (A,), ``cheapest``, that are
    allowed."""
    number, room = len(sure_t), len(sure_t) + len(r)
    rows, columns = np.empty(room, np.int64), np.empty(room, np.int64)
    for i in range(number):
        rows[i], columns[i] = sure_t[i], sure_d[i]
    for i in range(len(r)):
        if costs[r[i], c[i]] < FORBIDDEN:
            rows[number], columns[number] = contested_t[r[i]], contested_d[c[i]]
            number += 1
    return rows[:number], columns[:number]


@inner
def easy_pairs(
    rows: np.ndarray, columns: np.ndarray, costs: np.ndarray, tracks: int, detections: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The pairs that have no alternative, then the tracks and detections that have one, and their cost matrix.

    ``rows``, ``columns``, ``costs`` (A,): the allowed pairs of ``tracks`` tracks and ``detections`` detections.
    """
    in_row, in_column = np.zeros(tracks, np.int64), np.zeros(detections, np.int64)
    for i in range(len(rows)):
        in_row[rows[i]] += 1
        in_column[columns[i]] += 1
    easy = np.zeros(len(rows), np.bool_)
    for i in range(len(rows)):
        easy[i] = in_row[rows[i]] == 1 and in_column[columns[i]] == 1
        if easy[i]:
            in_row[rows[i]] = in_column[columns[i]] = 0
    contested_t, contested_d = places_of(in_row), places_of(in_column)
    for i in range(len(contested_t)):
        in_row[contested_t[i]] = i
    for i in range(len(contested_d)):
        in_column[contested_d[i]] = i
    rest = np.full((len(contested_t), len(contested_d)), FORBIDDEN)
    for i in range(len(rows)):
        if not easy[i]:
            rest[in_row[rows[i]], in_column[columns[i]]] = costs[i]
    return rows[easy], columns[easy], contested_t, contested_d, rest


@inner
def allowed_pairs(tracks: np.ndarray, detections: np.ndarray, p: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Track, detection and cost of every pair within the gate, three arrays of one length."""
    count = len(detections)
    x, y, extent, widest = np.empty(count), np.empty(count), np.empty(count), 0.0
    for d in range(count):
        x[d], y[d] = detections[d].position[0], detections[d].position[1]
        extent[d] = 0.5 * (detections[d].size[0] + detections[d].size[1]) if p.visible else 0.0
        widest = max(widest, extent[d])
    order = rising(x)
    room, stretch = 0, np.empty((len(tracks), 2), np.int64)
    for t in range(len(tracks)):
        place, reach = tracks[t].mean[0], _reach(tracks[t], p) + widest
        stretch[t, 0], stretch[t, 1] = _first_from(x, order, place - reach), _first_from(x, order, place + reach)
        room += stretch[t, 1] - stretch[t, 0]
    rows, columns, costs, found = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room), 0
    for t in range(len(tracks)):
        track = tracks[t]
        reach, track_x, track_y = _reach(track, p), track.mean[0], track.mean[1]
        for k in range(stretch[t, 0], stretch[t, 1]):
            d = order[k]
            if abs(x[d] - track_x) > reach + extent[d] or abs(y[d] - track_y) > reach + extent[d]:
                continue
            cost = _pair_cost(track, detections[d], p)
            if cost < FORBIDDEN:
                rows[found], columns[found], costs[found] = t, d, cost
                found += 1
    return rows[:found], columns[:found], costs[:found]


@inner
def _first_from(x: np.ndarray, order: np.ndarray, least: float) -> int:
    """How many x are smaller, by halving; ``order`` is that in which they rise."""
    low, high = 0, len(order)
    while low < high:
        middle = (low + high) // 2
        if x[order[middle]] < least:
            low = middle + 1
        else:
            high = middle
    return low


@inner
def _reach(track: Any, p: Any) -> float:
    """How far from the track, along x or y, the centre of a point-like detection may lie and pass the gate."""
    sigma = p.position_sigma_m
    own = 0.5 * (track.size[0] + track.size[1]) if p.visible else 0.0
    spread = max(track.cov[0, 0], track.cov[1, 1]) + sigma * sigma
    return own + 1.45 * math.sqrt(spread * p.gate)


@inner
def _pair_cost(track: Any, detection: Any, p: Any) -> float:
    """Cost of one pair, ``FORBIDDEN`` outside the gate."""
    mean, cov, position = track.mean, track.cov, detection.position
    if p.hard and detection.label != track.label:
        return FORBIDDEN
    if p.visible and another_size(track.size, detection.size):
        return FORBIDDEN
    ex, ey, rxx, rxy, ryy = innovation(mean, track.size, track.yaw, position, detection.size, detection.yaw, p)
    sxx, sxy, syy = cov[0, 0] + rxx, cov[0, 1] + rxy, cov[1, 1] + ryy
    szz = cov[2, 2] + p.height_sigma_m * p.height_sigma_m
    det = sxx * syy - sxy * sxy
    dz = position[2] - mean[2]
    d2 = (ex * ex * syy - 2.0 * ex * ey * sxy + ey * ey * sxx) / det + dz * dz / szz
    if d2 > p.gate:
        return FORBIDDEN
    if p.distance:
        return math.sqrt(d2)
    same = total = 0.0
    for c in range(len(track.votes)):
        same += track.votes[c] * detection.chances[c]
        total += track.votes[c]
    return d2 + math.log(det * szz) - p.class_weight * math.log(same / total + 0.02)


@inner
def another_size(known: np.ndarray, seen: np.ndarray) -> bool:
    """A track may lose most of its visible part, but does not become several times as large in one turn."""
    return max(seen[0], seen[1]) > 2.5 * max(known[0], known[1]) + 1.0
