"""The forest as arrays against scikit-learn, its file, and the classifier that is shipped."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from services.infra_lidar.classification.classes import CLASSES, LABELS, UNKNOWN
from services.infra_lidar.classification.classifier import SHIPPED_MODEL, Classification, Classifier, reject_vehicles
from services.infra_lidar.classification.features import FEATURE_SETS, compute_features
from services.infra_lidar.classification.forest import Forest, ModelError, load_forest
from services.infra_lidar.config import ClassifierConfig
from services.infra_lidar.training.varied import generated_clusters


def two_stumps() -> Forest:
    """Two trees of one question each over two features; five classes of which two occur."""
    return Forest(
        feature=np.array([0, 0, 0, 1, 0, 0], np.int32),
        threshold=np.array([1.0, np.inf, np.inf, 0.0, np.inf, np.inf], np.float32),
        left=np.array([1, 1, 2, 4, 4, 5], np.int32),
        right=np.array([2, 1, 2, 5, 4, 5], np.int32),
        leaf=np.array([0, 0, 1, 0, 2, 3], np.int32),
        value=np.array([[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0.5, 0.5, 0, 0, 0], [0, 1, 0, 0, 0]], np.float32),
        root=np.array([0, 3], np.int32),
        calibration_x=np.tile(np.linspace(0, 1, 3, dtype=np.float32), (5, 1)),
        calibration_y=np.tile(np.linspace(0, 1, 3, dtype=np.float32), (5, 1)),
        classes=CLASSES,
        features=("z_range", "z_std"),
        provenance={"made": "by hand"},
    )


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        ((0.0, -1.0), (0.75, 0.25)),
        ((1.0, 0.0), (0.75, 0.25)),  # a value on the threshold goes left, as in scikit-learn
        ((2.0, -1.0), (0.25, 0.75)),
        ((2.0, 1.0), (0.0, 1.0)),
        ((np.nan, np.nan), (0.75, 0.25)),  # not a number counts as 0
    ],
)
def test_shares_by_hand(x: tuple[float, float], expected: tuple[float, float]) -> None:
    assert two_stumps().shares(np.array([x]))[0, :2] == pytest.approx(expected)


def test_a_leaf_beyond_the_first_tree_is_found_whatever_its_row() -> None:
    forest = two_stumps()
    crowded = np.concatenate((np.full((70_000, 5), 0.2, np.float32), forest.value))
    far = Forest(**{**forest.__dict__, "value": crowded, "leaf": forest.leaf + np.int32(70_000)})
    x = np.random.default_rng(0).normal(0, 2, (9, 2)).astype(np.float32)
    np.testing.assert_array_equal(far.shares(x), forest.shares(x))


def test_rows_do_not_influence_each_other() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(0, 2, (37, 2)).astype(np.float32)
    forest = two_stumps()
    np.testing.assert_array_equal(forest.shares(x), np.concatenate([forest.shares(row[None]) for row in x]))
    assert forest.shares(np.empty((0, 2))).shape == (0, 5)


def test_a_vehicle_where_none_can_stand_is_unknown() -> None:
    labels = np.array([CLASSES.index(name) for name in ("car", "large_vehicle", "pedestrian", "car", "background")])
    sure = np.full((5, 5), 0.05, np.float32)
    sure[np.arange(5), labels] = 0.8
    found = Classification(np.zeros((5, 2), np.float32), labels, sure.max(axis=1), sure)
    doubted = reject_vehicles(found, np.array([True, True, True, False, True]))
    assert [LABELS[label] for label in doubted.labels] == ["unknown", "unknown", "pedestrian", "car", "background"]
    np.testing.assert_allclose(doubted.confidence, [0.2, 0.2, 0.8, 0.8, 0.8])
    np.testing.assert_allclose(doubted.probabilities[0], 0.2)
    np.testing.assert_array_equal(doubted.probabilities[2:], sure[2:])
    assert reject_vehicles(found, np.zeros(5, bool)) is found


def test_calibration_maps_shares_and_keeps_the_sum() -> None:
    forest = two_stumps()
    forest.calibration_y[0] = [0.0, 0.2, 1.0]
    p = forest.class_probabilities(np.array([[0.0, -1.0]]))
    assert p.sum() == pytest.approx(1.0)
    assert p[0, 0] == pytest.approx(0.6 / 0.85, abs=1e-4)


def test_a_saved_forest_reads_back_equal(tmp_path: Path) -> None:
    forest = two_stumps()
    forest.save(tmp_path / "f.npz")
    again = load_forest(tmp_path / "f.npz")
    assert again.digest == forest.digest
    assert again.classes == CLASSES
    assert again.provenance == forest.provenance


def rewritten(path: Path, **changes: np.ndarray) -> Path:
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files} | changes
    np.savez(path, **arrays)
    return path


def test_damaged_files_are_refused_with_a_reason(tmp_path: Path) -> None:
    path = tmp_path / "f.npz"
    with pytest.raises(ModelError, match="no such model"):
        load_forest(path)
    path.write_bytes(b"PK not really")
    with pytest.raises(ModelError, match="not a forest"):
        load_forest(path)
    two_stumps().save(path)
    with pytest.raises(ModelError, match="SHA-256"):
        load_forest(rewritten(path, threshold=np.zeros(6, np.float32)))
    with pytest.raises(ModelError, match="not a forest"):
        load_forest(rewritten(path, header=np.frombuffer(b"{", np.uint8)))


def test_a_model_of_the_older_layout_is_refused(tmp_path: Path) -> None:
    two_stumps().save(tmp_path / "f.npz")
    with pytest.raises(ModelError, match="older layout; train it again"):
        load_forest(rewritten(tmp_path / "f.npz", child=np.zeros(6, np.int32)))


def test_a_file_with_pickled_objects_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "f.npz"
    two_stumps().save(path)
    with pytest.raises(ModelError, match="not a forest"):
        load_forest(rewritten(path, value=np.array([{"a": 1}], object)))


def test_nodes_that_point_outside_are_refused(tmp_path: Path) -> None:
    forest = two_stumps()
    forest.left[0] = 900
    forest.save(tmp_path / "f.npz")
    with pytest.raises(ModelError, match="outside of the forest"):
        load_forest(tmp_path / "f.npz")


@pytest.mark.parametrize(
    ("array", "node", "number"),
    [
        ("left", 3, 1),  # back to another tree
        ("right", 0, 4),  # two parents
        ("left", 0, 3),  # the root of another tree
        ("right", 2, 1),  # back up
    ],
)
def test_nodes_that_are_no_trees_are_refused(array: str, node: int, number: float, tmp_path: Path) -> None:
    forest = two_stumps()
    getattr(forest, array)[node] = number
    forest.save(tmp_path / "f.npz")
    with pytest.raises(ModelError, match="do not form trees"):
        load_forest(tmp_path / "f.npz")


@pytest.mark.parametrize(
    "words",
    [
        ["--source", "sim:crossing", "--set", "classifier.model=/no/such.npz"],
        ["--set", "classifier.model=/no/such.npz", "--plot", "picture.png"],
        ["evaluate", "--model", "/no/such.npz"],
    ],
    ids=["service", "plot", "evaluate"],
)
def test_a_missing_model_stops_before_anything_begins(words: list[str], tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("spotter-infra-lidar")
    completed = subprocess.run([program, *words], capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False)
    assert completed.returncode == 2
    assert completed.stderr.splitlines()[-1].startswith("spotter: ")
    assert completed.stderr.splitlines()[-1].endswith("/no/such.npz: no such model file")
    assert "Traceback" not in completed.stderr
    assert ("[classifier] model:" in completed.stderr) == ("--set" in words)


def test_another_set_of_classes_is_refused(tmp_path: Path) -> None:
    forest = two_stumps()
    other = Forest(**{**forest.__dict__, "classes": ("a", "b", "c", "d", "e")})
    other.save(tmp_path / "f.npz")
    with pytest.raises(ModelError, match="expected"):
        Classifier(ClassifierConfig(model=str(tmp_path / "f.npz")))


def test_a_model_for_features_that_the_service_does_not_compute_is_refused_at_once(tmp_path: Path) -> None:
    other = Forest(**{**two_stumps().__dict__, "features": ("range_m", "nn_dist_std")})
    other.save(tmp_path / "f.npz")
    with pytest.raises(ModelError, match=r"f\.npz: needs the feature\(s\) nn_dist_std; expected some of .*range_m"):
        Classifier(ClassifierConfig(model=str(tmp_path / "f.npz")))


def test_the_shipped_model_says_where_it_comes_from() -> None:
    forest = load_forest(SHIPPED_MODEL)
    assert SHIPPED_MODEL.stat().st_size < 1_500_000
    assert forest.classes == CLASSES
    assert set(forest.features) <= {name for names in FEATURE_SETS.values() for name in names}
    assert {"feature_set", "clusters", "trees", "seed"} <= forest.provenance.keys()
    json.dumps(forest.provenance)


def test_the_shipped_model_is_made_with_the_defaults_of_train() -> None:
    pytest.importorskip("sklearn", reason="needs the train extra")
    from services.infra_lidar.training.commands import TRAIN_SEED, train
    from services.infra_lidar.training.train import BODY_WEIGHT, GENERATED

    forest, default = load_forest(SHIPPED_MODEL), inspect.signature(train).parameters
    made = {name: default[name].default for name in ("scenes", "bodies")}
    made |= {"seed": TRAIN_SEED, "forest_seed": GENERATED.seed, "feature_set": "any_sensor", "trees": GENERATED.trees}
    made |= {
        "body_weight": BODY_WEIGHT,
        "background_weight": GENERATED.background,
        "refined": True,
        "random_cuts": True,
    }
    assert {name: forest.provenance.get(name) for name in made} == made
    assert forest.features == FEATURE_SETS["any_sensor"]


def test_the_shipped_model_knows_bodies_it_has_not_seen() -> None:
    classifier = Classifier(ClassifierConfig())
    clusters = generated_clusters(seed=987, per_class=25, min_points=25)
    x = compute_features(clusters.points, clusters.offsets, clusters.ground_z_m, classifier.feature_names)
    _, labels, confidence, probabilities = classifier.classify(x)
    assert np.mean(labels == clusters.labels) > 0.6  # more varied than what it learned from; by lot it were 0.2
    assert probabilities.shape == (len(clusters), len(CLASSES))
    np.testing.assert_allclose(probabilities.sum(axis=1), 1.0, atol=1e-5)
    np.testing.assert_allclose(confidence, probabilities.max(axis=1))


def test_what_no_class_fits_is_unknown() -> None:
    features = Classifier(ClassifierConfig()).feature_names
    x = np.random.default_rng(0).uniform(0, 5, (50, len(features)))
    strict = Classifier(ClassifierConfig(min_confidence=1.0))
    assert LABELS[UNKNOWN] == "unknown"
    assert np.all(strict.classify(x).labels == UNKNOWN)
    assert np.all(Classifier(ClassifierConfig(min_confidence=0.0)).classify(x).labels < len(CLASSES))


@pytest.mark.parametrize("curve", ["calibration_x", "calibration_y"])
def test_a_curve_that_falls_is_refused(curve: str, tmp_path: Path) -> None:
    forest = two_stumps()
    getattr(forest, curve)[2] = [0.0, 0.6, 0.5]
    forest.save(tmp_path / "f.npz")
    with pytest.raises(ModelError, match="a calibration curve falls"):
        load_forest(tmp_path / "f.npz")


def test_the_wrong_number_of_features_is_refused() -> None:
    with pytest.raises(ValueError, match="expected shape"):
        Classifier(ClassifierConfig()).classify(np.zeros((3, 2)))
