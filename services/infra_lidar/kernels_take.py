"""Compiled end of the clustering: groups of clusters that are of a possible size, as copies that are kept.

Whoever changes this file has to clear the compiled kernels of its users: their cache does not notice.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner
from services.infra_lidar.kernels_clusters import measure_one
from services.infra_lidar.vectors import LANES, copy_first


@inner
def take_out(points, shape, source, offsets, box, group, s, scratch):  # type: ignore[no-untyped-def]
    """Copies of groups of clusters.

    points (4, S) by shape (K + 1,), source (T,) by offsets (K + 1,) and box (K, 8): clusters as
    ``kernels_clusters.regroup`` leaves them. group (K,) int32: the number of each one's group, below K; box is
    rewritten for the first of several. s: settings, as in ``kernels_steps``, only groups of a possible size are taken;
    None = all. scratch (3 or more, S or more) float32.
    Returns planar (3, P) of the points by group, with room for a vector behind it, where each group begins in it
    (G + 1,), members (M,), where each begins in those (G + 1,), and box (G, 8).
    """
    number, first, following = _members(group, offsets)
    groups, total, copied = 0, 0, 0
    for g in range(len(group)):
        if number[g] == 0:
            continue
        if following[first[g]] >= 0:
            _measure_group(points, shape, first[g], following, scratch, box)
        if s is None or _possible(box[first[g]], number[g], s):
            groups, total, k = groups + 1, total + number[g], first[g]
            while k >= 0:
                copied, k = copied + (shape[k + 1] - shape[k]), following[k]
        else:
            number[g] = 0
    planar = np.empty(3 * copied + LANES, np.float32)[: 3 * copied].reshape(3, copied)
    members, boxes, at = np.empty(total, np.int32), np.empty((groups, 8), np.float32), 0
    begins, member_begins, to, members_to = np.zeros(groups + 1, np.int32), np.zeros(groups + 1, np.int32), 0, 0
    for g in range(len(group)):
        if number[g] == 0:
            continue
        for column in range(8):
            boxes[at, column] = box[first[g], column]
        k = first[g]
        while k >= 0:
            to = _append(points, shape[k], shape[k + 1], planar, to)
            members_to = _append_indices(source, offsets[k], offsets[k + 1], members, members_to)
            k = following[k]
        at += 1
        begins[at], member_begins[at] = to, members_to
    return planar, begins, members, member_begins, boxes


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
def _append(points, first, last, planar, to):  # type: ignore[no-untyped-def]
    """Copy points first to last behind those that are there; returns how many there are."""
    for i in range(first, last, LANES):
        for row in range(3):
            copy_first(planar[row], to + (i - first), points[row], i, np.int32(last - i))
    return to + (last - first)


@inner
def _append_indices(source, first, last, members, to):  # type: ignore[no-untyped-def]
    """The same for indices in the frame."""
    for i in range(first, last, LANES):
        copy_first(members, to + (i - first), source, i, np.int32(last - i))
    return to + (last - first)


@inner
def _measure_group(points, offsets, head, following, scratch, box):  # type: ignore[no-untyped-def]
    """box[head] as that of this cluster and all that follow it."""
    k, n, lowest = head, 0, box[head, 7]
    while k >= 0:
        first, last = offsets[k], offsets[k + 1]
        for i in range(first, last, LANES):
            for row in range(3):
                copy_first(scratch[row], n + (i - first), points[row], i, np.int32(last - i))
        n, lowest, k = n + (last - first), min(lowest, box[k, 7]), following[k]
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
