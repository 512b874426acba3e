"""Train the forest: clusters -> features -> scikit-learn forest -> plain arrays, calibrated on held-out groups.

Needs the ``train`` extra; only ``train``, ``evaluate`` and ``adapt`` use this module.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier
from sklearn.isotonic import IsotonicRegression
from sklearn.model_selection import GroupKFold

from services.infra_lidar.classification.classes import BACKGROUND, CLASSES
from services.infra_lidar.classification.features import FEATURE_SETS, compute_features
from services.infra_lidar.classification.forest import Forest
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.training.clusters import (
    LabelledClusters,
    join_clusters,
)
from services.infra_lidar.training.folders import expect_classes, read_part
from services.infra_lidar.training.held_out import held_out_table
from services.infra_lidar.training.refine import RefinedForest
from services.infra_lidar.training.scenes import Steps, scene_clusters
from services.infra_lidar.training.varied import generated_clusters
from services.infra_lidar.training.varied_streets import varied_street_clusters

TrainedForest: TypeAlias = RandomForestClassifier | RefinedForest
BODY_WEIGHT = 0.6  # a cluster of a street weighs 1; single bodies do not have the class shares of a street
BACKGROUND_WEIGHT = 0.35  # between whole frames, two thirds background, and a learned scene, nearly none of it
VARIED_SEED = 29_000  # added to the seed for streets of varied bodies, so that no two streets share a layout
_BACKGROUND = 2  # generated fixtures per body of any class: the street has more kinds of things than of road users
_FRAMES, _VIEWS = 2, 3  # of a street and of one with varied bodies


def training_set(
    folder: Path | None, scenes: int, bodies: int, seed: int
) -> tuple[LabelledClusters, np.ndarray, dict[str, Any]]:
    """Clusters, the weight of each (K,), and their provenance for the model's header."""
    if folder:
        clusters = read_part(folder, "train")
        expect_classes(clusters, folder / "train")
        return clusters, np.ones(len(clusters)), {"source": "labelled clusters", "folder": folder.name}
    clusters, weight = generated_set(Steps.of(InfraLidarConfig()), scenes, bodies, seed)
    provenance = {"source": "generated roadside scenes, streets of varied bodies and single bodies"}
    made = {"seed": seed, "scenes": scenes, "bodies": bodies}
    return clusters, weight, {**provenance, **made, "body_weight": BODY_WEIGHT}


def generated_set(steps: Steps, scenes: int, bodies: int, seed: int) -> tuple[LabelledClusters, np.ndarray]:
    """Clusters of ``scenes`` streets, of as many with varied bodies and of single bodies; the weight of each (K,)."""
    varied = range(seed + VARIED_SEED, seed + VARIED_SEED + scenes)
    streets = [scene_clusters(range(seed, seed + scenes), steps, frames=_FRAMES)]
    streets.append(varied_street_clusters(varied, steps, _VIEWS))
    parts = [*streets, generated_clusters(seed, bodies, background=_BACKGROUND)] if bodies else streets
    clusters = join_clusters(parts)
    return clusters, np.where(np.arange(len(clusters)) < sum(map(len, streets)), 1.0, BODY_WEIGHT)


def test_set(folder: Path | None, scenes: int, seed: int) -> LabelledClusters:
    """Clusters of groups that ``training_set`` does not use."""
    if folder:
        return read_part(folder, "test")
    return scene_clusters(range(seed, seed + scenes), Steps.of(InfraLidarConfig()), frames=3)


CALIBRATION_POINTS = 33


@dataclass(frozen=True)
class ForestSettings:
    """Of the forest and its trees; ``max_leaves`` of a tree bounds the file."""

    trees: int = 48
    max_depth: int = 20
    min_leaf: int = 4
    max_leaves: int = 1000
    refined: bool = False  # see ``refine.py``; then many small trees do better than few large ones
    random_cuts: bool = False  # Geurts, Ernst and Wehenkel, "Extremely randomized trees", 2006
    seed: int = 42
    background: float = 1.0  # weight of background in the calibration
    balanced: bool = True  # classes weigh the same in the trees; the calibration undoes it in the probabilities

    def grow(self, x: np.ndarray, labels: np.ndarray, weight: np.ndarray | None) -> TrainedForest:
        """A forest fitted to x (K, F), labels (K,) and weight (K,)."""
        kind = ExtraTreesClassifier if self.random_cuts else RandomForestClassifier
        forest = kind(
            self.trees, max_depth=self.max_depth, min_samples_leaf=self.min_leaf, max_leaf_nodes=self.max_leaves,
            bootstrap=True, class_weight="balanced" if self.balanced else None, random_state=self.seed, n_jobs=1,
        )  # fmt: skip
        return (RefinedForest(forest) if self.refined else forest).fit(x, labels, weight)


GENERATED = ForestSettings(
    trees=144, min_leaf=20, max_leaves=160, refined=True, random_cuts=True, background=BACKGROUND_WEIGHT,
    balanced=False,
)  # fmt: skip
"""For what is learned from generated clusters alone."""


def train_forest(
    clusters: LabelledClusters, feature_set: str, provenance: dict[str, Any], settings: ForestSettings,
    report: Callable[[str], object] | None = None, weight: np.ndarray | None = None,
) -> Forest:  # fmt: skip
    """Fit on all clusters, each of ``weight`` (K,); calibrate with predictions for groups that were left out.

    ``report`` is called with each line of ``held_out_table``.
    """
    names = FEATURE_SETS[feature_set]
    x = compute_features(clusters.points, clusters.offsets, clusters.ground_z_m, names)

    def fit(rows: np.ndarray) -> TrainedForest:
        return settings.grow(x[rows], clusters.labels[rows], None if weight is None else weight[rows])

    held_out = out_of_group_shares(fit, x, clusters.groups)
    expected = expected_weight(clusters.labels, weight, settings.background)
    curve_x, curve_y = calibrate(held_out, clusters.labels, expected)
    if report is not None:
        for line in held_out_table(held_out, curve_x, curve_y, clusters):
            report(line)
    counts = {name: int(np.sum(clusters.labels == c)) for c, name in enumerate(CLASSES)}
    made = {"feature_set": feature_set, "clusters": counts, "trees": settings.trees, "forest_seed": settings.seed}
    made |= {"background_weight": settings.background, "refined": settings.refined, "random_cuts": settings.random_cuts}
    return flatten(fit(np.arange(len(x))), names, curve_x, curve_y, {**provenance, **made})


def out_of_group_shares(fit: Any, x: np.ndarray, groups: np.ndarray, folds: int = 4) -> np.ndarray:
    """(K, C) class shares of every cluster by a forest that was trained without its group.

    fit: makes a fitted scikit-learn forest of the rows whose numbers it gets. x: (K, F). groups: (K,).

    Raises:
        ValueError: all clusters are of one group.
    """
    shares = np.zeros((len(x), len(CLASSES)))
    folds = min(folds, len(np.unique(groups)))
    if folds < 2:
        raise ValueError("training needs clusters of at least two groups")
    for inside, outside in GroupKFold(folds).split(x, groups=groups):
        model = fit(inside)
        shares[np.ix_(outside, model.classes_)] = model.predict_proba(x[outside])
    return shares


def expected_weight(labels: np.ndarray, weight: np.ndarray | None, background: float) -> np.ndarray:
    """(K,) weight of each cluster in the calibration: background counts ``background`` times what it does in the trees.

    The probabilities depend on the class shares, which differ between the training set and a real site.
    """
    return np.where(labels == BACKGROUND, background, 1.0) * (1.0 if weight is None else weight)


def calibrate(
    shares: np.ndarray, labels: np.ndarray, weight: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Per class a rising curve from forest share to frequency, (C, B) each; the identity where a class is missing."""
    grid = np.linspace(0.0, 1.0, CALIBRATION_POINTS)
    curves = np.tile(grid, (len(CLASSES), 1))
    for c in range(len(CLASSES)):
        if np.any(labels == c) and np.any(labels != c):
            line = IsotonicRegression(y_min=0.0, y_max=1.0, out_of_bounds="clip")
            line.fit(shares[:, c], labels == c, weight)
            curves[c] = line.predict(grid)
    return np.tile(grid, (len(CLASSES), 1)).astype(np.float32), curves.astype(np.float32)


def flatten(
    model: TrainedForest, names: tuple[str, ...], curve_x: np.ndarray, curve_y: np.ndarray,
    provenance: dict[str, Any],
) -> Forest:  # fmt: skip
    """The trees of a fitted forest as one set of arrays; curve_x, curve_y (C, B) are its calibration."""
    grown = model.forest if isinstance(model, RefinedForest) else model
    trees = [estimator.tree_ for estimator in grown.estimators_]
    refined = isinstance(model, RefinedForest)
    values = model.scores() if refined else [_shares(tree, grown.classes_) for tree in trees]
    parts = [_flatten_tree(tree, value) for tree, value in zip(trees, values, strict=True)]
    root = np.cumsum([0, *(len(part["left"]) for part in parts)])[:-1]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    first = np.repeat(root, [len(part["left"]) for part in parts])
    value, row = distinct(joined["value"].astype(np.float32))
    return Forest(
        feature=joined["feature"].astype(np.int32),
        threshold=joined["threshold"].astype(np.float32),
        left=(joined["left"] + first).astype(np.int32),
        right=(joined["right"] + first).astype(np.int32),
        leaf=row.astype(np.int32),
        value=value,
        root=root.astype(np.int32),
        calibration_x=curve_x,
        calibration_y=curve_y,
        classes=CLASSES,
        features=names,
        provenance=provenance,
        refined=refined,
    )


def distinct(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The different rows of (L, C), frequent ones first, and (L,) the index of each row among them: many leaves of a
    forest have equal shares, and a small table stays in the caches."""
    rows, which, count = np.unique(value, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(-count, kind="stable")
    return rows[order], np.argsort(order, kind="stable")[which.ravel()]


def _shares(tree: Any, present: np.ndarray) -> np.ndarray:
    """(N, C) class shares in the nodes of one scikit-learn tree; present: (P,) the classes that it knows."""
    shares = np.zeros((tree.node_count, len(CLASSES)))
    counts = tree.value[:, 0]
    shares[:, present] = counts / counts.sum(axis=1, keepdims=True)
    return shares


def _flatten_tree(tree: Any, value: np.ndarray) -> dict[str, np.ndarray]:
    """The nodes of one scikit-learn tree, (N,) each, and their values (N, C); a leaf is its own child."""
    own, leaves = np.arange(tree.node_count), tree.children_left < 0
    return {
        "feature": np.where(leaves, 0, tree.feature),
        # sklearn compares a float32 with a float64 threshold (x <= t): rounding t down keeps every decision.
        "threshold": np.where(leaves, np.inf, _round_down(tree.threshold)),
        "left": np.where(leaves, own, tree.children_left),
        "right": np.where(leaves, own, tree.children_right),
        "value": np.where(leaves[:, None], value, value[leaves][0]),  # those of inner nodes are never read
    }


def _round_down(threshold: np.ndarray) -> np.ndarray:
    """The largest float32 that is not above."""
    near = threshold.astype(np.float32)
    return np.where(near > threshold, np.nextafter(near, np.float32(-np.inf)), near)
