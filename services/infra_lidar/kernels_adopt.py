"""Compiled adoption of stray returns: what a grazing view leaves of the long side of a bus or truck.

Along a side seen at a small angle the returns of neighbouring columns lie metres apart: single points that make no
piece. A tall group of pieces (an end face, as a rule) takes those that continue it in one line, as long as the whole
fits a large vehicle and the strays lie on its outline: on a side or on the roof. Leaves of a hedge lie anywhere. Only
what belongs to no cluster is taken, so nobody loses a point.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner
from services.infra_lidar.kernels_merge import LARGE_GAP_M, LARGE_LENGTH_M, LARGE_TOP_M, SMALL_TOP_M, extent, interval
from services.infra_lidar.ordering import rising, rising_in
from services.infra_lidar.vectors import LANES

CROSS_M, CROSS_SLOPE = 0.25, 0.006  # a gap, seen from the sensor, is at most two beams wide and 25 cm
WIDTH_M = 2.9  # a bus is 2.55 m wide; the rest is noise and a direction that is a little off
FACE_M = 0.2  # this near the outline a stray is on it
OUTLINE_SHARE = 0.7
# Cosine and sine of the directions to try about that of a group
TURNS = np.array([(np.cos(a), np.sin(a)) for a in (0.0, 0.04, -0.04, 0.08, -0.08, 0.12, -0.12)])


@inner
def _grow(box, turned, members, strays, reach, c, s, strict, spans, away, ints, taken):  # type: ignore[no-untyped-def]
    """Mark the strays that the members grow by along (c, s); returns how many.

    reach (S, 2): distance of each stray and how wide a gap two beams explain there, seen at a right angle; the sensor
    is above (0, 0). ``strict``: only those on the outline, and none where they are few. spans (4, S), away (S,) float32
    with room for a vector more, and ints (2, S) int64 are scratch.
    """
    u0, u1, v0, v1 = extent(box, turned, members, c, s)
    taken[:] = False
    if u1 - u0 > LARGE_LENGTH_M or v1 - v0 > WIDTH_M:
        return 0
    possible, order, m = ints[0], ints[1], np.int64(0)  # a literal would have what takes it compiled once more
    for i in range(len(strays)):
        a, b, d, e = interval(box, turned, strays[i], c, s)
        spans[0, i], spans[1, i], spans[2, i], spans[3, i] = a, b, d, e
        possible[m], away[m] = i, abs((a + b) - (u0 + u1))
        m += max(u1, b) - min(u0, a) <= LARGE_LENGTH_M and max(v1, e) - min(v0, d) <= WIDTH_M
    rising_in(away, m, order)
    number = 0
    for j in order[:m]:
        i = possible[j]
        a, b, d, e = spans[0, i], spans[1, i], spans[2, i], spans[3, i]
        gap, across = max(a - u1, u0 - b), 0.5 * abs(d + e)
        if gap > LARGE_GAP_M or gap * max(across, 1e-3 * reach[i, 0]) > reach[i, 0] * reach[i, 1]:
            continue
        a, b, d, e = min(u0, a), max(u1, b), min(v0, d), max(v1, e)
        if b - a <= LARGE_LENGTH_M and e - d <= WIDTH_M:
            u0, u1, v0, v1 = a, b, d, e
            taken[i] = True
            number += 1
    return _keep_outline(box, members, strays, spans, v0, v1, taken) if strict else number


@inner
def _keep_outline(box, members, strays, spans, v0, v1, taken):  # type: ignore[no-untyped-def]
    """Keep of the taken those on a side or on the roof; all go where those are few. Returns how many are left."""
    number, on, top = 0, 0, np.float32(0.0)
    for k in members:
        top = max(top, box[k, 7] + box[k, 5])
    for i in range(len(strays)):
        if taken[i]:
            top = max(top, box[strays[i], 7] + box[strays[i], 5])
    for i in range(len(strays)):
        if taken[i]:
            number += 1
            k = strays[i]
            at_side = (spans[2, i] - v0 < FACE_M) | (v1 - spans[3, i] < FACE_M)
            taken[i] = at_side | (top - box[k, 7] - box[k, 5] < FACE_M)
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
    reach, spans = np.empty((len(strays), 2)), np.empty((4, len(strays)))
    away, ints = np.empty(len(strays) + LANES, np.float32), np.empty((2, len(strays)), np.int64)
    for i in range(len(strays)):
        reach[i, 0] = max(np.hypot(box[strays[i], 0], box[strays[i], 1]), 1e-3)
        reach[i, 1] = CROSS_M + CROSS_SLOPE * reach[i, 0]
    middle_c, middle_s = np.float64(1.0), np.float64(0.0)  # tried where no direction of a member takes anything
    for strict in range(2):  # first any direction of a member, then directions about the best of these
        most, tries, best_c, best_s = 0, len(TURNS) if strict else 2 * len(members), middle_c, middle_s
        best[:] = False
        for i in range(tries):
            if strict:
                turn_c, turn_s = TURNS[i]
                c, s = middle_c * turn_c - middle_s * turn_s, middle_s * turn_c + middle_c * turn_s
            else:
                c, s = np.float64(turned[members[i // 2], 0]), np.float64(turned[members[i // 2], 1])
                if i % 2:
                    c, s = -s, c
            number = _grow(box, turned, members, strays, reach, c, s, strict == 1, spans, away, ints, taken)
            if number > most:
                most, best_c, best_s = number, c, s
                for k in range(len(taken)):  # spelled out: whole-array assignments take the compiler seconds
                    best[k] = taken[k]
        middle_c, middle_s = best_c, best_s
    return best


@inner
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
    tall, first, number = np.empty(total, np.int64), np.empty(total), 0
    for g in range(total):
        tall[number], first[number] = g, -size[g]
        number += size[g] >= min_points and SMALL_TOP_M < top[g] <= LARGE_TOP_M
    for i in rising(first[:number]):
        g = tall[i]
        _adopt(box, turned, g, _near(box, g, loose, size, group, min_points), group)


@inner
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
