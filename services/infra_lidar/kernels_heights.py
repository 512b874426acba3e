"""Heights of the points of a polar cell: counted in bins, fine ones near the calibrated road, and a low percentile."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner
from services.infra_lidar.vectors import fma, larger, smaller

FINE_M = 0.64  # up to so far from the calibrated road heights are counted in fine bins ...
FINE_PER_M, COARSE_PER_M = 200.0, 50.0  # ... of 5 mm, farther off in bins of 2 cm
CHUNK = 16  # bins, the number of which is a multiple of it


def bin_place(height_m: float) -> float:
    """Where a height lies on the scale of the bins; 0 is that of height 0."""
    near = min(max(height_m, -FINE_M), FINE_M)
    return near * FINE_PER_M + (height_m - near) * COARSE_PER_M


@inline
def _height_of(place):  # type: ignore[no-untyped-def]
    """The height at a place of that scale."""
    near = min(max(place, -FINE_M * FINE_PER_M), FINE_M * FINE_PER_M)
    return near / FINE_PER_M + (place - near) / COARSE_PER_M


@inline
def bin_places(height):  # type: ignore[no-untyped-def]
    """``bin_place`` of a vector of heights."""
    near = smaller(larger(height, np.float32(-FINE_M)), np.float32(FINE_M))
    return fma(near, np.float32(FINE_PER_M), (height - near) * np.float32(COARSE_PER_M))


@inner
def cell_heights(histogram, fours, s, number, height):  # type: ignore[no-untyped-def]
    """Low percentile of each cell's heights by selection, rank max(1, int(percentile n)); NaN where too few points.

    fours (cells, bins / 4) uint64 is the histogram, four bins at a time. number (cells,) int32 is the number of points:
    cells are counted from their bins, since neighbours in time often share a cell, and adding to one counter again and
    again waits for memory each time. What was counted is cleared.
    """
    bins = histogram.shape[1]
    for c in range(number.shape[0]):
        n = _sum(fours, c, 0, bins)
        number[c], height[c] = n, np.nan
        if n >= s.min_points:
            rank = max(1, int(s.percentile * n))
            b, seen = _bin_of(histogram, fours, c, rank)
            # inside a bin heights are as good as evenly spread
            height[c] = _height_of(s.first_place + b + (rank - seen + 0.5) / histogram[c, b])
        if n > 0:
            for k in range(bins // 4):
                fours[c, k] = np.uint64(0)


@inline
def _sum(fours, c, first, last):  # type: ignore[no-untyped-def]
    """Sum of the counts of bins ``first`` to ``last`` of a cell, four at a time: as long as no count overflows, neither
    does a fourth of them."""
    added, low = np.uint64(0), np.uint64(0xFFFF)
    for k in range(first // 4, last // 4):
        added += fours[c, k]
    parts = (added & low) + ((added >> np.uint64(16)) & low) + ((added >> np.uint64(32)) & low)
    return np.int64(parts + (added >> np.uint64(48)))


@inline
def _bin_of(histogram, fours, c, rank):  # type: ignore[no-untyped-def]
    """The bin of a cell that holds the rank, and the number before it."""
    seen, b, here = np.int64(0), 0, _sum(fours, c, 0, CHUNK)
    while seen + here <= rank:
        seen, b = seen + here, b + CHUNK
        here = _sum(fours, c, b, b + CHUNK)
    while seen + np.int64(histogram[c, b]) <= rank:
        seen, b = seen + np.int64(histogram[c, b]), b + 1
    return b, seen
