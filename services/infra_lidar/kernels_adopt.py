"""Compiled adoption of stray returns: what a grazing view leaves of the long side of a bus or truck.

Along a side seen at a small angle the returns of neighbouring columns lie metres apart: single points that make no
piece. A tall group of pieces (an end face, as a rule) takes those that continue it in one line, as long as the whole
fits a large vehicle and the strays lie on its outline: on a side or on the roof. Leaves of a hedge lie anywhere. Only
what belongs to no cluster is taken, so nobody loses a point.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner, kernel
from services.infra_lidar.kernels_merge import LARGE_GAP_M, LARGE_LENGTH_M, LARGE_TOP_M, SMALL_TOP_M
from services.infra_lidar.ordering import rising

CROSS_M, CROSS_SLOPE = 0.25, 0.006  # a gap, seen from the sensor, is at most two beams wide and 25 cm
WIDTH_M = 2.9  # a bus is 2.55 m wide; the rest is noise and a direction that is a little off
FACE_M = 0.2  # this near the outline a stray is on it
OUTLINE_SHARE = 0.7
TURNS_RAD = np.array([0.0, 0.04, -0.04, 0.08, -0.08, 0.12, -0.12])  # directions to try about that of a group


@inner
def _interval(box, turned, k, c, s):  # type: ignore[no-untyped-def]
    """Extent of footprint k along the direction (c, s) and across it."""
    u, v = c * box[k, 0] + s * box[k, 1], c * box[k, 1] - s * box[k, 0]
    own_c, own_s = turned[k, 0], turned[k, 1]
    dot, cross = abs(own_c * c + own_s * s), abs(own_c * s - own_s * c)
    half_u = 0.5 * (box[k, 3] * dot + box[k, 4] * cross)
    half_v = 0.5 * (box[k, 3] * cross + box[k, 4] * dot)
    return u - half_u, u + half_u, v - half_v, v + half_v


@inline
def _longest_gap(box, k, c, s):  # type: ignore[no-untyped-def]
    """The gap before piece k that two beams explain, along (c, s); the sensor is above (0, 0)."""
    distance = max(np.hypot(box[k, 0], box[k, 1]), 1e-3)
    sine = abs(c * box[k, 1] - s * box[k, 0]) / distance
    return min(LARGE_GAP_M, (CROSS_M + CROSS_SLOPE * distance) / max(sine, 1e-3))


@inner
def _grow(box, turned, members, strays, yaw, strict, taken):  # type: ignore[no-untyped-def]
    """Mark the strays that the members grow by along ``yaw``; returns how many.

    ``strict``: only those on the outline, and none where they are few.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    u0 = v0 = np.inf
    u1 = v1 = -np.inf
    top = np.float32(0.0)
    for k in members:
        a, b, d, e = _interval(box, turned, k, c, s)
        u0, u1, v0, v1 = min(u0, a), max(u1, b), min(v0, d), max(v1, e)
        top = max(top, box[k, 7] + box[k, 5])
    taken[:] = False
    if u1 - u0 > LARGE_LENGTH_M or v1 - v0 > WIDTH_M:
        return 0
    number = 0
    away = np.empty(len(strays))
    for i in range(len(strays)):
        away[i] = abs(c * box[strays[i], 0] + s * box[strays[i], 1] - 0.5 * (u0 + u1))
    for i in rising(away):
        k = strays[i]
        a, b, d, e = _interval(box, turned, k, c, s)
        if max(a - u1, u0 - b) > _longest_gap(box, k, c, s):
            continue
        a, b, d, e = min(u0, a), max(u1, b), min(v0, d), max(v1, e)
        if b - a <= LARGE_LENGTH_M and e - d <= WIDTH_M:
            u0, u1, v0, v1 = a, b, d, e
            top = max(top, box[k, 7] + box[k, 5])
            taken[i] = True
            number += 1
    return _keep_outline(box, turned, strays, c, s, v0, v1, top, taken) if strict else number


@inner
def _keep_outline(box, turned, strays, c, s, v0, v1, top, taken):  # type: ignore[no-untyped-def]
    """Keep of the taken those on a side or on the roof; all go where those are few. Returns how many are left."""
    number, on = 0, 0
    for i in range(len(strays)):
        if taken[i]:
            number += 1
            k = strays[i]
            _, _, d, e = _interval(box, turned, k, c, s)
            taken[i] = (d - v0 < FACE_M) | (v1 - e < FACE_M) | (top - box[k, 7] - box[k, 5] < FACE_M)
            on += taken[i]
    if on < OUTLINE_SHARE * number:
        taken[:] = False
        return 0
    return on


@inner
def _near(box, core, loose, size, group, min_points):  # type: ignore[no-untyped-def]
    """Pieces that are still loose, within a vehicle's length of piece ``core``."""
    near, number = np.empty(len(loose), np.int64), 0
    for k in loose:
        dx, dy = box[k, 0] - box[core, 0], box[k, 1] - box[core, 1]
        if dx * dx + dy * dy < LARGE_LENGTH_M**2 and size[group[k]] < min_points:
            near[number] = k
            number += 1
    return near[:number]


@inner
def _best(box, turned, members, strays):  # type: ignore[no-untyped-def]
    """(S,) bool: the strays that the members take in the direction in which they take most."""
    taken, best = np.zeros(len(strays), np.bool_), np.zeros(len(strays), np.bool_)
    middle = np.float64(0.0)  # tried where no direction of a member takes anything
    for strict in range(2):  # first any direction of a member, then directions about the best of these
        most, tries, best_yaw = 0, len(TURNS_RAD) if strict else 2 * len(members), middle
        best[:] = False
        for i in range(tries):
            yaw = middle + TURNS_RAD[i] if strict else box[members[i // 2], 6] + 0.5 * np.pi * (i % 2)
            number = _grow(box, turned, members, strays, yaw, strict == 1, taken)
            if number > most:
                most, best_yaw = number, yaw
                for k in range(len(taken)):  # spelled out: whole-array assignments take the compiler seconds
                    best[k] = taken[k]
        middle = best_yaw
    return best


@kernel
def adopt_strays(box, turned, counts, min_points, group):  # type: ignore[no-untyped-def]
    """Let tall groups of ``min_points`` or more take loose pieces, the largest group first.

    box (K, 8) as measured by ``kernels_clusters.measure`` and its ``directions``, counts (K,) points; group (K,) is
    rewritten.
    """
    total = len(counts)
    size, top = np.zeros(total, np.int64), np.zeros(total, np.float32)
    for k in range(total):
        size[group[k]] += counts[k]
        top[group[k]] = max(top[group[k]], box[k, 7] + box[k, 5])
    loose, number = np.empty(total, np.int64), 0
    for k in range(total):
        loose[number] = k
        number += size[group[k]] < min_points and box[k, 7] + box[k, 5] <= LARGE_TOP_M
    loose = loose[:number]
    for g in rising(-size.astype(np.float64)):
        if size[g] < min_points:
            break
        if SMALL_TOP_M < top[g] <= LARGE_TOP_M:
            _adopt(box, turned, g, _near(box, g, loose, size, group, min_points), group)


@kernel
def _adopt(box, turned, g, strays, group):  # type: ignore[no-untyped-def]
    """Let group g take its share of the strays. A group's number is that of its first member."""
    if len(strays) == 0:
        return
    members, number = np.empty(len(group), np.int64), 0
    for k in range(g, len(group)):
        members[number] = k
        number += group[k] == g
    best = _best(box, turned, members[:number], strays)
    for i in range(len(strays)):
        if best[i]:
            group[strays[i]] = g
