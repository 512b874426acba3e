"""From the points of a frame that are not ground to its clusters, in one compiled call: the steps of ``clustering.py``.

Points that lie together by cluster stand in one of two sets of buffers; a step that regroups them writes the other.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner, kernel
from services.infra_lidar.kernels_adopt import adopt_strays
from services.infra_lidar.kernels_clusters import regroup
from services.infra_lidar.kernels_footprints import footprints
from services.infra_lidar.kernels_high import find_high, lift, put_down, spread, tall_ones
from services.infra_lidar.kernels_labels import label_points
from services.infra_lidar.kernels_merge import merge_fragments
from services.infra_lidar.kernels_people import part_people
from services.infra_lidar.kernels_runs import find_runs
from services.infra_lidar.kernels_split import second_look
from services.infra_lidar.kernels_take import possible, take_out

SETTINGS = np.dtype(
    [(name, np.float32) for name in (
        "per_m", "growth_per_m", "body_m", "max_height_m", "min_top_m", "max_diagonal_m",
    )]
    + [(name, np.int64) for name in (
        "connectivity", "min_points", "max_points", "fewest", "widest", "narrow", "enough",
    )]
    + [(name, np.bool_) for name in ("two_points", "fragments", "heads")]
)  # fmt: skip
LOOK = np.dtype([(name, np.bool_) for name in ("trim", "split", "engulf")])
INTS, FLOATS = 13, 8  # rows of scratch
MIN_FRAGMENT_POINTS = 3  # smaller pieces have no shape to judge by: they can only be adopted


@kernel
def find_clusters(  # type: ignore[no-untyped-def]
    points, m, source, settings, look, ints, floats, grid, touched, row_start
):
    """Clusters of m points (4, m or more) float32, x, y, z and height above the road, with index ``source`` (m,) in the
    frame.

    settings: (1,) ``SETTINGS``; look: a record of ``LOOK`` for the article's second look, which goes by all points,
    else None. ints (INTS, m + 1 or more) int32 and floats (FLOATS, m or more) float32 are scratch, with room for a
    vector more; grid, touched and row_start as in ``kernels_labels``.
    Returns copies, see ``ClusterPoints``: planar (3, S) float32, with room for a vector behind it, offsets (K + 1,)
    int32, members (T,) int32, member_offsets (K + 1,) int32, counts (K,) int32, box (K, 8) float32.
    """
    s = settings[0]
    # Components of cells that are occupied as low as a body; what is higher joins tall ones, or is on its own
    begin, label, across = ints[0], ints[1], ints[2]
    runs, components = _components(
        points, m, s.body_m, s, ints[4:8], grid, touched, row_start, begin, label, across
    )  # fmt: skip
    if s.body_m < np.inf:
        runs, components = _label_high(points, m, s, runs, components, ints, floats, grid, touched, row_start)

    # What may be a cluster or a part of one, as copies that lie together
    room, sets = floats.shape[1], (floats[:4].reshape(-1), floats[4:8].reshape(-1))
    box, shape = np.empty((components, 8), np.float32), ints[8]
    count, total, copied = regroup(
        begin[: runs + 1], label[:runs], components, s.fewest, s.max_points, across[:components], s.widest, s.narrow,
        s.enough, points, source, ints[3:5], ints[9], shape, sets[0], ints[10], box,
    )  # fmt: skip
    grouped, offsets, index = sets[0][: 4 * copied].reshape(4, copied), ints[9][: count + 1], ints[10][:total]

    # Groups of people
    shape, box, person = shape[: count + 1], box[:count], np.zeros(count, np.bool_)
    if s.heads:
        shape, offsets, box, person = part_people(grouped, shape, index, offsets, box, s, sets[1].reshape(4, room))
        count = len(box)

    # Pieces of vehicles
    group = _each_alone(count)
    if s.fragments:
        counts, foot = offsets[1:] - offsets[:-1], footprints(box)
        merge_fragments(box, foot, counts, person, MIN_FRAGMENT_POINTS, group)
        adopt_strays(foot, counts, s.min_points, group)

    # Only what is of a possible size; and the article's second look
    if look is None:
        return take_out(grouped, shape, index, offsets, box, group, s, sets[1].reshape(4, room))
    return _look_again(grouped, index, offsets, box, group, s, look, ints, sets)


@inner
def _look_again(grouped, index, offsets, box, group, s, look, ints, sets):  # type: ignore[no-untyped-def]
    """What ``find_clusters`` returns, of clusters all of whose points lie in sets[0]: pieces joined, and looked at
    once more."""
    count, total, room = len(offsets) - 1, len(index), len(sets[0]) // 4
    begin, scratch, second = ints[0], ints[3:5], (ints[11], ints[12])
    all_of_them, anywhere, across = np.int64(1), np.int64(0), ints[2, :0]  # literals would have it compiled once more
    if s.fragments:
        count, total, _ = regroup(
            offsets, group, count, all_of_them, total, across, anywhere, anywhere, s.enough, grouped, index,
            scratch, second[0], ints[8], sets[1], second[1], box,
        )  # fmt: skip
        grouped, offsets, index = sets[1][: 4 * total].reshape(4, total), second[0][: count + 1], second[1][:total]
        second, sets = (ints[9], ints[10]), (sets[1], sets[0])
    label, of_points = ints[5][:count], ints[4][:total]
    possible(box[:count], offsets, s, label)
    labels = second_look(grouped, offsets, box[:count], label, look, sets[1].reshape(4, room), of_points)
    runs, box = _runs(of_points, begin, ints[1]), np.empty((labels, 8), np.float32)
    count, total, _ = regroup(
        begin[: runs + 1], ints[1][:runs], labels, all_of_them, total, across, anywhere, anywhere, s.enough,
        grouped, index, scratch, second[0], ints[8], sets[1], second[1], box,
    )  # fmt: skip
    grouped, offsets, index = sets[1][: 4 * total].reshape(4, total), second[0][: count + 1], second[1][:total]
    return take_out(grouped, offsets, index, offsets, box, _each_alone(count), None, sets[0].reshape(4, room))


@inner
def _each_alone(count):  # type: ignore[no-untyped-def]
    """(count,) int32: every cluster is a group of its own."""
    group = np.empty(count, np.int32)
    for k in range(count):
        group[k] = k
    return group


@inner
def _components(points, n, body_m, s, scratch, grid, touched, row_start, begin, label, across):  # type: ignore[no-untyped-def]
    return label_points(
        points, n, body_m, s.per_m, s.growth_per_m, s.two_points, s.connectivity == 8, grid, touched, row_start,
        scratch, begin, label, across,
    )  # fmt: skip


@inner
def _label_high(points, m, s, runs, components, ints, floats, grid, touched, row_start):  # type: ignore[no-untyped-def]
    """Give high points to tall components, and label those that join nothing: a roof behind other cars, or a canopy.

    Runs, labels and extents in ints[:3] are written anew. Returns the numbers of runs and components.
    """
    begin, label, across, of_points, lifted = ints[0], ints[1], ints[2], ints[9], floats[:4]
    spread(begin[: runs + 1], label[:runs], of_points)
    highs, tops = find_high(points[3], of_points[:m], s.body_m, ints[10], ints[8], ints[11])
    high, high_label, top_label = ints[10, :highs], ints[8, :highs], ints[11, :tops]
    number = _count_points(begin, label[:runs], components, ints[12])
    tall = tall_ones(number, high_label, top_label, ints[12])
    loose = lift(points, of_points, tall, high, high_label, lifted)
    if loose > 0:
        runs, found = _components(
            lifted, loose, np.float32(np.inf), s, ints[4:8], grid, touched, row_start, begin, label,
            across[components:],
        )  # fmt: skip
        spread(begin[: runs + 1], label[:runs], ints[11])
        put_down(ints[11], np.int32(components), high[:loose], of_points)
        components += found
    return _runs(of_points[:m], begin, label), components


@inner
def _count_points(begin, label, components, spans):  # type: ignore[no-untyped-def]
    """(components + 1,) int32: points of each label, counted from -1, of runs; spans (runs + 1 or more,) int32 is
    scratch."""
    number = np.zeros(components + 1, np.int32)
    for r in range(find_runs(label, spans)):  # of runs of one label, one behind the other, there are far fewer
        number[np.uint32(label[spans[r]] + np.int32(1))] += begin[spans[r + 1]] - begin[spans[r]]
    return number


@inner
def _runs(of_points, begin, label):  # type: ignore[no-untyped-def]
    """Runs of points of one label, and their labels; returns how many."""
    runs = find_runs(of_points, begin)
    for r in range(runs):
        label[r] = of_points[begin[r]]
    return runs
