"""Sorting and sifting a few hundred numbers, for kernels.

numpy's ``sort``, ``argsort`` and ``flatnonzero`` would do, but take the compiler seconds for each type and each kernel
that calls them: these take it a tenth of one.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner
from services.infra_lidar.vectors import LANES, lane_sum, lanes, load, ones, splat

COUNTED = 512


@inner
def rising(keys):  # type: ignore[no-untyped-def]
    """(n,) int64: indices of the keys (n,) in rising order, equal ones as they come; keys are compared as float32, what
    is no number as infinity."""
    n = len(keys)
    padded, order = np.empty(n + LANES, np.float32), np.empty(n, np.int64)
    for i in range(n):
        padded[i] = keys[i] if keys[i] == keys[i] else np.inf
    rising_in(padded, n, order)
    return order


@inner
def rising_in(keys, n, order):  # type: ignore[no-untyped-def]
    """The same of the first n keys, float32, to order (n or more,) int64. The vector behind the keys is overwritten.

    The place of a key is the number of those before it, which vectors count faster than branches that nobody can
    foretell sort, as long as they are few.
    """
    if n > COUNTED:
        _merge(keys, n, order)
        return
    for i in range(n, n + LANES):
        keys[i] = np.inf
    for i in range(n):
        key, before = splat(keys[i]), splat(np.int32(0))
        for j in range(0, n, LANES):
            other = load(keys, j)
            before += ones((other < key) | ((other == key) & (lanes() < np.int32(i - j))))
        order[lane_sum(before)] = i


@inner
def _merge(keys, n, order):  # type: ignore[no-untyped-def]
    """The same for many (merge sort, bottom up)."""
    now, then, width = np.arange(n), np.empty(n, np.int64), 1
    while width < n:
        for start in range(0, n, 2 * width):
            middle, stop = min(start + width, n), min(start + 2 * width, n)
            a, b = start, middle
            for at in range(start, stop):
                if b >= stop or (a < middle and keys[now[a]] <= keys[now[b]]):
                    then[at] = now[a]
                    a += 1
                else:
                    then[at] = now[b]
                    b += 1
        now, then = then, now
        width *= 2
    for i in range(n):
        order[i] = now[i]


@inner
def sort_rising(values):  # type: ignore[no-untyped-def]
    """Sort (n,) values in place (Shell 1959, with steps of Knuth's: 1, 4, 13, 40 ...)."""
    n, step = len(values), 1
    while 3 * step < n:
        step = 3 * step + 1
    while step > 0:
        for i in range(step, n):
            moved, j = values[i], i
            while j >= step and values[j - step] > moved:
                values[j] = values[j - step]
                j -= step
            values[j] = moved
        step //= 3


@inner
def places_of(flags):  # type: ignore[no-untyped-def]
    """(m,) int64: indices of the flags or numbers (n,) that are not 0."""
    places, m = np.empty(len(flags), np.int64), 0
    for i in range(len(flags)):
        if flags[i]:
            places[m] = i
            m += 1
    return places[:m]
