"""Smallest, largest and k-th smallest of many floats. Values must be numbers.

Whoever changes this file has to clear the compiled kernels of its users: their cache does not notice.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner
from services.infra_lidar.ordering import sort_rising
from services.infra_lidar.vectors import LANES, lane_max, lane_min, larger, load, smaller


@inner
def low_high(values):  # type: ignore[no-untyped-def]
    """(smallest, largest) of (n,) float32, n > 0."""
    n = len(values)
    if n < LANES:
        low = high = values[0]
        for i in range(1, n):
            low, high = min(low, values[i]), max(high, values[i])
        return low, high
    lowest = highest = load(values, n - LANES)  # once more what is left over at the end
    for i in range(0, n - LANES, LANES):
        x = load(values, i)
        lowest, highest = smaller(lowest, x), larger(highest, x)
    return lane_min(lowest), lane_max(highest)


@inner
def smallest_but(values, rank):  # type: ignore[no-untyped-def]
    """The value with exactly ``rank`` others before it in rising order, of (n,) float32.

    256 bins are counted, and only the bin that holds the rank is sorted.
    """
    low, high = low_high(values)
    n = len(values)
    scale = np.float32(255.0) / (high - low) if high > low else np.float32(0.0)
    bins, count = np.empty(n, np.uint8), np.zeros(256, np.int32)
    for i in range(n):
        bins[i] = np.uint8(min(np.int32((values[i] - low) * scale), np.int32(255)))
    for i in range(n):
        count[bins[i]] += 1
    wanted, before = 0, 0
    while before + count[wanted] <= rank:
        before += count[wanted]
        wanted += 1
    held, m = np.empty(count[wanted] + 1, np.float32), 0
    for i in range(n):
        if bins[i] == wanted:
            held[m] = values[i]
            m += 1
    held = held[:m]
    sort_rising(held)
    return held[rank - before]
