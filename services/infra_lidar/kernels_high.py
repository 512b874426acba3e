"""What is higher than a body: part of something tall below it, or something of its own, a roof or a canopy."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner
from services.infra_lidar.kernels_runs import find_runs
from services.infra_lidar.vectors import LANES, gather_listed, lane_count, lanes, load, splat, store, store_chosen

BAND_M = np.float32(0.4)  # something that has points in the top of the body band goes on above it
SHARE = 0.03
FEWEST = 3


@inner
def find_high(above, label, body_m, high, high_label, top_label):  # type: ignore[no-untyped-def]
    """Index of the points that are high to high (M,) int32, their label to high_label (M,) int32, and that of points in
    the top of the body band to top_label (M,) int32, all with room for a vector more. label (M,) int32, above (M,)
    float32: height over the road. Returns how many there are of each."""
    n, highs, tops = len(label), 0, 0
    for i in range(0, n, LANES):
        height, k = load(above, i), load(label, i)
        upper = (height >= body_m - BAND_M) & (lanes() < np.int32(n - i))
        if lane_count(upper) == 0:
            continue
        is_high, is_top = upper & (height >= body_m), upper & (height < body_m)
        store_chosen(high, highs, lanes() + np.int32(i), is_high)
        store_chosen(high_label, highs, k, is_high)
        store_chosen(top_label, tops, k, is_top)
        highs, tops = highs + lane_count(is_high), tops + lane_count(is_top)
    store(high, highs, splat(np.int32(0)))  # whole vectors of them are read
    store(high_label, highs, splat(np.int32(-1)))
    return highs, tops


@inner
def tall_ones(number, high_label, top_label, spans):  # type: ignore[no-untyped-def]
    """(components + 1,) int32: 1 for labels, counted from -1, that reach the top of the body band.

    number (components + 1,) int32: how many points have each label, from which the high ones are taken; high_label
    (H,) and top_label (T,) int32: labels of the points that are high, or in the top of the band. spans int32 is
    scratch, with room for more than the longer of both by a vector.
    """
    in_top = np.zeros(len(number), np.int32)
    for r in range(find_runs(top_label, spans)):
        in_top[np.uint32(top_label[spans[r]] + np.int32(1))] += spans[r + 1] - spans[r]
    for r in range(find_runs(high_label, spans)):
        number[np.uint32(high_label[spans[r]] + np.int32(1))] -= spans[r + 1] - spans[r]
    for k in range(1, len(number)):
        in_top[k] = (in_top[k] >= FEWEST) & (in_top[k] >= SHARE * number[k])
    in_top[0] = 0
    return in_top


@inner
def lift(points, label, tall, high, high_label, lifted):  # type: ignore[no-untyped-def]
    """Of the points (4, M or more) that are high those that belong to nothing tall, one after the other to lifted (4, H
    or more); high (H,) int32 keeps their index, and their label (M,) becomes -1. Returns how many there are."""
    n, loose = len(high), 0
    for i in range(0, n, LANES):
        free = (gather_listed(tall[1:], high_label, i) == np.int32(0)) & (lanes() < np.int32(n - i))
        store_chosen(high, loose, load(high, i), free)
        loose += lane_count(free)
    for i in range(loose):
        label[np.uint32(high[i])] = -1
    for i in range(0, loose, LANES):
        for row in range(4):
            store(lifted[row], i, gather_listed(points[row], high, i))
    return loose


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
