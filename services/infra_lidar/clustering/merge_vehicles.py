"""Fragments of vehicles merged: behind other objects a vehicle falls into clusters that belong together.

Clusters are joined in the order of the gap between them, as long as the whole still fits one vehicle: a small one, or
a large one if it is tall. A wide gap is bridged along the vehicle only. What hangs well above a
fragment is not joined with it, and what looks like a person is left alone.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.jit import kernel

X, Y, COS, SIN, HALF_LENGTH, HALF_WIDTH, BOTTOM, TOP, COLUMNS = range(9)  # of a footprint
SMALL_LENGTH_M, SMALL_WIDTH_M, SMALL_TOP_M = 5.3, 2.2, 2.2
LARGE_LENGTH_M, LARGE_WIDTH_M, LARGE_TOP_M = 14.0, 3.3, 4.5
WHOLE_CAR_LENGTH_M, WHOLE_CAR_WIDTH_M, WHOLE_CAR_TOP_M = (3.3, 5.5), (1.4, 2.5), 1.9  # such a cluster lacks nothing
TOUCH_M = 0.35  # up to this gap fragments may meet at any angle (the corner of a vehicle)
SMALL_GAP_M, LARGE_GAP_M = 1.2, 3.0
HANGING_GAP_M = 0.4  # what begins this far above a fragment hangs over it: a sign, a branch
SIDE_STEP_M = 0.5  # fragments across a wider gap lie in one line to within this
PERSON_WIDTH_M, PERSON_HEIGHT_M = 1.0, 1.0
UPPER_WIDTH_M, UPPER_HEIGHT_M = 0.8, 0.2  # of a person behind another: head and shoulders at least
CYCLE_LENGTH_M, TALL_TOP_M = 2.2, 1.55
MIN_FRAGMENT_POINTS = 3  # fewer have no shape to judge by
PAIRS_PER_FRAGMENT = 16  # room for that many neighbours on average


@kernel
def footprints(box: np.ndarray) -> np.ndarray:
    """(K, COLUMNS) float32 of boxes (K, 8): centre x, y (m), cosine and sine of the yaw, half the length and the width
    (m), height of the bottom and of the top above the road (m)."""
    foot = np.empty((len(box), COLUMNS), np.float32)
    for k in range(len(box)):
        foot[k, X], foot[k, Y], foot[k, COS], foot[k, SIN] = box[k, 0], box[k, 1], 1.0, 0.0
        foot[k, HALF_LENGTH], foot[k, HALF_WIDTH] = np.float32(0.5) * box[k, 3], np.float32(0.5) * box[k, 4]
        foot[k, BOTTOM], foot[k, TOP] = box[k, 7], box[k, 7] + box[k, 5]
        if box[k, 6] != 0.0:  # most clusters are a single return
            foot[k, COS], foot[k, SIN] = np.cos(box[k, 6]), np.sin(box[k, 6])
    return foot


@kernel
def extent_along(foot: np.ndarray, c: float | np.float32, s: float | np.float32) -> tuple[float, float, float, float]:
    """Lowest and highest place (m) of one footprint along the direction (c, s), and across it."""
    dot, cross = abs(foot[COS] * c + foot[SIN] * s), abs(foot[COS] * s - foot[SIN] * c)
    u, v = foot[X] * c + foot[Y] * s, foot[Y] * c - foot[X] * s
    half_u = foot[HALF_LENGTH] * dot + foot[HALF_WIDTH] * cross
    half_v = foot[HALF_LENGTH] * cross + foot[HALF_WIDTH] * dot
    return u - half_u, u + half_u, v - half_v, v + half_v


@kernel
def extent_of_all(
    foot: np.ndarray, members: np.ndarray, c: float | np.float32, s: float | np.float32
) -> tuple[float, float, float, float]:
    """The same of the footprints ``members`` together."""
    u0, u1, v0, v1 = extent_along(foot[members[0]], c, s)
    for k in members[1:]:
        a, b, d, e = extent_along(foot[k], c, s)
        u0, u1, v0, v1 = min(u0, a), max(u1, b), min(v0, d), max(v1, e)
    return u0, u1, v0, v1


@kernel
def gap_between(a: np.ndarray, b: np.ndarray) -> np.float32:
    """Distance (m) of two footprints: the smallest from a corner of one to the other."""
    return np.sqrt(min(_nearest_corner(a, b), _nearest_corner(b, a)))


@kernel
def _nearest_corner(box: np.ndarray, other: np.ndarray) -> np.float32:
    """Squared distance (m2) from a footprint to the nearest corner of another."""
    dx, dy = other[X] - box[X], other[Y] - box[Y]
    u, v = dx * box[COS] + dy * box[SIN], dy * box[COS] - dx * box[SIN]
    c, s = other[COS] * box[COS] + other[SIN] * box[SIN], other[SIN] * box[COS] - other[COS] * box[SIN]
    nearest, none = np.float32(np.inf), np.float32(0.0)
    lu, lv = other[HALF_LENGTH] * c, other[HALF_LENGTH] * s
    wu, wv = -other[HALF_WIDTH] * s, other[HALF_WIDTH] * c
    for _ in range(4):
        du = max(abs(u + lu + wu) - box[HALF_LENGTH], none)
        dv = max(abs(v + lv + wv) - box[HALF_WIDTH], none)
        nearest = min(nearest, du * du + dv * dv)
        lu, lv, wu, wv = wu, wv, -lu, -lv  # the next corner
    return nearest


@kernel
def merge_fragments(box: np.ndarray, foot: np.ndarray, counts: np.ndarray, is_person: np.ndarray) -> np.ndarray:
    """(K,) int32: for each cluster the smallest index among the clusters that it is joined with.

    box: (K, 8) float32 as in ``ClusterPoints``, foot: their ``footprints``, counts: (K,) points, is_person: (K,) bool,
    left alone.
    """
    group = np.arange(len(box)).astype(np.int32)
    following = group.copy()  # the members of a group form a ring
    first, second, gaps = _near_pairs(foot, _fragments(box, counts, is_person))
    members = np.empty(len(box), np.int32)
    for p in np.argsort(gaps, kind="mergesort"):
        a, b = first[p], second[p]
        if group[a] == group[b]:
            continue
        number = _append_ring(following, b, members, _append_ring(following, a, members, 0))
        if _fits_one_vehicle(foot, members[:number], a, b, gaps[p]):
            following[a], following[b] = following[b], following[a]
            group[members[:number]] = min(group[a], group[b])
    return group


@kernel
def _append_ring(following: np.ndarray, first: int, members: np.ndarray, number: int) -> int:
    """Write the ring of ``first`` behind the first ``number`` of members; returns how many there are then."""
    k = first
    while True:
        members[number] = k
        k, number = following[k], number + 1
        if k == first:
            return number


@kernel
def _fragments(box: np.ndarray, counts: np.ndarray, is_person: np.ndarray) -> np.ndarray:
    """Indices of clusters that may be part of a vehicle, by the left end of their footprint."""
    chosen, left, n = np.empty(len(box), np.int32), np.empty(len(box), np.float32), 0
    for k in range(len(box)):
        if is_person[k] or counts[k] < MIN_FRAGMENT_POINTS or box[k, 3] > LARGE_LENGTH_M:
            continue
        if box[k, 7] + box[k, 5] <= LARGE_TOP_M and not _is_vulnerable(box[k]):
            chosen[n], left[n] = k, box[k, 0] - 0.5 * math.hypot(box[k, 3], box[k, 4])
            n += 1
    return chosen[np.argsort(left[:n], kind="mergesort")]


@kernel
def _is_vulnerable(box: np.ndarray) -> bool:
    """Whether a box (8,) has the outline of a person, of the upper body of a person behind another, or is as narrow as
    a cyclist and taller than most cars."""
    height, top, diagonal = box[5], box[7] + box[5], math.hypot(box[3], box[4])
    upright, tall = height >= PERSON_HEIGHT_M, top > TALL_TOP_M
    person = upright and diagonal < PERSON_WIDTH_M
    upper_body = tall and height >= UPPER_HEIGHT_M and diagonal < UPPER_WIDTH_M
    cyclist = upright and tall and box[3] < CYCLE_LENGTH_M and box[4] < PERSON_WIDTH_M
    return top <= SMALL_TOP_M and (person or upper_body or cyclist)


@kernel
def _near_pairs(foot: np.ndarray, fragments: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of fragments that are no farther apart than the widest gap: first and second (P,) int32, gap (P,) float32.

    fragments: indices into foot, by the left end of the footprint.
    """
    room, found = PAIRS_PER_FRAGMENT * (len(fragments) + 1), 0
    first, second, gaps = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.float32)
    half = np.hypot(foot[:, HALF_LENGTH], foot[:, HALF_WIDTH])
    for i in range(len(fragments)):
        a = fragments[i]
        for b in fragments[i + 1 :]:
            if foot[b, X] - half[b] > foot[a, X] + half[a] + LARGE_GAP_M or found == room:
                break
            widest = LARGE_GAP_M if max(foot[a, TOP], foot[b, TOP]) > SMALL_TOP_M else SMALL_GAP_M
            if abs(foot[b, Y] - foot[a, Y]) > half[a] + half[b] + widest:
                continue
            gap = gap_between(foot[a], foot[b])
            if gap <= widest:
                first[found], second[found], gaps[found] = a, b, gap
                found += 1
    return first[:found], second[:found], gaps[:found]


@kernel
def _fits_one_vehicle(foot: np.ndarray, members: np.ndarray, a: int, b: int, gap: float) -> bool:
    """Whether ``members``, of which a and b are ``gap`` apart, can be one vehicle."""
    top = foot[members, TOP].max()
    large = LARGE_TOP_M >= top > SMALL_TOP_M
    if top > LARGE_TOP_M or gap > (LARGE_GAP_M if large else SMALL_GAP_M):
        return False
    if max(foot[a, BOTTOM], foot[b, BOTTOM]) - min(foot[a, TOP], foot[b, TOP]) > HANGING_GAP_M:
        return False
    if large and _has_whole_car(foot, members):
        return False
    c, s, length, width = _tightest(foot, members, a, b)
    if length > (LARGE_LENGTH_M if large else SMALL_LENGTH_M) or width > (LARGE_WIDTH_M if large else SMALL_WIDTH_M):
        return False
    if gap <= TOUCH_M:
        return True
    _, _, a0, a1 = extent_along(foot[a], c, s)
    _, _, b0, b1 = extent_along(foot[b], c, s)
    return width <= max(a1 - a0, b1 - b0) + SIDE_STEP_M


@kernel
def _has_whole_car(foot: np.ndarray, members: np.ndarray) -> bool:
    """Whether one of the members is a car by itself: what is higher beside it is a post or a tree."""
    for k in members:
        long, wide = 2.0 * foot[k, HALF_LENGTH], 2.0 * foot[k, HALF_WIDTH]
        as_long = WHOLE_CAR_LENGTH_M[0] <= long <= WHOLE_CAR_LENGTH_M[1]
        as_wide = WHOLE_CAR_WIDTH_M[0] <= wide <= WHOLE_CAR_WIDTH_M[1]
        if as_long and as_wide and foot[k, TOP] <= WHOLE_CAR_TOP_M:
            return True
    return False


@kernel
def _tightest(foot: np.ndarray, members: np.ndarray, a: int, b: int) -> tuple[float, float, float, float]:
    """The direction (c, s) in which the members need the least area, and their length and width along it (m).

    Tried are the direction of a, that of b, and the one from a to b.
    """
    dx, dy = foot[b, X] - foot[a, X], foot[b, Y] - foot[a, Y]
    apart = max(np.sqrt(dx * dx + dy * dy), np.float32(1e-6))
    tried = ((foot[a, COS], foot[a, SIN]), (foot[b, COS], foot[b, SIN]), (dx / apart, dy / apart))
    best, length, width, best_c, best_s = np.inf, 0.0, 0.0, 1.0, 0.0
    for c, s in tried:
        u0, u1, v0, v1 = extent_of_all(foot, members, c, s)
        if (u1 - u0) * (v1 - v0) < best:
            best, length, width, best_c, best_s = (u1 - u0) * (v1 - v0), u1 - u0, v1 - v0, c, s
    if width > length:
        return -best_s, best_c, width, length
    return best_c, best_s, length, width
