"""Smallest, largest and k-th smallest of many floats, vectorised.

The compiler keeps the order of float comparisons (of zeros and of what is no number), so such a loop takes one value at
a time. Read as integers, with the lower bits of negative ones turned over, floats have the same order, and a loop over
integers takes sixteen values at a time. Values must be numbers.

Whoever changes this file has to clear the compiled kernels of its users: their cache does not notice.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, kernel
from services.infra_lidar.ordering import sort_rising

LARGEST, SMALLEST = np.int32(2**31 - 1), np.int32(-(2**31) + 1)


@inline
def ordered(value):  # type: ignore[no-untyped-def]
    """A float32 as an int32 of the same order."""
    bits = np.int32(np.float32(value).view(np.int32))
    return np.int32(bits ^ np.int32(np.int32(bits >> np.int32(31)) & np.int32(0x7FFFFFFF)))


@inline
def unordered(integer):  # type: ignore[no-untyped-def]
    """Back to the float32."""
    mask = np.int32(np.int32(integer >> np.int32(31)) & np.int32(0x7FFFFFFF))
    return np.int32(integer ^ mask).view(np.float32)


@kernel
def low_high(values):  # type: ignore[no-untyped-def]
    """(smallest, largest) of (n,) float32; (nan, nan) of none."""
    low, high = LARGEST, SMALLEST
    for i in range(len(values)):
        low = np.int32(min(low, ordered(values[i])))
    for i in range(len(values)):
        high = np.int32(max(high, ordered(values[i])))
    return unordered(low), unordered(high)


@kernel
def chosen_extent(values, group, which):  # type: ignore[no-untyped-def]
    """(how many, largest - smallest) of the values (n,) float32 whose group (n,) uint8 is ``which``."""
    number, wanted, most, least = np.int32(0), np.uint8(which), np.int32(2**31 - 1), np.int32(-(2**31) + 1)
    low, high = most, least
    for i in range(len(values)):
        number += np.int32(group[i] == wanted)
    for i in range(len(values)):
        low = np.int32(min(low, ordered(values[i]) if group[i] == wanted else most))
    for i in range(len(values)):
        high = np.int32(max(high, ordered(values[i]) if group[i] == wanted else least))
    return number, (unordered(high) - unordered(low)) if number > 0 else np.float32(0.0)


@kernel
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
