"""Groups of pedestrians who stand so close together that they are one cluster, split by their heads.

The highest point is a head. So is the next highest that is not too near, if the cluster dips on the way to every head
before it: between two people there are shoulders. Each point goes to the nearest head, and the cluster is split only
if all parts are of a person's size. After Munaro, Basso and Menegatti, "Tracking people within groups with RGB-D
data" (IROS 2012), who look for heads in a map of heights.
"""

from __future__ import annotations

import math

import numpy as np

from services.infra_lidar.clustering.boxes import ClusterPoints, fit_box, group_by_label
from services.infra_lidar.clustering.grid import CellScale
from services.infra_lidar.jit import kernel

MIN_LENGTH_M, MAX_DIAGONAL_M = 0.6, 2.5  # of a group of people
MIN_HEIGHT_M = 0.8  # visible of them: less may be the roof of a car
MIN_HEAD_M, MAX_HEAD_M = 1.1, 2.2  # heads, above the road
HEAD_DISTANCE_M, DIP_M = np.float32(0.4), 0.25  # between two heads, and how much lower it is between them
HEAD_M = np.float32(0.2)  # across and high
BESIDE_M = np.float32(0.25)  # points this near the line between two heads count for the dip
SHOULDER_M = np.float32(0.2)  # around a rejected top no other one is tried
PERSON_DIAGONAL_M = 1.0  # with a bag
MAX_HEADS, MAX_TRIES = 6, 7
STEPS_PER_CELL, MAX_STEPS, DIP_CELLS = 4, 64, 0.5  # the length of a dip: two columns of returns


@kernel
def split_pedestrian_groups(
    clusters: ClusterPoints, scale: CellScale, min_points: int
) -> tuple[ClusterPoints, np.ndarray]:
    """Clusters with groups of pedestrians split, and (K,) bool, which of them are parts of such a group.

    The points of a group that is split are rearranged in place.
    """
    heads, more = np.empty((MAX_HEADS, 2), np.float32), 0
    sizes = np.zeros((len(clusters.box), MAX_HEADS), np.int32)
    for k in range(len(clusters.box)):
        first, last = clusters.offsets[k], clusters.offsets[k + 1]
        sizes[k, 0] = last - first
        if last - first < 2 * min_points or not _may_be_people(clusters.box[k]):
            continue
        points = clusters.points[first:last]
        cell_m = (1.0 + math.hypot(clusters.box[k, 0], clusters.box[k, 1]) * scale.growth_per_m) / scale.per_m
        number = _find_heads(points, cell_m, heads)
        if number > 1:
            more += _split(points, clusters.members[first:last], heads[:number], min_points, sizes[k]) - 1
    return _with_parts(clusters, sizes, len(clusters.box) + more)


@kernel
def _may_be_people(box: np.ndarray) -> bool:
    """Whether a box (8,) can be a group of people."""
    top_m = box[7] + box[5]
    if box[5] < MIN_HEIGHT_M or box[3] < MIN_LENGTH_M or math.hypot(box[3], box[4]) > MAX_DIAGONAL_M:
        return False
    return MIN_HEAD_M <= top_m <= MAX_HEAD_M


@kernel
def _find_heads(points: np.ndarray, cell_m: np.float32, heads: np.ndarray) -> int:
    """Write x and y of the heads of points (n, 4) to heads (MAX_HEADS, 2), the highest first; returns their number."""
    open_m, number = points[:, 3].copy(), 0  # height of the points that may still be a head
    for _ in range(MAX_TRIES):
        top = np.argmax(open_m)
        if open_m[top] <= np.float32(MIN_HEAD_M) or number == MAX_HEADS:
            break
        x, y = _head_centre(points, top)
        closed_m = SHOULDER_M
        if _dips(points, np.array([x, y, points[top, 3]]), heads[:number], cell_m):
            heads[number, 0], heads[number, 1], closed_m = x, y, HEAD_DISTANCE_M
            number += 1
        for i in range(len(points)):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            if dx * dx + dy * dy < closed_m * closed_m:
                open_m[i] = 0.0
        open_m[top] = 0.0
    return number


@kernel
def _head_centre(points: np.ndarray, top: np.intp) -> tuple[float, float]:
    """x and y (float32) of the middle of the head whose highest point is ``top``."""
    sum_x, sum_y, number = np.float32(0.0), np.float32(0.0), 0
    for i in range(len(points)):
        dx, dy = points[i, 0] - points[top, 0], points[i, 1] - points[top, 1]
        if points[i, 3] > points[top, 3] - HEAD_M and dx * dx + dy * dy < HEAD_M * HEAD_M:
            sum_x, sum_y, number = sum_x + dx, sum_y + dy, number + 1
    count = np.float32(number)
    return points[top, 0] + sum_x / count, points[top, 1] + sum_y / count


@kernel
def _dips(points: np.ndarray, top: np.ndarray, heads: np.ndarray, cell_m: np.float32) -> bool:
    """Whether the points are lower somewhere on the way from ``top`` (x, y, height) to each of the heads."""
    height = np.empty(MAX_STEPS, np.float32)
    for h in range(len(heads)):
        dx, dy = heads[h, 0] - top[0], heads[h, 1] - top[1]
        way_m = np.sqrt(dx * dx + dy * dy)
        if way_m < HEAD_M:
            return False
        steps = min(math.ceil(STEPS_PER_CELL * way_m / cell_m), MAX_STEPS)
        per_m, c, s = np.float32(steps / way_m), dx / way_m, dy / way_m
        height[:steps] = 0.0
        for i in range(len(points)):
            ax, ay = points[i, 0] - top[0], points[i, 1] - top[1]
            along, across = ax * c + ay * s, ay * c - ax * s
            if 0.0 <= along < way_m and abs(across) < BESIDE_M:
                step = min(int(along * per_m), steps - 1)
                height[step] = max(height[step], points[i, 3])
        if top[2] - _lowest_stretch(height[:steps], math.ceil(DIP_CELLS * cell_m * per_m)) < DIP_M:
            return False
    return True


@kernel
def _lowest_stretch(height: np.ndarray, length: int) -> np.float32:
    """The lowest maximum of ``length`` successive heights."""
    lowest = np.float32(np.inf)
    for first in range(max(len(height) - length, 0) + 1):
        highest = np.float32(0.0)
        for k in range(first, min(first + length, len(height))):
            highest = max(highest, height[k])
        lowest = min(lowest, highest)
    return lowest


@kernel
def _split(points: np.ndarray, members: np.ndarray, heads: np.ndarray, min_points: int, sizes: np.ndarray) -> int:
    """Sort points (n, 4) and members (n,) by the nearest head, if all parts are of a person's size.

    Writes the number of points of each part to sizes (MAX_HEADS,). Returns the number of parts, 1 = not split.
    """
    nearest = np.empty(len(points), np.int32)
    for i in range(len(points)):
        best_m2 = np.float32(np.inf)
        for h in range(len(heads)):
            dx, dy = points[i, 0] - heads[h, 0], points[i, 1] - heads[h, 1]
            if dx * dx + dy * dy < best_m2:
                best_m2, nearest[i] = dx * dx + dy * dy, h
    parts = group_by_label(points, members, nearest, len(points))
    if len(parts.box) < len(heads):
        return 1  # a head that no point is nearest to
    for h in range(len(heads)):
        small = parts.offsets[h + 1] - parts.offsets[h] < min_points
        if small or math.hypot(parts.box[h, 3], parts.box[h, 4]) > PERSON_DIAGONAL_M:
            return 1
    for i in range(len(points)):
        members[i] = parts.members[i]
        for column in range(4):
            points[i, column] = parts.points[i, column]
    for h in range(len(heads)):
        sizes[h] = parts.offsets[h + 1] - parts.offsets[h]
    return len(heads)


@kernel
def _with_parts(clusters: ClusterPoints, sizes: np.ndarray, total: int) -> tuple[ClusterPoints, np.ndarray]:
    """The clusters as ``total`` parts of sizes (K, MAX_HEADS), 0 = none; and (total,) bool, which are new."""
    offsets, box = np.zeros(total + 1, np.int32), np.empty((total, 8), np.float32)
    is_part, at = np.zeros(total, np.bool_), 0
    for k in range(len(sizes)):
        for h in range(MAX_HEADS):
            if sizes[k, h] == 0:
                break
            offsets[at + 1] = offsets[at] + sizes[k, h]
            is_part[at] = sizes[k, 1] > 0
            if is_part[at]:
                fit_box(clusters.points[offsets[at] : offsets[at + 1]], box[at])
            else:
                for column in range(box.shape[1]):
                    box[at, column] = clusters.box[k, column]
            at += 1
    return ClusterPoints(clusters.points, clusters.members, offsets, box), is_part
