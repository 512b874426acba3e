"""Train the forest: clusters -> features -> scikit-learn forest -> plain arrays, calibrated on held-out groups.

Needs the ``train`` extra; nothing at run time imports this module.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from sklearn.ensemble import RandomForestClassifier
from sklearn.isotonic import IsotonicRegression
from sklearn.model_selection import GroupKFold

from services.infra_lidar.classes import CLASSES
from services.infra_lidar.features import FEATURE_SETS, compute_features
from services.infra_lidar.forest import Forest
from services.infra_lidar.training_clusters import LabelledClusters

CALIBRATION_POINTS = 33


def train_forest(
    clusters: LabelledClusters, feature_set: str, provenance: dict[str, Any], *,
    trees: int = 100, max_depth: int = 20, min_leaf: int = 5, max_leaves: int | None = None, seed: int = 42,
) -> Forest:  # fmt: skip
    """Fit on all clusters; calibrate with predictions for groups that were left out.

    The article's settings are the defaults (100 trees, depth 20, 5 samples a leaf, balanced weights, seed 42);
    ``max_leaves`` per tree bounds the file.
    """
    names = FEATURE_SETS[feature_set]
    x = compute_features(clusters.points, clusters.offsets, clusters.ground_z_m, names)

    def fit(rows: np.ndarray) -> RandomForestClassifier:
        model = RandomForestClassifier(
            trees, max_depth=max_depth, min_samples_leaf=min_leaf, max_leaf_nodes=max_leaves,
            class_weight="balanced", random_state=seed, n_jobs=1,
        )  # fmt: skip
        return model.fit(x[rows], clusters.labels[rows])

    held_out = out_of_group_shares(fit, x, clusters)
    curve_x, curve_y = calibrate(held_out, clusters.labels)
    counts = {name: int(np.sum(clusters.labels == c)) for c, name in enumerate(CLASSES)}
    story = {**provenance, "feature_set": feature_set, "clusters": counts, "trees": trees, "seed": seed}
    return flatten(fit(np.arange(len(x))), names, curve_x, curve_y, story)


def out_of_group_shares(fit: Any, x: np.ndarray, clusters: LabelledClusters, folds: int = 4) -> np.ndarray:
    """(K, C) class shares of every cluster by a forest that saw nothing of its group."""
    shares = np.zeros((len(x), len(CLASSES)))
    folds = min(folds, len(np.unique(clusters.groups)))
    if folds < 2:
        raise ValueError("training needs clusters of at least two groups")
    for inside, outside in GroupKFold(folds).split(x, groups=clusters.groups):
        model = fit(inside)
        shares[np.ix_(outside, model.classes_)] = model.predict_proba(x[outside])
    return shares


def calibrate(shares: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Per class a rising curve from forest share to frequency, (C, B) each; the identity where a class is missing."""
    grid = np.linspace(0.0, 1.0, CALIBRATION_POINTS)
    curves = np.tile(grid, (len(CLASSES), 1))
    for c in range(len(CLASSES)):
        if np.any(labels == c) and np.any(labels != c):
            line = IsotonicRegression(y_min=0.0, y_max=1.0, out_of_bounds="clip").fit(shares[:, c], labels == c)
            curves[c] = line.predict(grid)
    return np.tile(grid, (len(CLASSES), 1)).astype(np.float32), curves.astype(np.float32)


def flatten(
    model: RandomForestClassifier, names: tuple[str, ...], curve_x: np.ndarray, curve_y: np.ndarray,
    provenance: dict[str, Any],
) -> Forest:  # fmt: skip
    """The trees of a fitted forest as one set of arrays, children side by side."""
    parts = [_flatten_tree(estimator.tree_, model.classes_) for estimator in model.estimators_]
    node_starts = np.cumsum([0, *(len(part["child"]) for part in parts)])
    leaf_starts = np.cumsum([0, *(len(part["value"]) for part in parts)])
    leaf = np.concatenate([p["leaf"] + s for p, s in zip(parts, leaf_starts[:-1], strict=True)])
    value, row = distinct(np.concatenate([p["value"] for p in parts]).astype(np.float32))
    return Forest(
        feature=np.concatenate([p["feature"] for p in parts]).astype(np.int32),
        threshold=np.concatenate([p["threshold"] for p in parts]).astype(np.float32),
        child=np.concatenate([p["child"] + s for p, s in zip(parts, node_starts[:-1], strict=True)]).astype(np.int32),
        leaf=row[leaf].astype(np.int32),
        value=value,
        root=node_starts[:-1].astype(np.int32),
        calibration_x=curve_x,
        calibration_y=curve_y,
        classes=CLASSES,
        features=names,
        provenance=provenance,
    )


def distinct(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rows of (L, C) that differ, frequent ones first, and (L,) which of them each is: most leaves of a forest say
    what many others say, too, and what is small stays in the caches."""
    rows, which, count = np.unique(value, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(-count, kind="stable")
    return rows[order], np.argsort(order, kind="stable")[which.ravel()]


def _flatten_tree(tree: Any, present: np.ndarray) -> dict[str, Any]:
    """Breadth first, so that siblings are neighbours; leaves name themselves and have an infinite threshold."""
    order, position = [0], {0: 0}
    for node in order:
        if tree.children_left[node] >= 0:
            for child in (tree.children_left[node], tree.children_right[node]):
                position[child] = len(order)
                order.append(child)
    index = np.array(order)
    leaves = tree.children_left[index] < 0
    child = np.array([position.get(tree.children_left[node], i) for i, node in enumerate(order)])
    value = np.zeros((int(leaves.sum()), len(CLASSES)))
    counts = tree.value[index[leaves], 0]
    value[:, present] = counts / counts.sum(axis=1, keepdims=True)
    return {
        "feature": np.where(leaves, 0, tree.feature[index]),
        # sklearn compares a float32 with a float64 threshold (x <= t): rounding t down keeps every decision.
        "threshold": np.where(leaves, np.inf, _round_down(tree.threshold[index])),
        "child": child,
        "leaf": np.where(leaves, np.cumsum(leaves) - 1, 0),
        "value": value,
    }


def _round_down(threshold: np.ndarray) -> np.ndarray:
    """The largest float32 that is not above."""
    near = threshold.astype(np.float32)
    return np.where(near > threshold, np.nextafter(near, np.float32(-np.inf)), near)
