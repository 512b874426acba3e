"""Sorting and sifting a few hundred numbers, for kernels.

numpy's ``sort``, ``argsort`` and ``flatnonzero`` would do, but take the compiler seconds for each type and each kernel
that calls them: these take it a tenth of one. Whoever changes this file has to clear the compiled kernels of its users:
their cache does not notice.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner, kernel


@kernel
def rising(keys):  # type: ignore[no-untyped-def]
    """(n,) int64: indices of the keys (n,) float64 in rising order, equal ones as they come (merge sort, bottom up)."""
    return rising_in(keys, np.empty(len(keys), np.int64), np.empty(len(keys), np.int64))


@inner
def rising_in(keys, order, other):  # type: ignore[no-untyped-def]
    """The same with memory that is there, order and other (n or more,) int64: what is sorted again and again is mostly
    short. The answer is the head of one of them."""
    n, width = len(keys), 1
    for i in range(n):
        order[i] = i
    while width < n:
        for start in range(0, n, 2 * width):
            middle, stop = min(start + width, n), min(start + 2 * width, n)
            a, b = start, middle
            for at in range(start, stop):
                if b >= stop or (a < middle and keys[order[a]] <= keys[order[b]]):
                    other[at] = order[a]
                    a += 1
                else:
                    other[at] = order[b]
                    b += 1
        order, other = other, order
        width *= 2
    return order[:n]


@kernel
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
