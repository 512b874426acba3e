"""The area of a cluster's convex hull seen from above.

Whoever changes this file has to clear the compiled kernels of its users: their cache does not notice.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.extremes import low_high
from services.infra_lidar.jit import inner
from services.infra_lidar.vectors import (
    LANES,
    fma,
    lane_count,
    lane_max,
    lane_min,
    lanes,
    larger,
    load,
    select,
    smaller,
    splat,
    store_chosen,
)

_WORTH_SIFTING = 16  # points
_FEW = 64  # points that are sorted as they are
_COLUMNS = 64
_NEAR = 1e-6  # of the squared size: twice the area of a triangle that rounding may turn round
_NOWHERE = np.int32(2**31 - 1)


@inner
def hull_area(u: np.ndarray, v: np.ndarray, n: int, u_low: float, length: float, width: float) -> float:
    """Area of the convex hull of n points about their mean, with zeros behind the last one. The points are sifted in
    place."""
    if n > _WORTH_SIFTING:
        n = _outside(u, v, n, length, width)
    if n > _FEW:
        n = _thin_out(u, v, n, u_low, length, width)
    _sort(u, v, n)
    return 0.5 * (_chain(u, v, n, 1.0) + _chain(u, v, n, -1.0))


@inner
def _outside(u: np.ndarray, v: np.ndarray, n: int, length: float, width: float) -> int:
    """Keep what is not inside of the octagon of the extreme points in eight directions, and say how many that are: what
    lies inside is no corner of the hull (Akl and Toussaint 1978), and that is most of a cluster."""
    ends = np.empty(8, np.int32)
    _extreme(u, v, n, np.float32(1.0 / length), np.float32(1.0 / width), ends)
    across, along, offset = np.zeros(8, np.float32), np.zeros(8, np.float32), np.ones(8, np.float32)
    for k in range(8):
        a, b = ends[k], ends[(k + 1) % 8]
        if a != b:  # else that corner is cut off by nothing: every point is on its inner side
            across[k], along[k] = v[a] - v[b], u[b] - u[a]
            offset[k] = -(across[k] * u[a] + along[k] * v[a])
    near, m = splat(np.float32(_NEAR * (length + width) ** 2)), 0
    for i in range(0, n, LANES):
        x, y = load(u, i), load(v, i)
        inside = splat(np.float32(np.inf))
        for k in range(8):
            inside = smaller(inside, fma(splat(across[k]), x, fma(splat(along[k]), y, splat(offset[k]))))
        kept = (inside <= near) & (lanes() < np.int32(n - i))
        store_chosen(u, m, x, kept)
        store_chosen(v, m, y, kept)
        m += lane_count(kept)
    return m


@inner
def _extreme(
    u: np.ndarray, v: np.ndarray, n: int, per_length: np.float32, per_width: np.float32, ends: np.ndarray
) -> None:
    """Places of the extreme points in eight directions, counter-clockwise from +u on."""
    none, here = splat(np.float32(-np.inf)), lanes()
    m0, m1, m2, m3, m4, m5, m6, m7 = none, none, none, none, none, none, none, none
    k0, k1, k2, k3, k4, k5, k6, k7 = here, here, here, here, here, here, here, here
    for i in range(0, n, LANES):
        x, y, at = load(u, i) * per_length, load(v, i) * per_width, here + np.int32(i)
        up, down, zero = x + y, y - x, splat(np.float32(0.0))
        m0, k0 = larger(m0, x), select(x > m0, at, k0)
        m1, k1 = larger(m1, up), select(up > m1, at, k1)
        m2, k2 = larger(m2, y), select(y > m2, at, k2)
        m3, k3 = larger(m3, down), select(down > m3, at, k3)
        x, up, y, down = zero - x, zero - up, zero - y, zero - down
        m4, k4 = larger(m4, x), select(x > m4, at, k4)
        m5, k5 = larger(m5, up), select(up > m5, at, k5)
        m6, k6 = larger(m6, y), select(y > m6, at, k6)
        m7, k7 = larger(m7, down), select(down > m7, at, k7)
    ends[0], ends[1], ends[2], ends[3] = _best(m0, k0), _best(m1, k1), _best(m2, k2), _best(m3, k3)
    ends[4], ends[5], ends[6], ends[7] = _best(m4, k4), _best(m5, k5), _best(m6, k6), _best(m7, k7)


@inner
def _best(values, places):  # type: ignore[no-untyped-def]
    """The first place where the largest value stands."""
    return lane_min(select(values == splat(lane_max(values)), places, _NOWHERE))


@inner
def _thin_out(u: np.ndarray, v: np.ndarray, n: int, u_low: float, length: float, width: float) -> int:
    """Keep, in place, the ends of 64 columns across the length and of 64 across the width, and say how many these are.

    A hull needs only the extreme points of every column (Bentley, Faust, Preparata 1982). These keep their own places,
    so its area is exact up to points that both ways are hidden behind others (measured: below 0.1 %). One way would not
    do: at an end that stands a little askew a column has three corners.
    """
    kept, m = np.zeros(n, np.bool_), 0
    v_low, _ = low_high(v[:n])
    _mark_ends(u, v, n, np.float32(u_low), length, kept)
    _mark_ends(v, u, n, v_low, width, kept)
    for i in range(n):
        if kept[i]:
            u[m], v[m] = u[i], v[i]
            m += 1
    return m


@inner
def _mark_ends(
    along: np.ndarray, across: np.ndarray, n: int, begin: np.float32, length: float, kept: np.ndarray
) -> None:
    """Mark the lowest and the highest point of each column."""
    low, high = np.full(_COLUMNS, -1, np.int32), np.full(_COLUMNS, -1, np.int32)
    scale = np.float32((_COLUMNS - 1) / length) if length > 1e-6 else np.float32(0.0)
    for i in range(n):
        c = int((along[i] - begin) * scale)
        if low[c] < 0:
            low[c] = high[c] = i
        elif across[i] < across[low[c]]:
            low[c] = i
        elif across[i] > across[high[c]]:
            high[c] = i
    for c in range(_COLUMNS):
        if low[c] >= 0:
            kept[low[c]] = kept[high[c]] = True


@inner
def _sort(u: np.ndarray, v: np.ndarray, n: int) -> None:
    """By u, and by v where that is the same, in place (Shell 1959, with steps of Knuth's: 1, 4, 13, 40 ...)."""
    step = 1
    while 3 * step < n:
        step = 3 * step + 1
    while step > 0:
        for i in range(step, n):
            x, y, j = u[i], v[i], i
            while j >= step and (u[j - step] > x or (u[j - step] == x and v[j - step] > y)):
                u[j], v[j], j = u[j - step], v[j - step], j - step
            u[j], v[j] = x, y
        step //= 3


@inner
def _chain(u: np.ndarray, v: np.ndarray, n: int, sign: float) -> float:
    """Twice the area under a monotone hull chain of sorted points (Andrew 1979); sign +1 lower, -1 upper."""
    stack, top = np.empty(n, np.int32), 0
    for c in range(n):
        while top >= 2:
            a, b = stack[top - 2], stack[top - 1]
            if ((u[b] - u[a]) * (v[c] - v[a]) - (v[b] - v[a]) * (u[c] - u[a])) * sign > 0.0:
                break
            top -= 1
        stack[top] = c
        top += 1
    total = 0.0
    for i in range(top - 1):
        a, b = stack[i], stack[i + 1]
        total += u[a] * v[b] - u[b] * v[a]
    return total * sign
