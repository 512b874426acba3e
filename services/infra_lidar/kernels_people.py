"""Compiled parting of people who stand so close together that they are one cluster: by their heads.

The highest point is a head, and so is the next highest that is not too near, if the cluster dips on the way to every
head before it: between two people there are shoulders. Each point goes to the nearest head, and the cluster is parted
only if all parts are of a person's size. After Munaro, Basso and Menegatti, "Tracking people within groups with RGB-D
data" (IROS 2012), who look for heads in a map of heights.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.jit import inner
from services.infra_lidar.kernels_clusters import measure
from services.infra_lidar.vectors import (
    LANES,
    fma,
    lane_count,
    lane_max,
    lane_sum,
    lanes,
    larger,
    load,
    magnitude,
    ones,
    select,
    smaller,
    splat,
    store,
    store_chosen,
)

NARROWEST_M, WIDEST_M = 0.6, 2.5  # a group of people: it is longer than the one, its diagonal shorter than the other
SHOWN_M = 0.8  # of their height at least: less may be the roof of a car
LOWEST_M, HIGHEST_M = 1.1, 2.2  # heads, above the road
APART_M, DIP_M = 0.4, 0.25  # of two heads: about how far at least, and by how much it dips between them
HEAD_M = 0.2  # across and high
BESIDE_M = 0.25  # this near the line from head to head a point lies on the way
SHOULDER_M = 0.2  # about what is no head nobody looks for one
PERSON_M = 1.0  # the diagonal of one, with a bag
MOST_HEADS, MOST_TRIES = 6, 7
STEPS_A_CELL, MOST_STEPS, STRETCH_CELLS = 4, 64, 0.5  # a dip is that long: two columns of returns have gone by


@inner
def part_people(points, shape, source, offsets, box, s, scratch):  # type: ignore[no-untyped-def]
    """Part clusters that are groups of people, in place: the points of each part lie together then.

    points (4, S) by shape (K + 1,), source (T,) by offsets (K + 1,) and box (K, 8): clusters as
    ``kernels_clusters.regroup`` leaves them; those not all of whose points are copied are left alone. s: settings, as
    in ``kernels_steps``. scratch (4, S or more) float32.
    Returns shape, offsets and box with an entry for each part, and (K,) bool, whether it is one of several.
    """
    clusters, more = len(box), 0
    parts, sizes = np.ones(clusters, np.int32), np.empty((clusters, MOST_HEADS), np.int32)
    heads = np.empty((MOST_HEADS, 2), np.float32)
    for k in range(clusters):
        first, last, at = shape[k], shape[k + 1], offsets[k]
        enough, all_here = last - first >= 2 * s.min_points, last - first == offsets[k + 1] - at
        if not enough or not all_here or not _may_be_people(box[k]):
            continue
        x, y, above = points[0, first:last], points[1, first:last], points[3, first:last]
        number = _find_heads(x, y, above, _cell_m(box[k], s), scratch, heads)
        if number > 1 and _sort(points, first, source[at : at + last - first], heads[:number], s, scratch, sizes[k]):
            parts[k], more = number, more + number - 1
    if more == 0:
        return shape, offsets, box, parts > 1
    return _with_parts(points, shape, offsets, box, parts, sizes, clusters + more)


@inner
def _may_be_people(box):  # type: ignore[no-untyped-def]
    """Whether a group of people can look like that."""
    top_m = box[7] + box[5]
    large = (box[5] >= SHOWN_M) & (box[3] >= NARROWEST_M) & (math.hypot(box[3], box[4]) <= WIDEST_M)
    return large & (top_m >= LOWEST_M) & (top_m <= HIGHEST_M)


@inner
def _cell_m(box, s):  # type: ignore[no-untyped-def]
    """How large a cell is where the box is: what is one cluster has no wider gap."""
    return (1.0 + math.hypot(box[0], box[1]) * s.growth_per_m) / s.per_m


@inner
def _find_heads(x, y, above, cell_m, scratch, heads):  # type: ignore[no-untyped-def]
    """heads (MOST_HEADS, 2): x and y of the heads of points (n,), the highest first; returns how many there are.
    scratch (3 or more, n and a vector or more) float32."""
    n, number, open_ = len(x), 0, scratch[0]
    for i in range(0, n, LANES):
        store(open_, i, load(above, i))
    store(open_, n, splat(np.float32(0.0)))
    for _ in range(MOST_TRIES):
        top = _highest(open_, n)
        if top < 0 or number == MOST_HEADS:
            break
        at_x, at_y = _middle(x, y, above, top)
        closed_m2 = np.float32(SHOULDER_M * SHOULDER_M)
        if _dips(x, y, above, at_x, at_y, above[top], heads[:number], cell_m, scratch[1:]):
            heads[number, 0], heads[number, 1], closed_m2 = at_x, at_y, np.float32(APART_M * APART_M)
            number += 1
        for i in range(0, n, LANES):
            dx, dy = load(x, i) - at_x, load(y, i) - at_y
            store(open_, i, select(fma(dx, dx, dy * dy) < closed_m2, np.float32(0.0), load(open_, i)))
        open_[top] = 0.0
    return number


@inner
def _highest(height, n):  # type: ignore[no-untyped-def]
    """Index of the first of the highest, -1 where none can be a head; behind n heights there is a vector of noughts."""
    highest = splat(np.float32(LOWEST_M))
    for i in range(0, n, LANES):
        highest = larger(highest, load(height, i))
    top_m, top = lane_max(highest), np.int64(0)  # a literal would have what takes it compiled once more
    if top_m <= np.float32(LOWEST_M):
        return np.int64(-1)
    while height[top] < top_m:
        top += 1
    return top


@inner
def _middle(x, y, above, top):  # type: ignore[no-untyped-def]
    """x and y of the middle of the head whose highest point is ``top``."""
    n, none, number = len(x), splat(np.float32(0.0)), splat(np.int32(0))
    sum_x, sum_y, lowest_m = none, none, above[top] - np.float32(HEAD_M)
    for i in range(0, n, LANES):
        dx, dy = load(x, i) - x[top], load(y, i) - y[top]
        here = (load(above, i) > lowest_m) & (fma(dx, dx, dy * dy) < np.float32(HEAD_M * HEAD_M))
        here &= lanes() < np.int32(n - i)
        sum_x, sum_y, number = sum_x + select(here, dx, none), sum_y + select(here, dy, none), number + ones(here)
    count = np.float32(lane_sum(number))
    return x[top] + lane_sum(sum_x) / count, y[top] + lane_sum(sum_y) / count


@inner
def _dips(x, y, above, at_x, at_y, top_m, heads, cell_m, scratch):  # type: ignore[no-untyped-def]
    """Whether the way from a top to each of the heads dips: whether some stretch of it is low."""
    height = np.empty(MOST_STEPS, np.float32)
    for h in range(len(heads)):
        dx, dy = heads[h, 0] - at_x, heads[h, 1] - at_y
        way_m = np.sqrt(dx * dx + dy * dy)
        if way_m < HEAD_M:
            return False
        steps = min(math.ceil(STEPS_A_CELL * way_m / cell_m), MOST_STEPS)
        per_m = np.float32(steps / way_m)
        on_it = _on_the_way(x, y, above, at_x, at_y, dx / way_m, dy / way_m, np.float32(way_m), scratch)
        height[:steps] = 0.0
        for i in range(on_it):
            step = min(int(scratch[0, i] * per_m), steps - 1)  # it may be rounded up
            height[step] = max(height[step], scratch[1, i])
        if top_m - _lowest_stretch(height[:steps], math.ceil(STRETCH_CELLS * cell_m * per_m)) < DIP_M:
            return False
    return True


@inner
def _on_the_way(x, y, above, at_x, at_y, c, s, way_m, scratch):  # type: ignore[no-untyped-def]
    """How far on a way, from (at_x, at_y) in direction (c, s), the points beside it are, and their heights, to the rows
    of scratch; returns how many they are."""
    n, m, far, high = len(x), 0, scratch[0], scratch[1]
    for i in range(0, n, LANES):
        ax, ay = load(x, i) - at_x, load(y, i) - at_y
        along, across = fma(ax, c, ay * s), fma(ay, c, ax * -s)
        here = (along >= np.float32(0.0)) & (along < way_m) & (magnitude(across) < np.float32(BESIDE_M))
        here &= lanes() < np.int32(n - i)
        store_chosen(far, m, along, here)
        store_chosen(high, m, load(above, i), here)
        m += lane_count(here)
    return m


@inner
def _lowest_stretch(height, length):  # type: ignore[no-untyped-def]
    """The lowest maximum of so many heights in a row."""
    lowest = np.float32(np.inf)
    for first in range(max(len(height) - length, 0) + 1):
        highest = np.float32(0.0)
        for k in range(first, min(first + length, len(height))):
            highest = max(highest, height[k])
        lowest = min(lowest, highest)
    return lowest


@inner
def _sort(points, first, source, heads, s, scratch, sizes):  # type: ignore[no-untyped-def]
    """Sort the points of a cluster, (4, n) from ``first`` on and their source (n,), by the nearest head, if what each
    gets, sizes (MOST_HEADS,), is of a person's size. Returns whether."""
    n, number = len(source), len(heads)
    nearest, begin = np.empty(n + LANES, np.int32), np.zeros(number + 1, np.int32)
    _assign(points[0, first : first + n], points[1, first : first + n], heads, nearest)
    for i in range(n):
        begin[nearest[i] + 1] += 1
    for h in range(number):
        sizes[h] = begin[h + 1]
        begin[h + 1] += begin[h]
    to, sorted_source = begin.copy(), np.empty(n, np.int32)
    for i in range(n):
        place = to[nearest[i]]
        to[nearest[i]], sorted_source[place] = place + 1, source[i]
        for row in range(4):
            scratch[row, place] = points[row, first + i]
    if not _are_people(scratch, begin, s):
        return False
    for i in range(n):
        source[i] = sorted_source[i]
        for row in range(4):
            points[row, first + i] = scratch[row, i]
    return True


@inner
def _assign(x, y, heads, nearest):  # type: ignore[no-untyped-def]
    """nearest (n,) int32, with room for a vector more: which of the heads is the nearest to each point."""
    for i in range(0, len(x), LANES):
        best_m2, best = splat(np.float32(np.inf)), splat(np.int32(0))
        for h in range(len(heads)):
            dx, dy = load(x, i) - heads[h, 0], load(y, i) - heads[h, 1]
            distance_m2 = fma(dx, dx, dy * dy)
            best = select(distance_m2 < best_m2, splat(np.int32(h)), best)
            best_m2 = smaller(distance_m2, best_m2)
        store(nearest, i, best)


@inner
def _are_people(points, begin, s):  # type: ignore[no-untyped-def]
    """Whether parts of points (4, n or more), from begin[h] to begin[h + 1], are all of a person's size."""
    number = len(begin) - 1
    for h in range(number):
        if begin[h + 1] - begin[h] < s.min_points:
            return False
    box, widest_m = np.empty((number, 8), np.float32), 0.0
    measure(points, begin, box)
    for h in range(number):
        widest_m = max(widest_m, math.hypot(box[h, 3], box[h, 4]))
    return widest_m <= PERSON_M


@inner
def _with_parts(points, shape, offsets, box, parts, sizes, total):  # type: ignore[no-untyped-def]
    """What ``part_people`` returns for ``total`` clusters: parts (K,) of sizes (K, MOST_HEADS) make up each old one."""
    new_shape, new_offsets = np.empty(total + 1, np.int32), np.empty(total + 1, np.int32)
    new_box, one_of_several, to = np.empty((total, 8), np.float32), np.empty(total, np.bool_), 0
    for k in range(len(box)):
        new_shape[to], new_offsets[to] = shape[k], offsets[k]
        for column in range(8):
            new_box[to, column] = box[k, column]
        end = to + parts[k]
        for h in range(end - to - 1):
            new_shape[to + h + 1] = new_shape[to + h] + sizes[k, h]
            new_offsets[to + h + 1] = new_offsets[to + h] + sizes[k, h]
        new_shape[end], new_offsets[end] = shape[k + 1], offsets[k + 1]
        if end - to > 1:
            measure(points, new_shape[to : end + 1], new_box[to:end])
        one_of_several[to:end] = end - to > 1
        to = end
    return new_shape, new_offsets, new_box, one_of_several
