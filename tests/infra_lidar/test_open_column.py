"""A class that does not hang on a column is the same for every number in it, tried one by one; and so is the classifier
that does without the search for neighbours where it can."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("sklearn", reason="needs the train extra")

from sklearn.ensemble import RandomForestClassifier

from services.infra_lidar.classes import CLASSES, UNKNOWN
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.config import ClassifierConfig
from services.infra_lidar.features import FEATURE_SETS, compute_features, compute_spacing, may_wait
from services.infra_lidar.forest import Forest
from services.infra_lidar.train import flatten, train_forest
from services.infra_lidar.training_clusters import generated_clusters

WITH_SPACING = ("z_range", "z_std", "nn_dist_std", "density", "xy_area")


@lru_cache(maxsize=8)
def _forest(seed: int, weight: float) -> Forest:
    """Five features of which the third says as much as ``weight``, and calibration curves of all kinds."""
    rng = np.random.default_rng(seed)
    x = rng.normal(0, 1, (500, 5))
    said = x @ np.array([1.0, -1.0, weight, 0.5, 0.0]) + rng.normal(0, 0.3, 500)
    model = RandomForestClassifier(
        17, max_depth=8, min_samples_leaf=3, random_state=seed, n_jobs=1,
    ).fit(x.astype(np.float32), np.digitize(said, [-1.5, -0.5, 0.5, 1.5]))  # fmt: skip
    curve_x = np.tile(np.linspace(0, 1, 9, dtype=np.float32), (5, 1))
    return flatten(model, WITH_SPACING, curve_x, np.sort(rng.uniform(0, 1, (5, 9)).astype(np.float32)), {})


def _decided(forest: Forest, x: np.ndarray, enough: float) -> np.ndarray:
    probabilities = forest.probabilities(x)
    return np.where(probabilities.max(axis=1) >= enough, probabilities.argmax(axis=1), UNKNOWN)


@given(
    seed=st.integers(0, 3), weight=st.sampled_from([0.0, 0.3, 2.0]), column=st.integers(0, 4),
    enough=st.sampled_from([0.0, 0.3, 0.45, 0.6, 1.0]), rows=st.integers(1, 40),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_a_settled_class_is_the_same_for_every_number(
    seed: int, weight: float, column: int, enough: float, rows: int
) -> None:
    forest = _forest(seed, weight)
    x = np.random.default_rng(rows).normal(0, 1.5, (rows, 5)).astype(np.float32)
    shares, certain = forest.settled(x, column, enough)
    np.testing.assert_array_equal(shares, forest.shares(x))
    wanted = _decided(forest, x, enough)
    asked = np.unique(forest.threshold[(forest.feature == column) & np.isfinite(forest.threshold)])
    for number in (*asked, np.float32(1e9)):  # a number on a threshold goes left: one for each way through all trees
        x[:, column] = number
        got = _decided(forest, x, enough)
        np.testing.assert_array_equal(got[certain], wanted[certain])


def test_few_classes_hang_on_what_says_little() -> None:
    x = np.random.default_rng(9).normal(0, 1.5, (400, 5)).astype(np.float32)
    little, much = (_forest(1, weight).settled(x, 2, 0.0)[1].mean() for weight in (0.0, 2.0))
    assert little > 0.5 > 0.2 > much


def test_a_column_that_nobody_asks_settles_everything() -> None:
    asked = _forest(1, 0.3)
    forest = replace(asked, feature=np.where(asked.feature == 4, 3, asked.feature).astype(np.int32))
    x = np.random.default_rng(9).normal(0, 1.5, (50, 5)).astype(np.float32)
    clear = np.ptp(np.sort(forest.probabilities(x), axis=1)[:, -2:], axis=1) > 0.01
    assert clear.any()
    assert np.all(forest.settled(x, 4, 0.0)[1][clear])
    assert forest.typical(4) == 0.0


@pytest.fixture(scope="module")
def trained() -> Forest:
    return train_forest(generated_clusters(seed=5, per_class=40), "23", {"source": "test"}, trees=40, max_leaves=40)


@pytest.mark.parametrize("enough", [0.0, 0.45, 0.9])
def test_classes_are_those_of_all_features_but_spacing_is_seldom_needed(trained: Forest, enough: float) -> None:
    classifier = Classifier(ClassifierConfig(min_confidence=enough), trained)
    fresh = generated_clusters(seed=6, per_class=40)
    points, offsets, road_z_m = fresh.points, fresh.offsets, fresh.ground_z_m
    whole = compute_features(points, offsets, road_z_m, FEATURE_SETS["23"])
    labels, confidence, _ = classifier.classify(whole)
    x, got, about, _ = classifier.recognise(np.ascontiguousarray(points.T), offsets, road_z_m)
    np.testing.assert_array_equal(got, labels)
    np.testing.assert_allclose(about, confidence, atol=0.2)
    column = FEATURE_SETS["23"].index("nn_dist_std")
    np.testing.assert_array_equal(np.delete(x, column, axis=1), np.delete(whole, column, axis=1))
    searched = x[:, column] == whole[:, column]
    assert 0 < searched.sum() < 0.5 * len(fresh)
    assert len(set(labels)) > (1 if enough == 0.9 else 3)
    assert set(labels) <= {*range(len(CLASSES)), UNKNOWN}


def test_the_spacing_of_some_clusters_is_that_of_all() -> None:
    clusters = generated_clusters(seed=4, per_class=4)
    every = compute_features(clusters.points, clusters.offsets, clusters.ground_z_m, ("nn_dist_std",))[:, 0]
    planar = np.ascontiguousarray(clusters.points.T)
    which = np.array([0, 5, 7, 19])
    np.testing.assert_array_equal(compute_spacing(planar, clusters.offsets, which), every[which])
    assert len(compute_spacing(planar, clusters.offsets, which[:0])) == 0
    assert np.all(every[which] > 0)


def test_spacing_waits_only_where_no_other_feature_needs_the_search() -> None:
    assert [name for name in FEATURE_SETS if may_wait(FEATURE_SETS[name])] == ["23"]
