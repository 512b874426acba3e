"""What is higher than a body: part of something tall below it, or something of its own, a roof or a canopy.

Whoever changes this file has to clear the compiled kernels of its users: their cache does not notice.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.extremes import in_turn
from services.infra_lidar.jit import inner
from services.infra_lidar.vectors import LANES, gather, lane_count, lanes, load, select, splat, store, store_chosen

BAND_M = np.float32(0.4)  # something that has points in the top of the body band goes on above it
SHARE = 0.03
FEWEST = 3


@inner
def tall_ones(label, above, body_m, components):  # type: ignore[no-untyped-def]
    """(components + 1,) int32: 1 for labels, counted from -1, that reach the top of the body band.

    label (M,) int32, above (M,) float32: height of the points over the road.
    """
    in_band, total = np.zeros(components + 1, np.int32), np.zeros(components + 1, np.int32)
    band_m, quarter = body_m - BAND_M, len(label) // 4
    for i in range(len(label)):
        j = in_turn(i, quarter)
        k = np.uint32(label[j] + np.int32(1))
        total[k] += np.int32(above[j] < body_m)
        in_band[k] += np.int32((above[j] < body_m) & (above[j] >= band_m))
    for k in range(1, components + 1):
        in_band[k] = (in_band[k] >= FEWEST) & (in_band[k] >= SHARE * total[k])
    in_band[0] = 0
    return in_band


@inner
def lift(points, label, body_m, tall, high, free):  # type: ignore[no-untyped-def]
    """Points (4, M) that are high and belong to nothing tall, one after the other to high (4, M): their number, and in
    free (M,) int32 their index. Their label (M,) becomes -1. high and free have room for a vector more."""
    above, number, n = points[3], 0, len(label)
    whole = n - n % LANES
    for i in range(0, whole, LANES):
        k = load(label, i)
        loose = (load(above, i) >= body_m) & (gather(tall, k + np.int32(1)) == np.int32(0))
        found = lane_count(loose)
        if found > 0:
            store(label, i, select(loose, np.int32(-1), k))
            for row in range(4):
                store_chosen(high[row], number, load(points[row], i), loose)
            store_chosen(free, number, lanes() + np.int32(i), loose)
            number += found
    for i in range(whole, n):
        if above[i] >= body_m and tall[label[i] + 1] == 0:
            label[i], free[number] = -1, i
            for row in range(4):
                high[row, number] = points[row, i]
            number += 1
    return number


@inner
def spread(begin, label, out):  # type: ignore[no-untyped-def]
    """out (N,) int32, with room for a vector more: the label of each point, from those of runs."""
    for r in range(len(label)):
        k = splat(label[r])
        for i in range(begin[r], begin[r + 1], LANES):  # the next run writes over what is too much
            store(out, i, k)


@inner
def put_down(found, by, free, label):  # type: ignore[no-untyped-def]
    """label (M,) of the points ``free`` (F,): what was ``found`` (F,) for them, raised by ``by``, or -1."""
    for i in range(len(free)):
        label[np.uint32(free[i])] = found[i] + by if found[i] >= 0 else np.int32(-1)
