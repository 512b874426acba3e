"""How rows walk down the trees of a forest, and what may come out where one column is left open.

Eight rows go down a tree together, a step each in turn: every step waits for the one before, so the processor works on
those of the others meanwhile. (With vectors, a row a lane, it took twice as long on a Zen 4.)

Where a column is open, a row that came by a node that asks for it walks that tree once more, and at each such node both
ways: on as its number says, and later the other way. So the ends that it could reach are known, and with them between
which bounds its shares lie whatever the number is.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner, kernel
from services.infra_lidar.vectors import LANES, load, prefetch, store

COLUMN_BITS = 8  # so many columns of x, and 2 ** 23 nodes, fit into a word
NO_NUMBER, ROW = np.int32(0x7FC00000), np.int32(0x003FFFFF)  # bits of a float: not a number, and what it may say of it
TOGETHER = 8  # rows
_COLUMN = np.uint32((1 << COLUMN_BITS) - 1)
_ROUNDING = np.float32(1e-3)  # of sums over trees, where a curve is steep
_WORDS_A_LINE = 16  # of a cache line


@kernel
def walk(
    x: np.ndarray, nodes: np.ndarray, limits: np.ndarray, value: np.ndarray, root: np.ndarray, open_column: int,
    queue: np.ndarray | None, out: np.ndarray, low: np.ndarray | None, high: np.ndarray | None,
) -> None:  # fmt: skip
    """Mean class shares (K, C) of the trees into ``out``.

    nodes (2 N,) int32: child and column in one word, then the bits of the threshold, of a leaf those of what is not a
    number, ending in its row of ``value`` (L, C), behind which there is room for a vector; limits: the same as float32.
    The column of a leaf is the open one if a node above it asks for that, else another. The least and most that the
    shares can be, whatever the open column holds, go into ``low`` and ``high`` (K, C); ``queue`` (2, room) int32 needs
    room for ``TOGETHER`` of each node that asks for it, and ``TOGETHER`` more. Without them no column is open, and what
    is done for it is not even compiled.

    All rows walk a tree before the next one is touched: so every node comes from memory once a frame.
    """
    trees, rows, classes = len(root), len(x), value.shape[1]
    here, shares = _numbers(x), value.reshape(value.size)
    width = classes + -classes % LANES  # whole vectors
    total = np.zeros((rows + TOGETHER) * width, np.float32)  # of the trees
    change = np.zeros((2, rows + TOGETHER, classes), np.float32)  # what other ways take off, and add
    at, columns = np.empty(TOGETHER, np.uint32), x.shape[1]
    for tree in range(trees):
        _fetch(nodes, root, tree + 1)
        for first in range(0, rows, TOGETHER):
            _descend(here[first * columns :], columns, nodes, limits, root[tree], at)
            opened = _note(nodes, at, min(TOGETHER, rows - first), root[tree], open_column, queue)
            for k in range(TOGETHER):
                at[k] = (nodes[2 * at[k] + 1] & ROW) * classes  # where its shares begin; those of others follow
                row = (first + k) * width
                for c in range(0, width, LANES):
                    store(total, row + c, load(total, row + c) + load(shares, at[k] + c))
            if queue is not None:
                _add_doubts(
                    here[first * columns :], columns, nodes, limits, shares, classes, at, opened, open_column, queue,
                    change[:, first:],
                )  # fmt: skip
    for k in range(rows):
        for c in range(classes):
            summed = total[k * width + c]
            out[k, c] = summed / np.float32(trees)
            if low is not None and high is not None:
                low[k, c] = (summed + change[0, k, c]) / np.float32(trees)
                high[k, c] = (summed + change[1, k, c]) / np.float32(trees)


@inner
def _numbers(x: np.ndarray) -> np.ndarray:
    """x (K, F) as one row, with room for more; what is not a number counts as 0."""
    here = np.zeros((len(x) + TOGETHER) * x.shape[1], np.float32)
    for k in range(len(x)):
        for column in range(x.shape[1]):
            number = x[k, column]
            here[k * x.shape[1] + column] = number if number == number else np.float32(0.0)
    return here


@inner
def _fetch(nodes: np.ndarray, root: np.ndarray, tree: int) -> None:
    """Bring the nodes of a tree nearer: they are all over memory by the time a frame has gone through it."""
    if tree < len(root):
        end = 2 * root[tree + 1] if tree + 1 < len(root) else len(nodes)
        for at in range(2 * root[tree], end, _WORDS_A_LINE):
            prefetch(nodes, at)


@inline
def _step(here, row, nodes, limits, at):  # type: ignore[no-untyped-def]
    """Where a row goes from a node; from a leaf nowhere."""
    word, place = np.uint32(nodes[2 * at]), 2 * at + np.uint32(1)
    return (word >> np.uint32(COLUMN_BITS)) + np.uint32(here[row + (word & _COLUMN)] > limits[place])


@inline
def _steps(here, n, nodes, limits, a, b, c, d, e, f, g, h):  # type: ignore[no-untyped-def]
    """The same for eight rows of n numbers."""
    return (
        _step(here, np.uint32(0), nodes, limits, a), _step(here, n, nodes, limits, b),
        _step(here, 2 * n, nodes, limits, c), _step(here, 3 * n, nodes, limits, d),
        _step(here, 4 * n, nodes, limits, e), _step(here, 5 * n, nodes, limits, f),
        _step(here, 6 * n, nodes, limits, g), _step(here, 7 * n, nodes, limits, h),
    )  # fmt: skip


@inner
def _descend(here, columns, nodes, limits, root, at):  # type: ignore[no-untyped-def]
    """Walk down a tree with eight rows, to the leaves ``at`` (TOGETHER,) uint32."""
    n = np.uint32(columns)
    a = b = c = d = e = f = g = h = np.uint32(root)
    moved = True
    while moved:  # two steps at a time: asking takes as long as two rows
        a, b, c, d, e, f, g, h = _steps(here, n, nodes, limits, a, b, c, d, e, f, g, h)
        a1, b1, c1, d1, e1, f1, g1, h1 = _steps(here, n, nodes, limits, a, b, c, d, e, f, g, h)
        moved = ((a ^ a1) | (b ^ b1) | (c ^ c1) | (d ^ d1) | (e ^ e1) | (f ^ f1) | (g ^ g1) | (h ^ h1)) != 0
        a, b, c, d, e, f, g, h = a1, b1, c1, d1, e1, f1, g1, h1
    at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7] = a, b, c, d, e, f, g, h


@inner
def _note(nodes, at, rows, root, open_column, queue):  # type: ignore[no-untyped-def]
    """Queue the rows that came by a node that asks for the open column, to begin again; returns how many."""
    opened = 0
    if queue is not None:
        for k in range(rows):
            if (nodes[2 * at[k]] & _COLUMN) == open_column:
                queue[0, opened], queue[1, opened] = k, root
                opened += 1
    return opened


@inner
def _add_doubts(
    here: np.ndarray, columns: int, nodes: np.ndarray, limits: np.ndarray, shares: np.ndarray, classes: int,
    begin: np.ndarray, opened: int, open_column: int, queue: np.ndarray, change: np.ndarray,
) -> None:  # fmt: skip
    """Walk once more, then the ways not taken, and those not taken on them. What an end has less, or more, of a class
    than the one that was reached is added to what can be lost, or won, of it: at most one of a tree's ends is reached,
    so a tree with several is given more doubt than it has, never less."""
    k = 0
    while k < opened:
        row, at = queue[0, k], queue[1, k]
        while True:
            column, following = nodes[2 * at] & ((1 << COLUMN_BITS) - 1), nodes[2 * at] >> COLUMN_BITS
            if following == at:
                break
            right = here[row * columns + column] > limits[2 * at + 1]
            if column == open_column:
                queue[0, opened], queue[1, opened] = row, following + (not right)
                opened += 1
            at = following + right
        leaf = (nodes[2 * at + 1] & ROW) * classes
        for c in range(classes):
            more = shares[leaf + c] - shares[begin[row] + c]
            if more < 0.0:
                change[0, row, c] += more
            else:
                change[1, row, c] += more
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


@kernel
def decide(
    shares: np.ndarray, known_x: np.ndarray, known_y: np.ndarray, enough: float, unknown: int, labels: np.ndarray,
    confidence: np.ndarray,
) -> None:  # fmt: skip
    """``calibrate``, then labels (K,) int64: the likeliest class of each row, ``unknown`` where it has a probability of
    less than ``enough``; confidence (K,) float32: that probability."""
    calibrate(shares, known_x, known_y)
    for k in range(len(shares)):
        best = 0
        for c in range(1, shares.shape[1]):
            if shares[k, c] > shares[k, best]:
                best = c
        confidence[k] = shares[k, best]
        labels[k] = best if confidence[k] >= enough else unknown


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
