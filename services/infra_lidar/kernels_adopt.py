"""Compiled adoption of stray returns: what a grazing view leaves of the long side of a bus or truck.

Along a side seen at a small angle the returns of neighbouring columns lie metres apart: single points that make no
piece. A tall group of pieces (an end face, as a rule) takes those that continue it in one line, as long as the whole
fits a large vehicle and the strays lie on its outline: on a side or on the roof. Leaves of a hedge lie anywhere. Only
what belongs to no cluster is taken, so nobody loses a point.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner
from services.infra_lidar.kernels_footprints import COS, ROWS, SIN, TOP, X, Y, along, extent, highest, side_by_side
from services.infra_lidar.kernels_merge import LARGE_GAP_M, LARGE_LENGTH_M, LARGE_TOP_M, SMALL_TOP_M
from services.infra_lidar.ordering import rising, rising_in
from services.infra_lidar.vectors import (
    LANES,
    fma,
    lane_count,
    lanes,
    larger,
    load_of_row,
    magnitude,
    root,
    smaller,
    splat,
    store,
    store_chosen,
)

CROSS_M, CROSS_SLOPE = 0.25, 0.006  # a gap, seen from the sensor, is at most two beams wide and 25 cm
WIDTH_M = 2.9  # a bus is 2.55 m wide; the rest is noise and a direction that is a little off
FACE_M = 0.2  # this near the outline a stray is on it
OUTLINE_SHARE = 0.7
# Cosine and sine of the directions to try about that of a group
TURNS = np.array([(np.cos(a), np.sin(a)) for a in (0.0, 0.04, -0.04, 0.08, -0.08, 0.12, -0.12)], np.float32)


@inner
def _grow(members, n, strays, m, reach, c, s, strict, spans, away, possible, order, taken):  # type: ignore[no-untyped-def]
    """Mark those of the m strays that the n members grow by along (c, s), both side by side; returns how many.

    reach (2, m): distance of each stray and how wide a gap two beams explain there, seen at a right angle; the sensor
    is above (0, 0). ``strict``: only those on the outline, and none where they are few. spans (4, m), away (m,)
    float32, possible (m,) int32 and order (m,) int64 are scratch; all of these have room for a vector more.
    """
    u0, u1, v0, v1 = extent(members, n, c, s)
    taken[:] = False
    if u1 - u0 > LARGE_LENGTH_M or v1 - v0 > WIDTH_M:
        return 0
    number = 0
    for j in range(_within_a_vehicle(strays, m, u0, u1, v0, v1, c, s, spans, away, possible, order)):
        i = possible[order[j]]
        a, b, d, e = spans[0, i], spans[1, i], spans[2, i], spans[3, i]
        gap, across = max(a - u1, u0 - b), np.float32(0.5) * abs(d + e)
        if gap > LARGE_GAP_M or gap * max(across, np.float32(1e-3) * reach[0, i]) > reach[0, i] * reach[1, i]:
            continue
        a, b, d, e = min(u0, a), max(u1, b), min(v0, d), max(v1, e)
        if b - a <= LARGE_LENGTH_M and e - d <= WIDTH_M:
            u0, u1, v0, v1 = a, b, d, e
            taken[i] = True
            number += 1
    return _keep_outline(members, n, strays, m, spans, v0, v1, taken) if strict else number


@inner
def _within_a_vehicle(strays, m, u0, u1, v0, v1, c, s, spans, away, possible, order):  # type: ignore[no-untyped-def]
    """Which of the strays leave a vehicle possible, each by itself, of which u0 to v1 is there: those are ``possible``,
    and ``order`` that in which they are farther and farther ``away`` from its middle. spans (4, m) is the extent of
    all. Returns how many are possible."""
    number, length, width = np.int64(0), np.float32(LARGE_LENGTH_M), np.float32(WIDTH_M)
    for i in range(0, m, LANES):
        a, b, d, e = along(strays, i, c, s)
        store(spans[0], i, a)
        store(spans[1], i, b)
        store(spans[2], i, d)
        store(spans[3], i, e)
        fits = (larger(b, u1) - smaller(a, u0) <= length) & (larger(e, v1) - smaller(d, v0) <= width)
        fits &= lanes() < np.int32(m - i)
        store_chosen(away, number, magnitude((a + b) - (u0 + u1)), fits)
        store_chosen(possible, number, lanes() + np.int32(i), fits)
        number += lane_count(fits)
    rising_in(away, number, order)
    return number


@inner
def _keep_outline(members, n, strays, m, spans, v0, v1, taken):  # type: ignore[no-untyped-def]
    """Keep of the taken those on a side or on the roof; all go where those are few. Returns how many are left."""
    number, on, top = 0, 0, highest(members, n)
    for i in range(m):
        if taken[i]:
            top = max(top, strays[TOP, i])
    for i in range(m):
        if taken[i]:
            number += 1
            at_side = (spans[2, i] - v0 < FACE_M) | (v1 - spans[3, i] < FACE_M)
            taken[i] = at_side | (top - strays[TOP, i] < FACE_M)
            on += taken[i]
    if on < OUTLINE_SHARE * number:
        taken[:] = False
        return 0
    return on


@inner
def _near(foot, core, loose, size, group, min_points):  # type: ignore[no-untyped-def]
    """Pieces that are still loose, within a vehicle's length of piece ``core``: a list, and how many."""
    near, number = np.empty(len(loose) + LANES, np.int32), np.int64(0)
    for k in loose:
        dx, dy = foot[X, k] - foot[X, core], foot[Y, k] - foot[Y, core]
        if dx * dx + dy * dy < LARGE_LENGTH_M * LARGE_LENGTH_M and size[group[k]] < min_points:
            near[number] = k
            number += 1
    return near, number


@inner
def _best(members, n, strays, m):  # type: ignore[no-untyped-def]
    """(m,) bool: which of m strays the n members take in the direction in which they take most; both are side by side,
    (ROWS, n and m or more)."""
    taken, best, room = np.zeros(m, np.bool_), np.zeros(m, np.bool_), m + LANES
    reach, spans = np.empty((2, room), np.float32), np.empty((4, room), np.float32)
    away, possible, order = np.empty(room, np.float32), np.empty(room, np.int32), np.empty(room, np.int64)
    for i in range(0, m, LANES):
        x, y = load_of_row(strays, X, i), load_of_row(strays, Y, i)
        far = larger(root(fma(x, x, y * y)), np.float32(1e-3))
        store(reach[0], i, far)
        store(reach[1], i, fma(far, np.float32(CROSS_SLOPE), splat(np.float32(CROSS_M))))
    middle_c, middle_s = np.float32(1.0), np.float32(0.0)  # tried where no direction of a member takes anything
    for strict in range(2):  # first any direction of a member, then directions about the best of these
        most, tries, best_c, best_s = 0, len(TURNS) if strict else 2 * n, middle_c, middle_s
        best[:] = False
        for i in range(tries):
            if strict:
                turn_c, turn_s = TURNS[i]
                c, s = middle_c * turn_c - middle_s * turn_s, middle_s * turn_c + middle_c * turn_s
            else:
                c, s = members[COS, i // 2], members[SIN, i // 2]
                if i % 2:
                    c, s = -s, c
            number = _grow(members, n, strays, m, reach, c, s, strict == 1, spans, away, possible, order, taken)
            if number > most:
                most, best_c, best_s = number, c, s
                for k in range(len(taken)):  # spelled out: whole-array assignments take the compiler seconds
                    best[k] = taken[k]
        middle_c, middle_s = best_c, best_s
    return best


@inner
def adopt_strays(foot, counts, min_points, group):  # type: ignore[no-untyped-def]
    """Let tall groups of ``min_points`` or more take loose pieces, the largest group first.

    foot: the ``footprints`` of K pieces, counts (K,) their points; group (K,) is rewritten.
    """
    total = len(counts)
    size, top = np.zeros(total, np.int64), np.zeros(total, np.float32)
    for k in range(total):
        size[group[k]] += counts[k]
        top[group[k]] = max(top[group[k]], foot[TOP, k])
    loose, number = np.empty(total, np.int64), 0
    for k in range(total):
        loose[number] = k
        number += size[group[k]] < min_points and foot[TOP, k] <= LARGE_TOP_M
    loose = loose[:number]
    tall, first, number = np.empty(total, np.int64), np.empty(total, np.float32), 0
    for g in range(total):
        tall[number], first[number] = g, -size[g]
        number += size[g] >= min_points and SMALL_TOP_M < top[g] <= LARGE_TOP_M
    for i in rising(first[:number]):
        g = tall[i]
        strays, m = _near(foot, g, loose, size, group, min_points)
        if m > 0:
            _adopt(foot, g, strays, m, group)


@inner
def _adopt(foot, g, strays, m, group):  # type: ignore[no-untyped-def]
    """Let group g take its share of the m strays listed. A group's number is that of its first member."""
    members, n = np.empty(len(group) + LANES, np.int32), np.int64(0)  # a literal would have all compiled once more
    for k in range(g, len(group)):
        members[n] = k
        n += group[k] == g
    own, others = np.empty((ROWS, n + LANES), np.float32), np.empty((ROWS, m + LANES), np.float32)
    side_by_side(foot, members, n, own)
    side_by_side(foot, strays, m, others)
    best = _best(own, n, others, m)
    for i in range(m):
        if best[i]:
            group[strays[i]] = g
