"""A random forest as plain arrays: stored in one ``.npz``, run by one compiled kernel, no training library needed.

The two children of a node lie side by side, so a step down is ``child + (x > threshold)``. A leaf is its own child with
an infinite threshold: rows that arrive early wait there, and several walk down a tree in step (``forest_walk.py``).
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from common.config import ConfigError
from services.infra_lidar.forest_walk import COLUMN_BITS, NO_NUMBER, TOGETHER, calibrate, settled, walk
from services.infra_lidar.vectors import LANES

_ARRAYS = ("feature", "threshold", "child", "leaf", "value", "root", "calibration_x", "calibration_y")


class ModelError(ConfigError):
    """The model file is not what it says it is; the text says why."""


@dataclass(frozen=True)
class Forest:
    """N nodes of T trees over F features, L kinds of leaves with shares of C classes, B points of calibration each."""

    feature: np.ndarray  # (N,) int32 column of x
    threshold: np.ndarray  # (N,) float32; goes right if x > threshold
    child: np.ndarray  # (N,) int32 left child, the right one follows; a leaf names itself
    leaf: np.ndarray  # (N,) int32 row of `value`; that of an inner node means nothing
    value: np.ndarray  # (L, C) float32 class shares; leaves that say the same have one row
    root: np.ndarray  # (T,) int32
    calibration_x: np.ndarray  # (C, B) float32 forest share, rising
    calibration_y: np.ndarray  # (C, B) float32 measured frequency
    classes: tuple[str, ...]
    features: tuple[str, ...]
    provenance: dict[str, Any]  # what it was trained on, how, and how well it did

    def shares(self, x: np.ndarray) -> np.ndarray:
        """(K, F) float32 features to (K, C) float32 mean class shares of the trees (uncalibrated)."""
        rows = self._rows(x)
        out = np.empty((len(rows), self.value.shape[1]), np.float32)
        self._walk(rows, -1, None, out, None, None)
        return out

    def settled(self, x: np.ndarray, column: int, enough: float) -> tuple[np.ndarray, np.ndarray]:
        """Which rows have their class without ``column`` of the features being known; its numbers in x are guesses.

        Returns:
            shares (K, C) float32 with the guesses; (K,) bool, whether the likeliest class is the same for every number
            in that column, and always has a probability of at least ``enough``, or none ever has.
        """
        rows = self._rows(x)
        out, low, high = np.zeros((3, len(rows), self.value.shape[1]), np.float32)
        room = TOGETHER * (self._asked.get(column, 0) + 1)
        self._walk(rows, column, np.empty((2, room), np.int32), out, low, high)
        certain = np.empty(len(rows), bool)
        settled(low, high, self.calibration_x, self.calibration_y, enough, certain)
        return out, certain

    def typical(self, column: int) -> float:
        """A number in the middle of what the nodes ask of a column; 0 where none asks."""
        asked = self.threshold[(self.feature == column) & np.isfinite(self.threshold)]
        return float(np.median(asked)) if len(asked) else 0.0

    def _rows(self, x: np.ndarray) -> np.ndarray:
        if x.ndim != 2 or x.shape[1] != len(self.features):
            raise ValueError(f"features: expected shape (K, {len(self.features)}), got {x.shape}")
        return np.ascontiguousarray(x, np.float32)

    def _walk(
        self, rows: np.ndarray, column: int, queue: np.ndarray | None, out: np.ndarray, low: np.ndarray | None,
        high: np.ndarray | None,
    ) -> None:  # fmt: skip
        nodes, limits = self._packed(column)
        walk(rows, nodes, limits, self._value, self.root, column, queue, out, low, high)

    @cached_property
    def _value(self) -> np.ndarray:
        """``value`` with room for a vector behind it."""
        roomy = np.concatenate((self.value.ravel(), np.zeros(LANES, np.float32)))
        return roomy[: self.value.size].reshape(self.value.shape)

    @cached_property
    def _asked(self) -> dict[int, int]:
        """How many nodes ask for a column."""
        columns, counts = np.unique(self.feature[np.isfinite(self.threshold)], return_counts=True)
        return dict(zip(columns.tolist(), counts.tolist(), strict=True))

    def _packed(self, column: int) -> tuple[np.ndarray, np.ndarray]:
        """Nodes as ``walk`` takes them with this column open, eight bytes each: one cache line a step instead of three.
        And the same memory as float32."""
        if column not in self._packs:
            nodes = np.empty((len(self.feature), 2), np.int32)
            leaves = self.child == np.arange(len(self.child))
            other = int(column == 0)
            asked = np.where(leaves, np.where(self._below(column), column, other), self.feature)
            nodes[:, 0] = (self.child << COLUMN_BITS) | asked
            nodes[:, 1] = np.where(leaves, NO_NUMBER | self.leaf, self.threshold.view(np.int32))
            self._packs[column] = nodes.ravel(), nodes.ravel().view(np.float32)
        return self._packs[column]

    @cached_property
    def _packs(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        return {}

    def _below(self, column: int) -> np.ndarray:
        """(N,) bool: nodes with one above them that asks for a column."""
        asks = (self.feature == column) & np.isfinite(self.threshold)
        below, at = np.zeros(len(asks), bool), self.root
        while len(at):  # level by level
            at = at[self.child[at] != at]
            left = self.child[at]
            below[left] = below[left + 1] = below[at] | asks[at]
            at = np.concatenate((left, left + 1))
        return below

    def probabilities(self, x: np.ndarray) -> np.ndarray:
        """(K, C) float32 calibrated probabilities, each row sums to 1."""
        return self.calibrated(self.shares(x))

    def calibrated(self, shares: np.ndarray) -> np.ndarray:
        """Shares (K, C) float32 to probabilities, in place."""
        calibrate(shares, self.calibration_x, self.calibration_y)
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
        """Write what ``load_forest`` reads, with a checksum over all of it."""
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
    if nodes >= 1 << (31 - COLUMN_BITS) or len(forest.features) > 1 << COLUMN_BITS:
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
    if not _are_trees(forest.child, forest.threshold):
        raise ModelError(f"{path}: damaged, nodes do not form trees")
    if not all(np.all(np.diff(curve, axis=1) >= 0) for curve in (forest.calibration_x, forest.calibration_y)):
        raise ModelError(f"{path}: a calibration curve falls; probabilities rise with the share of trees")


def _are_trees(child: np.ndarray, threshold: np.ndarray) -> bool:
    """Whether every walk ends and no two ways lead to one node: children come behind their parents, two by two, each
    pair once; leaves never let a row go right."""
    own = np.arange(len(child))
    inner = child != own
    pairs = np.sort(child[inner])
    return bool(
        np.all(child[inner] > own[inner]) and np.all(np.diff(pairs) >= 2) and np.all(threshold[~inner] == np.inf)
    )
