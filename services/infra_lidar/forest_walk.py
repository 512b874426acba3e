"""How rows walk down the trees of a forest, one a lane, and what may come out where one column is left open.

Where a column is open, a row goes at each node that asks for it both ways: on as its number says, and once more, later,
the other way. So the ends that it could reach are known, and with them between which bounds its shares lie whatever
the number is.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner, kernel
from services.infra_lidar.vectors import (
    LANES,
    gather,
    gather_listed,
    gather_pairs,
    lane_count,
    lanes,
    load,
    ones,
    splat,
    store,
    store_chosen,
    unbits,
)

COLUMN_BITS = 8  # so many columns of x, and 2 ** 23 nodes, fit into a word
_ROUNDING = np.float32(1e-3)  # of sums over trees, where a curve is steep
_TREES = 4  # that are walked together: each waits for memory at every step


@kernel
def walk(
    x: np.ndarray, nodes: np.ndarray, limits: np.ndarray, leaf: np.ndarray, value: np.ndarray, root: np.ndarray,
    depth: np.ndarray, open_column: int, queue: np.ndarray, out: np.ndarray, low: np.ndarray | None,
    high: np.ndarray | None,
) -> None:  # fmt: skip
    """Mean class shares (K, C) of the trees into ``out``.

    nodes (N, 2) int32: child and column in one word, then the bits of the threshold; limits: the same as float32. The
    least and most that the shares can be, whatever the open column holds, go into ``low`` and ``high`` (K, C);
    ``queue`` (2, room) int32 needs room for ``LANES`` of each node that asks for it, and ``LANES`` more. Without them
    no column is open (-1), and what is done for it is not even compiled.
    """
    trees, rows, columns = len(root), len(x), x.shape[1]
    classes, shares = value.shape[1], value.reshape(value.size)
    total = np.zeros((3, classes * LANES), np.float32)  # of the trees, and what the other ways take off and add
    node, here = np.empty(_TREES * LANES, np.int32), np.zeros(columns * LANES, np.float32)
    for start in range(0, rows, LANES):
        taken = min(LANES, rows - start)
        _take_rows(x[start : start + taken], here)
        total[:] = 0.0
        for first in range(0, trees, _TREES):
            number, deepest = min(_TREES, trees - first), 0
            for t in range(number):
                store(node, t * LANES, splat(root[first + t]))
                deepest = max(deepest, depth[first + t])
            opened = _descend(here, nodes, deepest, node, number, open_column, queue[0], queue[1])
            for at in range(0, number * LANES, LANES):
                store(node, at, gather_listed(leaf, node, at) * np.int32(classes))  # where their shares begin
                _add_shares(shares, node, at, classes, total[0])
            if low is not None:
                _add_doubts(here, nodes, limits, leaf, shares, classes, node, opened, open_column, queue, total)
        for lane in range(taken):
            for c in range(classes):
                at = c * LANES + lane
                out[start + lane, c] = total[0, at] / np.float32(trees)
                if low is not None and high is not None:
                    low[start + lane, c] = (total[0, at] + total[1, at]) / np.float32(trees)
                    high[start + lane, c] = (total[0, at] + total[2, at]) / np.float32(trees)


@inner
def _take_rows(x: np.ndarray, here: np.ndarray) -> None:
    """Rows to lanes; what is not a number counts as 0."""
    for lane in range(len(x)):
        for column in range(x.shape[1]):
            number = x[lane, column]
            here[column * LANES + lane] = number if number == number else np.float32(0.0)


@inline
def _descend(here, nodes, depth, node, trees, open_column, walker, other):  # type: ignore[no-untyped-def]
    """Walk down some trees with all lanes at once. node (_TREES * LANES,) int32, where they begin and end. Returns how
    many nodes asked for the open column: who stood there goes into ``walker``, the way not taken into ``other``."""
    mask, own, opened = np.int32((1 << COLUMN_BITS) - 1), lanes(), 0
    for _ in range(depth):
        moved = np.int32(0)
        for t in range(0, trees * LANES, LANES):
            word, threshold = gather_pairs(nodes, node, t)
            column, left = word & mask, word >> np.int32(COLUMN_BITS)
            right = gather(here, column * np.int32(LANES) + own) > unbits(threshold)
            following = left + ones(right)
            moving = following != load(node, t)
            moved += lane_count(moving)
            asked = moving & (column == np.int32(open_column))
            number = lane_count(asked)
            if number > 0:
                store_chosen(walker, opened, own + np.int32(t), asked)
                store_chosen(other, opened, left + ones(~right), asked)
                opened += number
            store(node, t, following)
        if moved == 0:  # all of them have arrived
            break
    return opened


@inline
def _add_shares(shares, begin, at, classes, total):  # type: ignore[no-untyped-def]
    for c in range(classes):
        store(total, c * LANES, load(total, c * LANES) + gather_listed(shares[c:], begin, at))


@inner
def _add_doubts(
    here: np.ndarray, nodes: np.ndarray, limits: np.ndarray, leaf: np.ndarray, shares: np.ndarray, classes: int,
    begin: np.ndarray, opened: int, open_column: int, queue: np.ndarray, total: np.ndarray,
) -> None:  # fmt: skip
    """Walk the ways not taken, and those not taken on them. What an end has less, or more, of a class than the one that
    was reached is added to what can be lost, or won, of it: at most one of a tree's ends is reached, so a tree with
    several is given more doubt than it has, never less."""
    k = 0
    while k < opened:
        walker, at = queue[0, k], queue[1, k]
        lane = walker % LANES
        while True:
            column, following = nodes[at, 0] & ((1 << COLUMN_BITS) - 1), nodes[at, 0] >> COLUMN_BITS
            if following == at:
                break
            right = here[column * LANES + lane] > limits[at, 1]
            if column == open_column:
                queue[0, opened], queue[1, opened] = walker, following + (not right)
                opened += 1
            at = following + right
        for c in range(classes):
            change = shares[leaf[at] * classes + c] - shares[begin[walker] + c]
            if change < 0.0:
                total[1, c * LANES + lane] += change
            else:
                total[2, c * LANES + lane] += change
        k += 1


@kernel
def calibrate(shares: np.ndarray, known_x: np.ndarray, known_y: np.ndarray) -> None:
    """Forest shares (K, C) to probabilities, in place: interpolated between the measured points, summing to 1."""
    for k in range(len(shares)):
        total = np.float32(0.0)
        for c in range(shares.shape[1]):
            shares[k, c] = _calibrated(shares[k, c], known_x[c], known_y[c])
            total += shares[k, c]
        for c in range(shares.shape[1]):
            shares[k, c] /= total


@inner
def _calibrated(share: np.float32, x: np.ndarray, y: np.ndarray) -> np.float32:
    last, b, part = len(x) - 1, 0, np.float32(0.0)
    while b < last and x[b + 1] < share:
        b += 1
    if b < last and x[b + 1] > x[b]:
        part = min(max((share - x[b]) / (x[b + 1] - x[b]), np.float32(0.0)), np.float32(1.0))
    return np.float32(y[b] + part * (y[min(b + 1, last)] - y[b]) + np.float32(1e-6))


@kernel
def settled(
    low: np.ndarray, high: np.ndarray, known_x: np.ndarray, known_y: np.ndarray, enough: float, out: np.ndarray
) -> None:
    """out (K,) bool: whether the class is known, whatever the shares are between ``low`` and ``high`` (K, C): either
    one class is the likeliest and has a probability of at least ``enough``, or none can have it. The curves do not
    fall."""
    classes = low.shape[1]
    least, most = np.empty(classes, np.float32), np.empty(classes, np.float32)
    for k in range(len(low)):
        for c in range(classes):
            least[c] = _calibrated(low[k, c], known_x[c], known_y[c])
            most[c] = _calibrated(high[k, c], known_x[c], known_y[c])
        best, beaten, hopeless = np.argmax(least), True, True
        for c in range(classes):
            others_least, others_most = np.sum(least) - least[c], np.sum(most) - most[c]
            hopeless &= most[c] < (enough - _ROUNDING) * (most[c] + others_least)
            if c == best:
                beaten &= least[c] > (enough + _ROUNDING) * (least[c] + others_most)
            else:
                beaten &= most[c] < least[best] - _ROUNDING
        out[k] = beaten or hopeless
