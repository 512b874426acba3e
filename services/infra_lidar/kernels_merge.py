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
    X,
    Y,
    extent,
    highest,
    side_by_side,
    width_of,
)
from services.infra_lidar.ordering import rising
from services.infra_lidar.vectors import LANES

SMALL_LENGTH_M, SMALL_WIDTH_M, SMALL_TOP_M = 5.3, 2.2, 2.2
LARGE_LENGTH_M, LARGE_WIDTH_M, LARGE_TOP_M = 14.0, 3.3, 4.5
TOUCH_M = 0.35  # up to this gap pieces may meet at any angle (the corner of a vehicle)
SMALL_GAP_M, LARGE_GAP_M = 1.2, 3.0
SIDE_STEP_M = 0.5  # pieces across a wider gap lie in one line to within this
PERSON_WIDTH_M, PERSON_HEIGHT_M = 1.0, 1.0
UPPER_WIDTH_M, UPPER_HEIGHT_M = 0.8, 0.2  # of a person behind another: head and shoulders at least
CYCLE_LENGTH_M, TALL_TOP_M = 2.2, 1.55


@inner
def _corners(foot):  # type: ignore[no-untyped-def]
    """(K, 4, 2): the corners of each footprint."""
    corners = np.empty((foot.shape[1], 4, 2))
    for k in range(foot.shape[1]):
        c, s = foot[COS, k], foot[SIN, k]
        for i in range(4):
            u = foot[HALF_LENGTH, k] * (1.0 if i & 1 else -1.0)
            v = foot[HALF_WIDTH, k] * (1.0 if i & 2 else -1.0)
            corners[k, i, 0], corners[k, i, 1] = foot[X, k] + c * u - s * v, foot[Y, k] + s * u + c * v
    return corners


@inner
def _gap(foot, corners, a, b):  # type: ignore[no-untyped-def]
    """Distance of footprints: the smallest from a corner of one to the other."""
    nearest = np.inf
    for swap in range(2):
        p, q = (a, b) if swap == 0 else (b, a)
        c, s = foot[COS, q], foot[SIN, q]
        for i in range(4):
            dx, dy = corners[p, i, 0] - foot[X, q], corners[p, i, 1] - foot[Y, q]
            u = max(abs(c * dx + s * dy) - foot[HALF_LENGTH, q], 0.0)
            v = max(abs(c * dy - s * dx) - foot[HALF_WIDTH, q], 0.0)
            nearest = min(nearest, u * u + v * v)
    return np.sqrt(nearest)


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
    usable = _usable(box, counts, person, min_count)
    following, members = np.empty(len(counts), np.int64), np.empty(len(usable) + LANES, np.int32)
    pieces = np.empty((ROWS, len(usable) + LANES), np.float32)
    for k in range(len(counts)):
        group[k] = following[k] = k  # the members of a group stand in a ring
    pairs, gaps = _near_pairs(box, foot, _corners(foot), usable)
    for p in rising(gaps):
        a, b = pairs[p, 0], pairs[p, 1]
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
    """Pieces that may be part of a vehicle, by the left end of their footprint."""
    chosen, left, n = np.empty(len(counts), np.int64), np.empty(len(counts)), 0
    for k in range(len(counts)):
        top = box[k, 7] + box[k, 5]
        if person[k] or counts[k] < min_count:
            continue
        if box[k, 3] <= LARGE_LENGTH_M and top <= LARGE_TOP_M and not _vulnerable(box, k):
            chosen[n], left[n] = k, box[k, 0] - 0.5 * _diagonal(box, k)
            n += 1
    order = rising(left[:n])
    for i in range(n):
        order[i] = chosen[order[i]]
    return order


@inner
def _near_pairs(box, foot, corners, usable):  # type: ignore[no-untyped-def]
    """Pairs of pieces no farther apart than the widest gap, with the gap; ``usable`` is sorted by left end."""
    pairs = np.empty((16 * len(usable) + 16, 2), np.int64)
    gaps, half = np.empty(len(pairs)), np.empty(len(box))
    for k in usable:
        half[k] = 0.5 * _diagonal(box, k)
    n = 0
    for i in range(len(usable)):
        a = usable[i]
        for j in range(i + 1, len(usable)):
            b = usable[j]
            if box[b, 0] - half[b] > box[a, 0] + half[a] + LARGE_GAP_M:
                break
            tall = max(box[a, 7] + box[a, 5], box[b, 7] + box[b, 5]) > SMALL_TOP_M
            widest = LARGE_GAP_M if tall else SMALL_GAP_M
            dx, dy, apart = box[b, 0] - box[a, 0], box[b, 1] - box[a, 1], half[a] + half[b] + widest
            if dx * dx + dy * dy > apart * apart or n == len(pairs):
                continue
            gap = _gap(foot, corners, a, b)
            if gap <= widest:
                pairs[n, 0], pairs[n, 1], gaps[n] = a, b, gap
                n += 1
    return pairs[:n], gaps[:n]
