"""Compiled merging of fragments: what is left of a vehicle behind others falls into pieces that belong together.

Pieces are joined in the order of the gap between them, as long as the group still fits one vehicle: a small one, or a
large one if it is tall. A wider gap is bridged along the vehicle only. A piece that looks like a person is left alone.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner
from services.infra_lidar.kernels_footprints import (
    COS,
    HALF_LENGTH,
    HALF_WIDTH,
    ROWS,
    SIN,
    TOP,
    X,
    Y,
    extent,
    highest,
    side_by_side,
    width_of,
)
from services.infra_lidar.ordering import rising
from services.infra_lidar.vectors import (
    LANES,
    fma,
    lane_count,
    lanes,
    larger,
    load_of_row,
    magnitude,
    root,
    select,
    smaller,
    splat,
    store,
    store_chosen,
)

SMALL_LENGTH_M, SMALL_WIDTH_M, SMALL_TOP_M = 5.3, 2.2, 2.2
LARGE_LENGTH_M, LARGE_WIDTH_M, LARGE_TOP_M = 14.0, 3.3, 4.5
TOUCH_M = 0.35  # up to this gap pieces may meet at any angle (the corner of a vehicle)
SMALL_GAP_M, LARGE_GAP_M = 1.2, 3.0
SIDE_STEP_M = 0.5  # pieces across a wider gap lie in one line to within this
PERSON_WIDTH_M, PERSON_HEIGHT_M = 1.0, 1.0
UPPER_WIDTH_M, UPPER_HEIGHT_M = 0.8, 0.2  # of a person behind another: head and shoulders at least
CYCLE_LENGTH_M, TALL_TOP_M = 2.2, 1.55


@inner
def _fits(foot, pieces, n, a, b, gap):  # type: ignore[no-untyped-def]
    """Whether n pieces side by side, of which a and b are ``gap`` apart, can be one vehicle."""
    top = highest(pieces, n)
    large = LARGE_TOP_M >= top > SMALL_TOP_M
    if top > LARGE_TOP_M or gap > (LARGE_GAP_M if large else SMALL_GAP_M):
        return False
    c, s, length, width = _tightest(foot, pieces, n, a, b)
    if length > (LARGE_LENGTH_M if large else SMALL_LENGTH_M) or width > (LARGE_WIDTH_M if large else SMALL_WIDTH_M):
        return False
    return gap <= TOUCH_M or width <= max(width_of(foot, a, c, s), width_of(foot, b, c, s)) + SIDE_STEP_M


@inner
def _tightest(foot, pieces, n, a, b):  # type: ignore[no-untyped-def]
    """The direction (c, s) along which the pieces need the least area, its length and its width: that of a, that of b,
    or the one from a to b."""
    dx, dy, none = foot[X, b] - foot[X, a], foot[Y, b] - foot[Y, a], np.float32(0.0)
    apart = max(np.sqrt(dx * dx + dy * dy), np.float32(1e-6))
    best, length, width, best_c, best_s = np.float32(np.inf), none, none, np.float32(1.0), none
    for i in range(3):
        c, s = dx / apart, dy / apart
        if i < 2:
            k = a if i == 0 else b
            c, s = foot[COS, k], foot[SIN, k]
        u0, u1, v0, v1 = extent(pieces, n, c, s)
        if (u1 - u0) * (v1 - v0) < best:
            best, length, width, best_c, best_s = (u1 - u0) * (v1 - v0), u1 - u0, v1 - v0, c, s
    if width > length:
        return -best_s, best_c, width, length
    return best_c, best_s, length, width


@inline
def _diagonal(box, k):  # type: ignore[no-untyped-def]
    return np.sqrt(box[k, 3] * box[k, 3] + box[k, 4] * box[k, 4])


@inner
def _vulnerable(box, k):  # type: ignore[no-untyped-def]
    """A piece with the outline of a person, of the upper body of somebody behind somebody else, or as narrow as a
    cyclist and taller than most cars."""
    height, top, across = box[k, 5], box[k, 7] + box[k, 5], _diagonal(box, k)
    upright, tall = height >= PERSON_HEIGHT_M, top > TALL_TOP_M
    person = upright & (across < PERSON_WIDTH_M)
    upper_body = tall & (height >= UPPER_HEIGHT_M) & (across < UPPER_WIDTH_M)
    cyclist = upright & tall & (box[k, 3] < CYCLE_LENGTH_M) & (box[k, 4] < PERSON_WIDTH_M)
    return (top <= SMALL_TOP_M) & (person | upper_body | cyclist)


@inner
def merge_fragments(box, foot, counts, person, min_count, group):  # type: ignore[no-untyped-def]
    """Group number of each of K components, by union of fitting neighbours; components under ``min_count`` stay out,
    and so does who is a ``person``, (K,) bool.

    box (K, 8) as measured by ``kernels_clusters.measure`` and its ``footprints``; group (K,) int32 is written: smallest
    member's index.
    """
    following = np.empty(len(counts), np.int64)
    for k in range(len(counts)):
        group[k] = following[k] = k  # the members of a group stand in a ring
    usable, n = _usable(box, counts, person, min_count)
    if n == 0:
        return
    pieces, members = np.empty((ROWS, n + LANES), np.float32), np.empty(n + LANES, np.int32)
    side_by_side(foot, usable, n, pieces)
    first, second, gaps = _near_pairs(pieces, n)
    for p in rising(gaps):
        a, b = usable[first[p]], usable[second[p]]
        ga, gb = group[a], group[b]
        if ga == gb:
            continue
        number = _go_round(following, b, members, _go_round(following, a, members, 0))
        side_by_side(foot, members, number, pieces)
        if _fits(foot, pieces, number, a, b, gaps[p]):
            following[a], following[b] = following[b], following[a]
            for i in range(number):
                group[members[i]] = min(ga, gb)


@inline
def _go_round(following, first, members, number):  # type: ignore[no-untyped-def]
    """Note the ring of ``first`` behind the first ``number`` of members; returns how many there are."""
    members[number] = first
    k, number = following[first], number + 1
    while k != first:
        members[number] = k
        k, number = following[k], number + 1
    return number


@inner
def _usable(box, counts, person, min_count):  # type: ignore[no-untyped-def]
    """Pieces that may be part of a vehicle, by the left end of their footprint: a list, and how many."""
    chosen, left, n = np.empty(len(counts), np.int32), np.empty(len(counts), np.float32), np.int64(0)
    for k in range(len(counts)):
        top = box[k, 7] + box[k, 5]
        if person[k] or counts[k] < min_count:
            continue
        if box[k, 3] <= LARGE_LENGTH_M and top <= LARGE_TOP_M and not _vulnerable(box, k):
            chosen[n], left[n] = k, box[k, 0] - 0.5 * _diagonal(box, k)
            n += 1
    order, listed = rising(left[:n]), np.empty(n + LANES, np.int32)
    for i in range(n):
        listed[i] = chosen[order[i]]
    return listed, n


@inner
def _near_pairs(pieces, n):  # type: ignore[no-untyped-def]
    """Pairs of n pieces, side by side and by their left ends, that are no farther apart than the widest gap: the first
    ones, the second ones, int32, and the gaps."""
    room, found, left = 16 * n + 16, 0, np.empty(n + LANES, np.float32)
    first, second = np.empty(room + LANES, np.int32), np.empty(room + LANES, np.int32)
    gaps = np.empty(room + LANES, np.float32)
    for i in range(0, n, LANES):
        store(left, i, load_of_row(pieces, X, i) - _half_diagonal(pieces, i))
    for i in range(n):
        end = np.float32(2.0) * pieces[X, i] - left[i] + np.float32(LARGE_GAP_M)  # as far to the right
        j = i + 1
        while j < n and left[j] <= end and found <= room:
            tall = larger(load_of_row(pieces, TOP, j), pieces[TOP, i]) > np.float32(SMALL_TOP_M)
            widest = select(tall, splat(np.float32(LARGE_GAP_M)), splat(np.float32(SMALL_GAP_M)))
            gap = _gaps(pieces, i, j)
            near = (gap <= widest) & (lanes() < np.int32(n - j))
            store(first, found, splat(np.int32(i)))
            store_chosen(second, found, lanes() + np.int32(j), near)
            store_chosen(gaps, found, gap, near)
            found, j = found + lane_count(near), j + LANES
    found = min(found, room)
    return first[:found], second[:found], gaps[:found]


@inline
def _half_diagonal(pieces, i):  # type: ignore[no-untyped-def]
    half_l, half_w = load_of_row(pieces, HALF_LENGTH, i), load_of_row(pieces, HALF_WIDTH, i)
    return root(fma(half_l, half_l, half_w * half_w))


@inner
def _gaps(pieces, i, j):  # type: ignore[no-untyped-def]
    """Distances of piece i from those from j on: the smallest from a corner of one footprint to the other."""
    c, s = splat(pieces[COS, i]), splat(pieces[SIN, i])
    half_l, half_w = splat(pieces[HALF_LENGTH, i]), splat(pieces[HALF_WIDTH, i])
    dx, dy = load_of_row(pieces, X, j) - pieces[X, i], load_of_row(pieces, Y, j) - pieces[Y, i]
    own_c, own_s = load_of_row(pieces, COS, j), load_of_row(pieces, SIN, j)
    own_l, own_w = load_of_row(pieces, HALF_LENGTH, j), load_of_row(pieces, HALF_WIDTH, j)
    none = splat(np.float32(0.0))
    turn_c, turn_s = fma(own_c, c, own_s * s), own_s * c - own_c * s  # of theirs against that of i
    u, v = fma(dx, c, dy * s), dy * c - dx * s
    theirs = _nearest_corner(u, v, turn_c, turn_s, own_l, own_w, half_l, half_w)
    u, v = none - fma(dx, own_c, dy * own_s), dx * own_s - dy * own_c
    ours = _nearest_corner(u, v, turn_c, none - turn_s, half_l, half_w, own_l, own_w)
    return root(smaller(theirs, ours))


@inner
def _nearest_corner(u, v, c, s, half_l, half_w, box_l, box_w):  # type: ignore[no-untyped-def]
    """Squared distance from a box about the origin, of half sizes box_l and box_w, to the nearest corner of another, at
    (u, v) and turned by (c, s)."""
    nearest, none = splat(np.float32(np.inf)), splat(np.float32(0.0))
    lu, lv, wu, wv = half_l * c, half_l * s, none - half_w * s, half_w * c
    for _ in range(4):
        du = larger(magnitude(u + lu + wu) - box_l, none)
        dv = larger(magnitude(v + lv + wv) - box_w, none)
        nearest = smaller(nearest, fma(du, du, dv * dv))
        lu, lv, wu, wv = wu, wv, none - lu, none - lv  # round to the next corner
    return nearest
