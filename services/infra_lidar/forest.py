"""A random forest as plain arrays: stored in one ``.npz``, run by one compiled kernel, no training library needed.

The two children of a node lie side by side, so a step down is ``child + (x > threshold)``. A leaf is its own child with
an infinite threshold: rows that arrive early wait there, and all lanes of a vector walk down a tree in lock step.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

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
    unbits,
)

_COLUMN_BITS = 8  # so many columns of x, and 2 ** 23 nodes, fit into a word
_TREES = 4  # that are walked together: each waits for memory at every step
_ARRAYS = ("feature", "threshold", "child", "leaf", "value", "root", "depth", "calibration_x", "calibration_y")


class ModelError(ValueError):
    """The model file is not what it says it is; the text says why."""


@dataclass(frozen=True)
class Forest:
    """N nodes of T trees over F features, L leaves with C class shares each, B points of calibration per class."""

    feature: np.ndarray  # (N,) int32 column of x
    threshold: np.ndarray  # (N,) float32; goes right if x > threshold
    child: np.ndarray  # (N,) int32 left child, the right one follows; a leaf names itself
    leaf: np.ndarray  # (N,) int32 row of `value`, 0 for inner nodes
    value: np.ndarray  # (L, C) float32 class shares
    root: np.ndarray  # (T,) int32
    depth: np.ndarray  # (T,) int32
    calibration_x: np.ndarray  # (C, B) float32 forest share, rising
    calibration_y: np.ndarray  # (C, B) float32 measured frequency
    classes: tuple[str, ...]
    features: tuple[str, ...]
    provenance: dict[str, Any]  # what it was trained on, how, and how well it did

    def shares(self, x: np.ndarray) -> np.ndarray:
        """(K, F) float32 features to (K, C) float32 mean class shares of the trees (uncalibrated)."""
        if x.ndim != 2 or x.shape[1] != len(self.features):
            raise ValueError(f"features: expected shape (K, {len(self.features)}), got {x.shape}")
        rows = np.ascontiguousarray(x, np.float32)
        out = np.zeros((len(rows), self.value.shape[1]), np.float32)
        _walk(rows, self._packed, self.leaf, self.value, self.root, self.depth, out)
        return out

    @cached_property
    def _packed(self) -> np.ndarray:
        """Nodes as eight bytes each, (N, 2) int32: child and column in one word, then the bits of the threshold. One
        cache line a step instead of three."""
        nodes = np.empty((len(self.feature), 2), np.int32)
        nodes[:, 0] = (self.child << _COLUMN_BITS) | self.feature
        nodes[:, 1] = self.threshold.view(np.int32)
        return nodes

    def probabilities(self, x: np.ndarray) -> np.ndarray:
        """(K, C) float32 calibrated probabilities, each row sums to 1."""
        shares = self.shares(x)
        _calibrate(shares, self.calibration_x, self.calibration_y)
        return shares

    @property
    def digest(self) -> str:
        """SHA-256 over every array, class and feature name."""
        total = hashlib.sha256(json.dumps([self.classes, self.features]).encode())
        for name in _ARRAYS:
            array = getattr(self, name)
            total.update(f"{name} {array.dtype.str} {array.shape}".encode() + array.tobytes())
        return total.hexdigest()

    def save(self, path: Path) -> None:
        header = {
            "classes": self.classes,
            "features": self.features,
            "provenance": self.provenance,
            "sha256": self.digest,
        }
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        np.savez_compressed(path, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)


def load_forest(path: Path) -> Forest:
    """Read and check a model.

    Raises:
        ModelError: not a model, damaged, or its arrays point outside of themselves.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(file["header"].tobytes())
            arrays = {name: file[name] for name in _ARRAYS}
        forest = Forest(
            **arrays,
            classes=tuple(header["classes"]),
            features=tuple(header["features"]),
            provenance=header["provenance"],
        )
    except FileNotFoundError:
        raise ModelError(f"{path}: no such model file") from None
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise ModelError(f"{path}: not a forest written by `spotter-infra-lidar train`: {error}") from None
    if forest.digest != header["sha256"]:
        raise ModelError(f"{path}: damaged, its contents do not match their SHA-256")
    _check(forest, path)
    return forest


def _check(forest: Forest, path: Path) -> None:
    nodes, leaves = len(forest.feature), len(forest.value)
    inner = forest.child != np.arange(nodes)
    if nodes >= 1 << (31 - _COLUMN_BITS) or len(forest.features) > 1 << _COLUMN_BITS:
        raise ModelError(f"{path}: too large, {nodes} nodes over {len(forest.features)} features")
    sound = (
        forest.child.min(initial=0) >= 0
        and np.all(forest.child[inner] < nodes - 1)
        and np.all((forest.feature >= 0) & (forest.feature < len(forest.features)))
        and np.all((forest.leaf >= 0) & (forest.leaf < leaves))
        and np.all((forest.root >= 0) & (forest.root < nodes))
        and forest.value.shape[1] == len(forest.classes) == len(forest.calibration_x) == len(forest.calibration_y)
    )
    if not sound:
        raise ModelError(f"{path}: damaged, nodes point outside of the forest")


@kernel
def _walk(
    x: np.ndarray, nodes: np.ndarray, leaf: np.ndarray, value: np.ndarray, root: np.ndarray, depth: np.ndarray,
    out: np.ndarray,
) -> None:  # fmt: skip
    trees, rows, columns = len(root), len(x), x.shape[1]
    classes, shares = value.shape[1], value.reshape(value.size)
    total = np.zeros(classes * LANES, np.float32)
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
            _descend(here, nodes, deepest, node, number)
            for at in range(0, number * LANES, LANES):
                store(node, at, gather_listed(leaf, node, at) * np.int32(classes))  # where their shares begin
                _add_shares(shares, node, at, classes, total)
        for lane in range(taken):
            for c in range(classes):
                out[start + lane, c] = total[c * LANES + lane] / np.float32(trees)


@inner
def _take_rows(x: np.ndarray, here: np.ndarray) -> None:
    """Rows to lanes; what is not a number counts as 0."""
    for lane in range(len(x)):
        for column in range(x.shape[1]):
            number = x[lane, column]
            here[column * LANES + lane] = number if number == number else np.float32(0.0)


@inline
def _descend(here, nodes, depth, node, trees):  # type: ignore[no-untyped-def]
    """Walk down some trees with all lanes at once. node (_TREES * LANES,) int32, where they begin and end."""
    mask, own = np.int32((1 << _COLUMN_BITS) - 1), lanes()
    for _ in range(depth):
        moved = np.int32(0)
        for t in range(0, trees * LANES, LANES):
            word, threshold = gather_pairs(nodes, node, t)
            right = gather(here, (word & mask) * np.int32(LANES) + own) > unbits(threshold)
            following = (word >> np.int32(_COLUMN_BITS)) + ones(right)
            moved += lane_count(following != load(node, t))
            store(node, t, following)
        if moved == 0:  # all of them have arrived
            break


@inline
def _add_shares(shares, begin, at, classes, total):  # type: ignore[no-untyped-def]
    for c in range(classes):
        store(total, c * LANES, load(total, c * LANES) + gather_listed(shares[c:], begin, at))


@kernel
def _calibrate(shares: np.ndarray, known_x: np.ndarray, known_y: np.ndarray) -> None:
    """Forest shares (K, C) to probabilities, in place: interpolated between the measured points, summing to 1."""
    last = known_x.shape[1] - 1
    for k in range(len(shares)):
        total = np.float32(0.0)
        for c in range(shares.shape[1]):
            x, y, share, b = known_x[c], known_y[c], shares[k, c], 0
            while b < last and x[b + 1] < share:
                b += 1
            part = np.float32(0.0)
            if b < last and x[b + 1] > x[b]:
                part = min(max((share - x[b]) / (x[b + 1] - x[b]), np.float32(0.0)), np.float32(1.0))
            shares[k, c] = y[b] + part * (y[min(b + 1, last)] - y[b]) + np.float32(1e-6)
            total += shares[k, c]
        for c in range(shares.shape[1]):
            shares[k, c] /= total
