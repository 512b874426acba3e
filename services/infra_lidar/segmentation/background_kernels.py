"""Compiled passes of the background model: one look-up per return in (azimuth, ring) order, the order of firing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.infra_lidar.input.range_image import RangeImageArrays, write_xyz
from services.infra_lidar.jit import kernel
from services.infra_lidar.segmentation.ground_kernels import MAX_RANGE_M, MIN_RANGE_M

MODES = 3  # ranges that are remembered per cell while learning
MIN_SEEN_SHARE = 0.2  # a cell with returns in fewer of the frames stays unknown
FLICKER_SHARE = 0.2  # two ranges that take turns this often are both background; a queue takes turns far less often
MIN_SECOND_SHARE = 0.1  # a second range that came back less often is noise
MAX_BEHIND_SHARE = 0.1  # a range that was seen through more often is no background
ROAD_USER_SHARE = 0.3  # a range that belonged to a road user this often is no background
ROWS_PER_RAD = 256.0  # 0.22 degrees, for clouds without a ring column
NO_RETURN = -1
BLOCK = 128  # cells whose intervals lie together in memory: those of a column, where a sensor has 128 beams
EMPTY = (1.0, 0.0)  # an interval that holds no range
STEP_M = 0.008  # of the ends of intervals: two bytes reach to 524 m; what is farther is never background


class Grid(NamedTuple):
    """Cells of the background: columns of azimuth x rows, rings or elevations; cell = column * rows + row."""

    columns: int
    rows: int


class Tolerance(NamedTuple):
    """By how much a range may vary: base_m + slope * range."""

    base_m: float
    slope: float


class RangeModes(NamedTuple):
    """Up to three ranges per cell that came back while learning.

    near_m, far_m: (cells, MODES) float32. frames, road_user_frames: (cells, MODES) uint16, number of frames with such a
    range, and of those in which it was a road user's. latest: (cells,) uint8, mode of the last frame. switches:
    (cells,) uint16, how often that changed.
    """

    near_m: np.ndarray
    far_m: np.ndarray
    frames: np.ndarray
    road_user_frames: np.ndarray
    latest: np.ndarray
    switches: np.ndarray


@kernel
def locate(points: np.ndarray, azimuth: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """(N,) int32 cell, ``NO_RETURN`` where there is none, and (N,) float32 range (m) of (N, 3+) float32 points.

    azimuth: (N,) float32 rad, arctan2(y, x).
    """
    n = len(points)
    cell, range_m, row = np.empty(n, np.int32), np.empty(n, np.float32), np.empty(n, np.int32)
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        range_m[i] = np.sqrt(x * x + y * y + z * z)
    if points.shape[1] > 4:
        for i in range(n):
            row[i] = np.int32(points[i, 4])
    else:
        for i in range(n):
            row[i] = np.int32(points[i, 2] / range_m[i] * ROWS_PER_RAD + grid.rows // 2) if range_m[i] > 0 else 0
    rows, last_row, last_column = np.int32(grid.rows), np.int32(grid.rows - 1), np.int32(grid.columns - 1)
    per_rad = grid.columns / (2.0 * np.pi)
    for i in range(n):  # no branch depends on a point: the compiler vectorises it
        is_return = (range_m[i] > MIN_RANGE_M) & (range_m[i] < MAX_RANGE_M)
        column = min(np.int32((azimuth[i] + np.pi) * per_rad), last_column)
        at = column * rows + min(max(row[i], np.int32(0)), last_row)
        cell[i] = at if is_return else np.int32(NO_RETURN)
    return cell, range_m


@kernel
def learn(
    cell: np.ndarray, range_m: np.ndarray, road_user: np.ndarray, tolerance: Tolerance, modes: RangeModes
) -> None:
    """Add a frame, (N,) as ``locate`` makes them, to the modes; road_user: (N,) bool.

    A range within the tolerance of a mode widens it; otherwise it takes the rarest mode's place.
    """
    near_m, far_m, count = modes.near_m, modes.far_m, modes.frames
    for i in range(len(cell)):
        c, r = cell[i], range_m[i]
        if c == NO_RETURN:
            continue
        margin = np.float32(tolerance.base_m + tolerance.slope * r)
        rarest, mode = 0, -1
        for m in range(MODES):
            if count[c, m] > 0 and near_m[c, m] - margin <= r <= far_m[c, m] + margin:
                mode = m
                break
            if count[c, m] < count[c, rarest]:
                rarest = m
        if mode >= 0:
            near_m[c, mode], far_m[c, mode] = min(near_m[c, mode], r), max(far_m[c, mode], r)
            count[c, mode] = min(count[c, mode] + 1, 65535)
        else:
            mode = rarest
            near_m[c, mode], far_m[c, mode], count[c, mode], modes.road_user_frames[c, mode] = r, r, 1, 0
        modes.road_user_frames[c, mode] = min(modes.road_user_frames[c, mode] + road_user[i], 65535)
        modes.switches[c] += modes.latest[c] != mode
        modes.latest[c] = mode


@kernel
def build_model(
    modes: RangeModes, grid: Grid, frames: int, min_share: float, tolerance: Tolerance
) -> tuple[np.ndarray, np.ndarray]:
    """What was always there: (cells, 4) float32 m, near and far end of two intervals of range, and (cells,) bool.

    A range is background if nearly all returns of the cell came from it and none from behind it: what was sometimes
    seen through, as a car at a red light, is not. Where two ranges take turns from frame to frame (an edge, leaves),
    both are. A cell with one range only gets that of a neighbour in azimuth as its second. The bool says that what was
    always there was often a road user, which may have parked there.
    """
    cells, rows = grid.columns * grid.rows, grid.rows
    chosen, is_road_user = np.empty((cells, 2), np.int8), np.zeros(cells, np.bool_)
    for c in range(cells):
        chosen[c, 0], chosen[c, 1] = _background_modes(modes, c, frames, min_share)
        for m in chosen[c]:
            is_road_user[c] |= m >= 0 and modes.road_user_frames[c, m] > ROAD_USER_SHARE * modes.frames[c, m]
    intervals_m = np.empty((cells, 4), np.float32)
    for c in range(cells):
        intervals_m[c, 0], intervals_m[c, 1] = _interval(modes, c, chosen[c, 0], tolerance)
        intervals_m[c, 2], intervals_m[c, 3] = _interval(modes, c, chosen[c, 1], tolerance)
        if chosen[c, 1] >= 0:
            continue
        own = chosen[c, 0]
        for side in (-1, 1):
            n = (c // rows + side) % grid.columns * rows + c % rows
            other = chosen[n, 0]
            if other < 0:
                continue
            farther = modes.far_m[n, other] > modes.far_m[c, own] + tolerance.base_m
            nearer = modes.near_m[n, other] < modes.near_m[c, own] - tolerance.base_m
            if own < 0 or farther or nearer:
                intervals_m[c, 2], intervals_m[c, 3] = _interval(modes, n, other, tolerance)
    return intervals_m, is_road_user


@kernel
def _background_modes(modes: RangeModes, c: int, frames: int, min_share: float) -> tuple[int, int]:
    """The one or two modes of a cell that are background, -1 = none."""
    count = modes.frames[c]
    total, best, second, behind = 0, 0, -1, 0
    for m in range(MODES):
        total += count[m]
        best = m if count[m] > count[best] else best
    for m in range(MODES):
        behind += count[m] if modes.near_m[c, m] > modes.far_m[c, best] else 0
        if m != best and (second < 0 or count[m] > count[second]):
            second = m
    if total < MIN_SEEN_SHARE * frames:
        return -1, -1
    if modes.switches[c] >= FLICKER_SHARE * total and count[best] + count[second] >= min_share * total:
        return best, second if count[second] >= MIN_SECOND_SHARE * total else -1
    if count[best] >= min_share * total and behind <= MAX_BEHIND_SHARE * total:
        return best, -1
    return -1, -1


@kernel
def _interval(modes: RangeModes, c: int, mode: int, tolerance: Tolerance) -> tuple[float, float]:
    """Ranges (m) that count as a mode of a cell."""
    if mode < 0:
        return EMPTY
    near, far = modes.near_m[c, mode], modes.far_m[c, mode]
    near_end = max(near - tolerance.base_m - tolerance.slope * near, 0.0)
    return near_end, far + tolerance.base_m + tolerance.slope * far


@kernel
def foreground_of_points(
    points: np.ndarray, azimuth: np.ndarray, grid: Grid, intervals: np.ndarray, near_m: float
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Points, index, returns and near of ``background.Foreground`` for points and azimuth as ``locate`` takes them.

    intervals: (blocks, 4, BLOCK) as in ``background.BackgroundModel``.
    """
    cell, range_m = locate(points, azimuth, grid)
    n, returns, near = len(points), np.int32(0), np.int32(0)
    is_foreground = np.empty(n, np.bool_)
    for i in range(n):
        r, is_return, c = range_m[i], cell[i] != NO_RETURN, np.uint32(max(cell[i], np.int32(0)))
        block, b, steps = intervals[c // np.uint32(BLOCK)], c % np.uint32(BLOCK), r * np.float32(1.0 / STEP_M)
        known = ((steps >= block[0, b]) & (steps <= block[1, b])) | ((steps >= block[2, b]) & (steps <= block[3, b]))
        is_foreground[i] = is_return & (not known)
        returns += np.int32(is_return)
        near += np.int32(is_return & (r < near_m))
    index = _places(is_foreground)
    foreground = np.empty((len(index), 3), np.float32)
    for k in range(len(index)):
        for axis in range(3):
            foreground[k, axis] = points[index[k], axis]
    return foreground, index, int(returns), int(near)


@kernel
def _places(mask: np.ndarray) -> np.ndarray:
    """(M,) int32 indices where mask (N,) bool is set. Most is background, so eight at a time are passed over."""
    index, m = np.empty(len(mask), np.int32), np.uint32(0)
    eight = len(mask) // 8 * 8
    words = mask[:eight].view(np.uint64)
    for w in range(len(words)):
        if words[w] == np.uint64(0):
            continue
        for i in range(8 * w, 8 * w + 8):  # no branch depends on a range, so that the processor need not guess
            index[m] = i
            m += np.uint32(mask[i])
    for i in range(eight, len(mask)):
        index[m] = i
        m += np.uint32(mask[i])
    return index[:m]


@kernel
def foreground_of_image(
    image: RangeImageArrays, first: np.ndarray, intervals: np.ndarray, near_m: float
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """The same for a range image; first: (R,) int cell of the first range of each row, the others of a row follow."""
    rows, width = image.range_m.shape
    is_foreground, returns, near = np.empty(rows * width, np.bool_), 0, 0
    for row in range(rows):
        out = is_foreground[row * width : (row + 1) * width]
        block, begin = intervals[first[row] // BLOCK], first[row] % BLOCK
        row_returns, row_near = _compare_row(image.range_m[row], block, begin, np.float32(near_m), out)
        returns, near = returns + row_returns, near + row_near
    index = _places(is_foreground)
    points, wide = np.empty((len(index), 3), np.float32), np.uint32(width)
    for k in range(len(index)):
        in_row = np.uint32(index[k]) // wide
        write_xyz(image, int(in_row), int(np.uint32(index[k]) - in_row * wide), points[k])
    return points, index, returns, near


@kernel
def _compare_row(
    range_m: np.ndarray, block: np.ndarray, begin: int, near_m: np.float32, is_foreground: np.ndarray
) -> tuple[int, int]:
    """Write is_foreground (W,) bool of ranges (W,) float32, whose cells are from ``begin`` on in a block (4, BLOCK) of
    intervals; counts returns and near."""
    end = begin + len(range_m)
    near_1, far_1, near_2, far_2 = block[0, begin:end], block[1, begin:end], block[2, begin:end], block[3, begin:end]
    returns, near = np.int32(0), np.int32(0)
    for i in range(len(range_m)):
        r, steps = range_m[i], range_m[i] * np.float32(1.0 / STEP_M)
        is_return = (r > MIN_RANGE_M) & (r < MAX_RANGE_M)
        known = ((steps >= near_1[i]) & (steps <= far_1[i])) | ((steps >= near_2[i]) & (steps <= far_2[i]))
        is_foreground[i] = is_return & (not known)
        returns += np.int32(is_return)
        near += np.int32(is_return & (r < near_m))
    return int(returns), int(near)
