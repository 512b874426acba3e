"""Small fragments attached to large vehicles: what a grazing view leaves of the long side of a bus or truck.

Along a side seen at a small angle the returns of neighbouring columns lie metres apart, so they form no cluster. A
tall group of fragments (an end face, as a rule) takes those that continue it in one line, as long as the whole fits a
large vehicle and they lie on its outline: on a side or on the roof. Leaves of a hedge lie anywhere. Only fragments of
fewer than ``min_points`` points are taken, single returns as a rule.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.clustering.merge_vehicles import (
    COS,
    LARGE_GAP_M,
    LARGE_LENGTH_M,
    LARGE_TOP_M,
    SIN,
    SMALL_TOP_M,
    TOP,
    X,
    Y,
    extent_along,
    extent_of_all,
)
from services.infra_lidar.jit import kernel

CROSS_M, CROSS_SLOPE = 0.25, 0.006  # a gap, seen from the sensor, is at most two beams wide and 25 cm
WIDTH_M = 2.9  # a bus is 2.55 m wide; the rest is noise and an error of the direction
FACE_M = 0.2  # a return this near the outline is on it
OUTLINE_SHARE = 0.7
TURNS_RAD = (0.0, 0.04, -0.04, 0.08, -0.08, 0.12, -0.12)  # directions to try about that of a group


@kernel
def attach_small_fragments(foot: np.ndarray, counts: np.ndarray, min_points: int, group: np.ndarray) -> None:
    """Let tall groups of ``min_points`` or more take smaller ones; the largest group first. Rewrites ``group``.

    foot: (K, COLUMNS) ``footprints``, counts: (K,) points, group: (K,) int32 as by ``merge_fragments``.
    """
    size, top = np.zeros(len(counts), np.float32), np.zeros(len(counts), np.float32)
    for k in range(len(counts)):
        size[group[k]] += counts[k]
        top[group[k]] = max(top[group[k]], foot[k, TOP])
    loose = np.flatnonzero((size[group] < min_points) & (foot[:, TOP] <= LARGE_TOP_M))
    tall = np.flatnonzero((size >= min_points) & (top > SMALL_TOP_M) & (top <= LARGE_TOP_M))
    for g in tall[np.argsort(-size[tall], kind="mergesort")]:
        dx, dy = foot[loose, X] - foot[g, X], foot[loose, Y] - foot[g, Y]
        in_reach = dx * dx + dy * dy < LARGE_LENGTH_M * LARGE_LENGTH_M
        near = loose[in_reach & (size[group[loose]] < min_points)]
        if len(near) > 0:
            group[near[_best_selection(foot, np.flatnonzero(group == g), near)]] = g
    # A group may have got a member before its first, or lost its first to another: name it after its smallest again
    smallest = np.full(len(group), -1, np.int32)
    for k in range(len(group)):
        if smallest[group[k]] < 0:
            smallest[group[k]] = k
    for k in range(len(group)):
        group[k] = smallest[group[k]]


@kernel
def _best_selection(foot: np.ndarray, members: np.ndarray, near: np.ndarray) -> np.ndarray:
    """(S,) bool: the returns ``near`` that ``members`` take, in the direction in which they take most.

    First every direction of a member and its perpendicular, then directions about the best of these, on the outline.
    """
    most, c, s = 0, np.float32(1.0), np.float32(0.0)
    for k in members:
        for turn in range(2):
            try_c, try_s = (foot[k, COS], foot[k, SIN]) if turn == 0 else (-foot[k, SIN], foot[k, COS])
            number = _in_line(foot, members, near, try_c, try_s).sum()
            if number > most:
                most, c, s = number, try_c, try_s
    most, best = 0, np.zeros(len(near), np.bool_)
    for angle in TURNS_RAD:
        turn_c, turn_s = np.float32(math.cos(angle)), np.float32(math.sin(angle))
        try_c, try_s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
        taken = _in_line(foot, members, near, try_c, try_s)
        _keep_outline(foot, members, near, (try_c, try_s), taken)
        if taken.sum() > most:
            most, best = taken.sum(), taken
    return best


@kernel
def _in_line(foot: np.ndarray, members: np.ndarray, near: np.ndarray, c: np.float32, s: np.float32) -> np.ndarray:
    """(S,) bool: returns ``near`` that continue the members along (c, s), from the middle outwards."""
    taken = np.zeros(len(near), np.bool_)
    u0, u1, v0, v1 = extent_of_all(foot, members, c, s)
    if u1 - u0 > LARGE_LENGTH_M or v1 - v0 > WIDTH_M:
        return taken
    middle, possible, away, number = u0 + u1, np.empty(len(near), np.int64), np.empty(len(near), np.float32), 0
    for i in range(len(near)):
        a, b, d, e = extent_along(foot[near[i]], c, s)
        if max(b, u1) - min(a, u0) <= LARGE_LENGTH_M and max(e, v1) - min(d, v0) <= WIDTH_M:
            possible[number], away[number] = i, abs(a + b - middle)
            number += 1
    for i in possible[np.argsort(away[:number], kind="mergesort")]:
        a, b, d, e = extent_along(foot[near[i]], c, s)
        range_m = max(math.hypot(foot[near[i], X], foot[near[i], Y]), 1e-3)
        gap, across = max(a - u1, u0 - b), 0.5 * abs(d + e)
        if gap > LARGE_GAP_M or gap * max(across, 1e-3 * range_m) > range_m * (CROSS_M + CROSS_SLOPE * range_m):
            continue
        if max(b, u1) - min(a, u0) <= LARGE_LENGTH_M and max(e, v1) - min(d, v0) <= WIDTH_M:
            u0, u1, v0, v1 = min(u0, a), max(u1, b), min(v0, d), max(v1, e)
            taken[i] = True
    return taken


@kernel
def _keep_outline(
    foot: np.ndarray, members: np.ndarray, near: np.ndarray, direction: tuple[np.float32, np.float32], taken: np.ndarray
) -> None:
    """Keep of ``taken`` (S,) bool the returns on a side or on the roof; none where these are few."""
    c, s = direction
    _, _, v0, v1 = extent_of_all(foot, members, c, s)
    top, number = foot[members, TOP].max(), taken.sum()
    for i in np.flatnonzero(taken):
        _, _, d, e = extent_along(foot[near[i]], c, s)
        v0, v1, top = min(v0, d), max(v1, e), max(top, foot[near[i], TOP])
    for i in np.flatnonzero(taken):
        _, _, d, e = extent_along(foot[near[i]], c, s)
        taken[i] = d - v0 < FACE_M or v1 - e < FACE_M or top - foot[near[i], TOP] < FACE_M
    if taken.sum() < OUTLINE_SHARE * number:
        taken[:] = False
