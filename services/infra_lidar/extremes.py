"""Smallest, largest and k-th smallest of many floats. Values must be numbers."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner
from services.infra_lidar.ordering import sort_rising
from services.infra_lidar.vectors import (
    LANES,
    lane_count,
    lane_max,
    lane_min,
    larger,
    load,
    smaller,
    store,
    store_chosen,
    whole,
)


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
    n, scale = len(values), np.float32(255.0) / (high - low) if high > low else np.float32(0.0)
    bins, count = np.empty(n + LANES, np.uint8), np.zeros(256, np.int32)
    whole_vectors, quarter = n - n % LANES, n // 4
    for i in range(0, whole_vectors, LANES):
        store(bins, i, smaller(whole((load(values, i) - low) * scale), 255))
    for i in range(whole_vectors, n):
        bins[i] = np.uint8(min(np.int32((values[i] - low) * scale), np.int32(255)))
    for i in range(n):
        count[np.uint32(bins[in_turn(i, quarter)])] += 1
    wanted, before = 0, 0
    while before + count[wanted] <= rank:
        before += count[wanted]
        wanted += 1
    held, m = np.empty(count[wanted] + LANES, np.float32), 0
    for i in range(0, whole_vectors, LANES):
        here = load(bins, i) == np.int32(wanted)
        store_chosen(held, m, load(values, i), here)
        m += lane_count(here)
    for i in range(whole_vectors, n):
        held[m] = values[i]
        m += bins[i] == wanted
    held = held[: count[wanted]]
    sort_rising(held)
    return held[rank - before]


@inline
def in_turn(i, quarter):  # type: ignore[no-untyped-def]
    """The i-th of all when the four quarters take turns: neighbours would wait for each other's counter."""
    return np.uint32(i) if i >= 4 * quarter else np.uint32((i & 3) * quarter + (i >> 2))
