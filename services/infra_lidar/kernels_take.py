"""Compiled end of the clustering: groups of clusters that are of a possible size, as copies that are kept."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner
from services.infra_lidar.kernels_clusters import measure_one
from services.infra_lidar.vectors import LANES, load, store


@inner
def take_out(points, shape, source, offsets, box, group, s, scratch):  # type: ignore[no-untyped-def]
    """Copies of groups of clusters.

    points (4, S) by shape (K + 1,), source (T,) by offsets (K + 1,) and box (K, 8): clusters as
    ``kernels_clusters.regroup`` leaves them. group (K,) int32: the number of each one's group, below K; box is
    rewritten for the first of several. s: settings, as in ``kernels_steps``, only groups of a possible size are taken;
    None = all. scratch (3 or more, S or more) float32.
    Returns planar (3, P) of the points by group, with room for a vector behind it, where each group begins in it
    (G + 1,), members (M,), where each begins in those (G + 1,), how many it has (G,), and box (G, 8).
    """
    number, first, following = _members(group, offsets)
    taken, copied = np.empty(len(group), np.int32), 0  # clusters, group by group
    clusters, groups, total = 0, np.int64(0), 0  # a literal would have what takes it compiled once more
    for g in range(len(group)):
        if number[g] == 0:
            continue
        if following[first[g]] >= 0:
            _measure_group(points, shape, first[g], following, scratch, box)
        if s is None or _possible(box[first[g]], number[g], s):
            groups, total, k = groups + 1, total + number[g], first[g]
            while k >= 0:
                taken[clusters], clusters = k, clusters + 1
                copied, k = copied + (shape[k + 1] - shape[k]), following[k]
        else:
            number[g] = 0
    taken = taken[:clusters]
    planar = np.empty(3 * copied + LANES, np.float32)[: 3 * copied].reshape(3, copied)
    for row in range(3):  # what is too much is written over by the next one, and in the end by the next row
        _line_up(points[row], shape, taken, planar[row])
    members = np.empty(total + LANES, np.int32)[:total]
    _line_up(source, offsets, taken, members)
    begins, member_begins, counts, boxes = _begins(group, shape, offsets, taken, box, groups)
    return planar, begins, members, member_begins, counts, boxes


@inner
def _members(group, offsets):  # type: ignore[no-untyped-def]
    """The points of each group, its first cluster, and the one that follows each in its group, -1 = none."""
    clusters = len(group)
    number, first, latest = np.zeros(clusters, np.int32), np.empty(clusters, np.int32), np.empty(clusters, np.int32)
    following = np.empty(clusters, np.int32)
    for k in range(clusters):
        g, following[k] = group[k], -1
        if number[g] == 0:
            first[g] = k
        else:
            following[latest[g]] = k
        latest[g] = k
        number[g] += offsets[k + 1] - offsets[k]
    return number, first, following


@inner
def _line_up(values, offsets, taken, out):  # type: ignore[no-untyped-def]
    """Copy what the clusters ``taken`` have of the values, one behind the other; out has room for a vector more."""
    to = 0
    for k in taken:
        to = _append(values, offsets[k], offsets[k + 1], out, to)


@inline
def _append(values, first, last, out, to):  # type: ignore[no-untyped-def]
    """Copy values first to last, and what of a vector comes behind them; returns where they end."""
    for i in range(0, last - first, LANES):
        store(out, to + i, load(values, first + i))
    return to + (last - first)


@inner
def _begins(group, shape, offsets, taken, box, groups):  # type: ignore[no-untyped-def]
    """Where each of the groups begins, by shape and by offsets (G + 1,) int32, how many it has by these (G,) int32, and
    its box (G, 8), that of its first cluster."""
    begins, member_begins = np.zeros(groups + 1, np.int32), np.zeros(groups + 1, np.int32)
    counts, boxes, at = np.zeros(groups, np.int32), np.empty((groups, 8), np.float32), 0
    for i in range(len(taken)):
        k = taken[i]
        if i == 0 or group[k] != group[taken[i - 1]]:
            for column in range(8):
                boxes[at, column] = box[k, column]
            at += 1
            begins[at], member_begins[at] = begins[at - 1], member_begins[at - 1]
        begins[at] += shape[k + 1] - shape[k]
        member_begins[at] += offsets[k + 1] - offsets[k]
        counts[at - 1] += offsets[k + 1] - offsets[k]
    return begins, member_begins, counts, boxes


@inner
def _measure_group(points, offsets, head, following, scratch, box):  # type: ignore[no-untyped-def]
    """box[head] as that of this cluster and all that follow it."""
    k, n, lowest = head, 0, box[head, 7]
    while k >= 0:
        for row in range(3):
            _append(points[row], offsets[k], offsets[k + 1], scratch[row], n)
        n, lowest, k = n + (offsets[k + 1] - offsets[k]), min(lowest, box[k, 7]), following[k]
    measure_one(scratch[0, :n], scratch[1, :n], scratch[2, :n], box[head])
    box[head, 7] = lowest


@inner
def possible(box, offsets, s, label):  # type: ignore[no-untyped-def]
    """label (K,) int32: k for clusters of a possible size, -1 for others; s: settings, as in ``kernels_steps``."""
    for k in range(len(label)):
        label[k] = k if _possible(box[k], offsets[k + 1] - offsets[k], s) else -1


@inner
def _possible(box, n, s):  # type: ignore[no-untyped-def]
    good = (s.min_points <= n) & (n <= s.max_points) & (box[5] <= s.max_height_m) & (box[7] + box[5] >= s.min_top_m)
    return good & (np.hypot(box[3], box[4]) <= s.max_diagonal_m)
