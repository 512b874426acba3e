"""A random forest as plain arrays: stored in one ``.npz``, run by one compiled loop, no training library needed."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from common.config import ConfigError
from services.infra_lidar.jit import kernel

_ARRAYS = ("feature", "threshold", "left", "right", "leaf", "value", "root", "calibration_x", "calibration_y")
SUFFIX = ".npz"
STEPS = 2  # of a row, before the next row takes its own
_LEAST = 1e-6  # probability of a class that no tree votes for


class ModelError(ConfigError):
    """The model file is not what it says it is; the text says why."""


_NODE = np.dtype([("threshold", "f4"), ("feature", "u4"), ("child", "u4")])


class _Trees(NamedTuple):
    """The nodes as the compiled loop takes them: nodes (N,) of ``_NODE``, so that a step reads one place in memory.

    The right child lies behind the left one, which is ``child``. A leaf is its own child, and nothing is above its
    threshold. leaf: (N,) row of ``value`` of a leaf; those of a tree lie together. Whole numbers are unsigned: of a
    signed index Numba asks each time whether it counts from the end.
    """

    nodes: np.ndarray
    leaf: np.ndarray
    value: np.ndarray
    root: np.ndarray


@dataclass(frozen=True)
class Forest:
    """N nodes of T trees over F features, L kinds of leaves with values of C classes, B points of calibration each.

    A leaf is its own left and right child. Its values are shares of the classes, or scores if the forest is refined.
    """

    feature: np.ndarray  # (N,) int32 column of x
    threshold: np.ndarray  # (N,) float32; goes right if x > threshold
    left: np.ndarray  # (N,) int32 node
    right: np.ndarray  # (N,) int32 node
    leaf: np.ndarray  # (N,) int32 row of `value`; 0 at an inner node
    value: np.ndarray  # (L, C) float32; leaves with equal values have one row
    root: np.ndarray  # (T,) int32 first node of each tree
    calibration_x: np.ndarray  # (C, B) float32 forest share, rising
    calibration_y: np.ndarray  # (C, B) float32 measured frequency
    classes: tuple[str, ...]
    features: tuple[str, ...]
    provenance: dict[str, Any]  # what it was trained on, how, and how well it did
    refined: bool = False  # see ``training/refine.py``

    @cached_property
    def _trees(self) -> _Trees:
        order, child, root = _siblings_together(self.left, self.right, self.root)
        nodes = np.empty(len(order), _NODE)
        nodes["feature"], nodes["child"] = self.feature[order], child
        is_leaf = child == np.arange(len(order))
        nodes["threshold"] = np.where(is_leaf, np.inf, self.threshold[order])
        leaves_before = np.cumsum(is_leaf) - is_leaf
        return _Trees(nodes, leaves_before.astype(np.uint32), self.value[self.leaf[order[is_leaf]]], root)

    def shares(self, x: np.ndarray) -> np.ndarray:
        """(K, F) float32 features to (K, C) float32 class shares (uncalibrated): the mean of the trees' shares, or the
        softmax of the sum of their scores.

        A feature that is not a number counts as 0. Raises ``ValueError`` on another number of columns.
        """
        if x.ndim != 2 or x.shape[1] != len(self.features):
            raise ValueError(f"features: expected shape (K, {len(self.features)}), got {x.shape}")
        rows = np.where(np.isnan(x), np.float32(0.0), x).astype(np.float32, order="C")
        out = np.zeros((len(rows), self.value.shape[1]), np.float32)
        _sum_values(rows, self._trees, out)
        if not self.refined:
            return out / np.float32(len(self.root))
        odds = np.exp(out - out.max(axis=1, keepdims=True))
        return np.asarray(odds / odds.sum(axis=1, keepdims=True))

    def class_probabilities(self, x: np.ndarray) -> np.ndarray:
        """(K, F) features to (K, C) float32 calibrated probabilities, each row sums to 1."""
        return calibrated(self.shares(x), self.calibration_x, self.calibration_y)

    @property
    def digest(self) -> str:
        """SHA-256 over every array, class and feature name."""
        names = [self.classes, self.features, *(["refined"] if self.refined else [])]
        total = hashlib.sha256(json.dumps(names).encode())
        for name in _ARRAYS:
            array = getattr(self, name)
            total.update(f"{name} {array.dtype.str} {array.shape}".encode() + array.tobytes())
        return total.hexdigest()

    def save(self, path: Path) -> None:
        """Write what ``load_forest`` reads, with a checksum over all of it, under exactly this name.

        Raises:
            OSError: it cannot be written; a file of that name stays as it was.
        """
        header = {
            "classes": self.classes,
            "features": self.features,
            "refined": self.refined,
            "provenance": self.provenance,
            "sha256": self.digest,
        }
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        part = path.with_name(f"{path.name}.tmp")
        try:
            with part.open("wb") as file:  # of a name alone NumPy would make another where it has no ``.npz``
                np.savez_compressed(file, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)
            part.replace(path)  # never half a model: this may be the one in use
        finally:
            part.unlink(missing_ok=True)


def _siblings_together(
    left: np.ndarray, right: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes tree by tree, level by level, so that the right child of each follows the left one.

    left, right: (N,) children of each node, as in ``Forest``; root: (T,). Returns order (N,), which node comes at each
    place, child (N,) uint32, the place of its left child, of a leaf its own, and the places of the roots (T,) uint32.
    """
    order: list[int] = []
    child: list[int] = []
    roots = []
    for first in root.tolist():
        roots.append(len(order))
        order.append(first)
        for place in range(roots[-1], len(left)):
            if place == len(order):
                break  # the tree ends here
            node = order[place]
            is_leaf = left[node] == node
            child.append(place if is_leaf else len(order))
            order += [] if is_leaf else [left[node], right[node]]
    return np.array(order), np.array(child, np.uint32), np.array(roots, np.uint32)


def calibrated(shares: np.ndarray, curve_x: np.ndarray, curve_y: np.ndarray) -> np.ndarray:
    """(K, C) class shares of the trees to probabilities of the same type, each row sums to 1.

    curve_x, curve_y: (C, B) forest share, rising, and measured frequency of each class.
    """
    out = np.empty_like(shares)
    for c in range(shares.shape[1]):
        out[:, c] = np.interp(shares[:, c], curve_x[c], curve_y[c]) + _LEAST
    return np.asarray(out / out.sum(axis=1, keepdims=True))


@kernel
def _sum_values(x: np.ndarray, trees: _Trees, out: np.ndarray) -> None:
    """Add the values of each tree's leaf to out (K, C).

    All rows take ``STEPS`` steps before any takes the next: the steps of different rows do not depend on each other, so
    the processor overlaps them. Rows that are at a leaf leave the list of those that walk.
    """
    rows, width, values = np.uint32(len(x)), np.uint32(x.shape[1]), x.reshape(-1)
    node, walking = np.empty(rows, np.uint32), np.empty(rows, np.uint32)
    for root in trees.root:
        for k in range(rows):
            node[k], walking[k] = root, k
        left = rows
        while left > 0:
            still = np.uint32(0)
            for j in range(left):
                k = walking[j]
                at = last = node[k]
                for _ in range(STEPS):
                    last, here = at, trees.nodes[at]
                    at = here.child + np.uint32(values[k * width + here.feature] > here.threshold)
                node[k], walking[still] = at, k
                still += np.uint32(at != last)
            left = still
        for k in range(rows):
            for c in range(out.shape[1]):
                out[k, c] += trees.value[trees.leaf[node[k]], c]


def load_forest(path: Path) -> Forest:
    """Read and check a model.

    Raises:
        ModelError: not a model, an older layout, damaged, or its arrays point outside of themselves.
    """
    try:
        forest, sha256 = _read(path)
        digest = forest.digest
    except FileNotFoundError:
        raise ModelError(f"{path}: no such model file") from None
    except ModelError:
        raise
    except Exception as error:  # noqa: BLE001 - zip, zlib, NumPy and JSON each have errors of their own for damage
        raise ModelError(f"{path}: not a forest written by `spotter-infra-lidar train`: {error}") from None
    if digest != sha256:
        raise ModelError(f"{path}: damaged, its contents do not match their SHA-256")
    _check(forest, path)
    return forest


def _read(path: Path) -> tuple[Forest, str]:
    """The forest in a file, not yet checked, and the SHA-256 that it states."""
    with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        header = json.loads(file["header"].tobytes())
        if "child" in file.files:
            raise ModelError(f"{path}: a model of an older layout; train it again with `spotter-infra-lidar train`")
        arrays = {name: file[name] for name in _ARRAYS}
    forest = Forest(
        **arrays,
        classes=tuple(header["classes"]),
        features=tuple(header["features"]),
        provenance=dict(header["provenance"]),
        refined=bool(header.get("refined", False)),
    )
    return forest, header["sha256"]


def _check(forest: Forest, path: Path) -> None:
    nodes, leaves = len(forest.feature), len(forest.value)
    sound = (
        all(np.all((array >= 0) & (array < nodes)) for array in (forest.left, forest.right, forest.root))
        and np.all((forest.feature >= 0) & (forest.feature < len(forest.features)))
        and np.all((forest.leaf >= 0) & (forest.leaf < leaves))
        and forest.value.shape[1] == len(forest.classes) == len(forest.calibration_x) == len(forest.calibration_y)
    )
    if not sound:
        raise ModelError(f"{path}: damaged, nodes point outside of the forest")
    if not _are_trees(forest):
        raise ModelError(f"{path}: damaged, nodes do not form trees")
    if not all(np.all(np.diff(curve, axis=1) >= 0) for curve in (forest.calibration_x, forest.calibration_y)):
        raise ModelError(f"{path}: a calibration curve falls; probabilities rise with the share of trees")


def _are_trees(forest: Forest) -> bool:
    """Whether every walk ends and no two ways lead to one node: children come behind their parents, each once."""
    own = np.arange(len(forest.left))
    inner = (forest.left != own) | (forest.right != own)
    children = np.concatenate((forest.left[inner], forest.right[inner]))
    behind = np.all(forest.left[inner] > own[inner]) and np.all(forest.right[inner] > own[inner])
    return bool(behind and len(np.unique(children)) == len(children) and not np.any(np.isin(children, forest.root)))
