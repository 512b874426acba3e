"""Training end to end on a few generated clusters; the arrays against scikit-learn; folders in the article's layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sklearn", reason="needs the train extra")

from sklearn.ensemble import RandomForestClassifier

from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.classification.features import ARTICLE_19, FEATURE_SETS, compute_features
from services.infra_lidar.training.clusters import (
    LabelledClusters,
    collect,
    join_clusters,
)
from services.infra_lidar.training.folders import read_folder
from services.infra_lidar.training.train import (
    ForestSettings,
    calibrate,
    distinct,
    flatten,
    out_of_group_shares,
    train_forest,
)
from services.infra_lidar.training.varied import generated_clusters


@pytest.fixture(scope="module")
def clusters() -> LabelledClusters:
    return generated_clusters(seed=5, per_class=30)


def test_the_arrays_decide_exactly_as_scikit_learn() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(0, 1, (600, 6)).astype(np.float32)
    y = (x[:, 0] + x[:, 1] ** 2 > 0.5).astype(int) + 2 * (x[:, 2] > 0)
    model = RandomForestClassifier(20, min_samples_leaf=2, random_state=1, n_jobs=1).fit(x, y)
    curve = np.tile(np.linspace(0, 1, 5, dtype=np.float32), (5, 1))
    forest = flatten(model, ARTICLE_19[:6], curve, curve, {})
    fresh = np.concatenate((rng.normal(0, 2, (500, 6)).astype(np.float32), x))
    shares = forest.shares(fresh)
    np.testing.assert_allclose(shares[:, :4], model.predict_proba(fresh), atol=1e-6)
    assert np.all(shares[:, 4] == 0)  # a class that was not in the training data


@pytest.mark.parametrize("present", [(0, 1, 2, 3), (1, 4)])
def test_a_refined_forest_decides_as_the_regression_over_its_leaves(present: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(0, 1, (600, 6)).astype(np.float32)
    kind = (x[:, 0] + x[:, 1] ** 2 > 0.5).astype(int) + 2 * (x[:, 2] > 0)
    y = np.array(present)[kind % len(present)]
    settings = ForestSettings(trees=20, max_leaves=12, refined=True, balanced=False)
    model = settings.grow(x, y, rng.uniform(0.5, 1.0, 600))
    curve = np.tile(np.linspace(0, 1, 5, dtype=np.float32), (5, 1))
    forest = flatten(model, ARTICLE_19[:6], curve, curve, {})
    fresh = rng.normal(0, 2, (500, 6)).astype(np.float32)
    shares = forest.shares(fresh)
    np.testing.assert_allclose(shares[:, present], model.predict_proba(fresh), atol=1e-5)
    absent = [c for c in range(len(CLASSES)) if c not in present]
    assert np.all(shares[:, absent] == 0)


def test_refining_small_trees_makes_them_better(clusters: LabelledClusters) -> None:
    x = compute_features(clusters.points, clusters.offsets, clusters.ground_z_m, FEATURE_SETS["shape"])
    fresh = generated_clusters(seed=6, per_class=60)
    new = compute_features(fresh.points, fresh.offsets, fresh.ground_z_m, FEATURE_SETS["shape"])
    right = {}
    for refined in (False, True):
        model = ForestSettings(trees=60, max_leaves=12, refined=refined, balanced=False).grow(x, clusters.labels, None)
        right[refined] = np.mean(model.predict_proba(new).argmax(axis=1) == fresh.labels)
    assert right[True] > right[False]


def test_equal_leaves_share_a_row_and_the_frequent_come_first() -> None:
    rows, which = distinct(np.array([[0, 1], [1, 0], [0.5, 0.5], [1, 0], [0.5, 0.5], [1, 0]], np.float32))
    np.testing.assert_array_equal(rows, [[1, 0], [0.5, 0.5], [0, 1]])
    np.testing.assert_array_equal(which, [2, 0, 1, 0, 1, 0])


def test_values_on_a_threshold_go_the_same_way() -> None:
    x = np.repeat(np.arange(8, dtype=np.float32)[:, None] / 3, 4, axis=0)
    model = RandomForestClassifier(10, random_state=1, n_jobs=1).fit(x, (x[:, 0] > 1).astype(int))
    curve = np.tile(np.linspace(0, 1, 5, dtype=np.float32), (5, 1))
    forest = flatten(model, ("z_range",), curve, curve, {})
    edges = np.concatenate([tree.tree_.threshold for tree in model.estimators_]).astype(np.float32)[:, None]
    np.testing.assert_allclose(forest.shares(edges)[:, :2], model.predict_proba(edges), atol=1e-6)


def test_a_small_forest_learns_the_generated_bodies(clusters: LabelledClusters, tmp_path: Path) -> None:
    forest = train_forest(clusters, "shape", {"source": "test"}, ForestSettings(trees=15, max_leaves=60))
    counts = np.bincount(clusters.labels, minlength=len(CLASSES)).tolist()
    assert sum(counts) == 30 * len(CLASSES)
    assert all(abs(count - 30) <= 2 for count in counts)  # an animal is labelled by lot
    assert forest.provenance["clusters"] == dict(zip(CLASSES, counts, strict=True))
    fresh = generated_clusters(seed=6, per_class=20)
    x = compute_features(fresh.points, fresh.offsets, fresh.ground_z_m, forest.features)
    assert np.mean(forest.class_probabilities(x).argmax(axis=1) == fresh.labels) > 0.6  # hard on purpose; by lot: 0.2
    again = train_forest(clusters, "shape", {"source": "test"}, ForestSettings(trees=15, max_leaves=60))
    assert again.digest == forest.digest


def test_held_out_shares_never_come_from_the_same_group(clusters: LabelledClusters) -> None:
    x = np.zeros((len(clusters), 1))
    groups = clusters.groups // 3
    seen: list[np.ndarray] = []

    class Spy:
        classes_ = np.arange(5)

        def __init__(self, rows: np.ndarray) -> None:
            seen.append(rows)

        def predict_proba(self, rows: np.ndarray) -> np.ndarray:
            return np.full((len(rows), 5), 0.2)

    out_of_group_shares(Spy, x, groups)
    for inside in seen:
        outside = np.setdiff1d(np.arange(len(x)), inside)
        assert not set(groups[inside]) & set(groups[outside])


def test_calibration_turns_shares_into_frequencies() -> None:
    """A forest that says 0.8 and is right in half of the cases must say 0.5 afterwards."""
    labels = np.tile([1, 2], 200)
    shares = np.zeros((400, 5))
    shares[:, 1], shares[:, 2] = 0.8, 0.2
    grid, curves = calibrate(shares, labels)
    assert np.interp(0.8, grid[1], curves[1]) == pytest.approx(0.5, abs=0.02)
    assert np.all(np.diff(curves, axis=1) >= 0)
    np.testing.assert_allclose(curves[3], grid[3])  # no example: left as it is
    _, rarer = calibrate(shares, labels, np.where(labels == 1, 0.25, 1.0))
    assert np.interp(0.8, grid[1], rarer[1]) == pytest.approx(0.2, abs=0.02)  # one in five where it will stand


def test_a_folder_in_the_articles_layout(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for name, count in (("background", 2), ("bicyclist", 1), ("car", 3), ("pedestrian", 1)):
        (tmp_path / name).mkdir()
        for i in range(count):
            rng.uniform(-1, 1, (20, 3)).astype(np.float32).tofile(tmp_path / name / f"{i:05d}.bin")
    (tmp_path / "car" / "tiny.bin").write_bytes(np.zeros(6, np.float32).tobytes())
    got = read_folder(tmp_path)
    assert [int(np.sum(got.labels == c)) for c in range(5)] == [2, 3, 0, 1, 1]
    assert len(np.unique(got.groups)) == 7
    lowest = [got.points[a:b, 2].min() for a, b in zip(got.offsets, got.offsets[1:], strict=False)]
    np.testing.assert_array_equal(got.ground_z_m, lowest)


def test_a_number_before_the_underscore_is_the_group(tmp_path: Path) -> None:
    (tmp_path / "car").mkdir()
    for name in ("7_a", "7_b", "8_a"):
        np.linspace(0, 1, 30, dtype=np.float32).reshape(10, 3).tofile(tmp_path / "car" / f"{name}.bin")
    assert read_folder(tmp_path).groups.tolist() == [7, 7, 8]


def test_joined_sets_keep_their_groups_apart() -> None:
    points = [np.zeros((4, 3)), np.ones((6, 3))]
    one = collect(points, [0.0, 1.0], [0, 1], [0, 0])
    both = join_clusters([one, one])
    assert both.offsets.tolist() == [0, 4, 10, 14, 20]
    assert both.groups.tolist() == [0, 0, 1, 1]
    assert both.labels.tolist() == [0, 1, 0, 1]
