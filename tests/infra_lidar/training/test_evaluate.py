"""Figures of an evaluation by hand, the tables, the pictures, and the commands end to end on a small folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.training.clusters import LabelledClusters
from services.infra_lidar.training.commands import add_commands
from services.infra_lidar.training.evaluate import class_table, confusion_table, judge
from services.infra_lidar.training.varied import generated_clusters


def sample() -> tuple[np.ndarray, np.ndarray]:
    probabilities = np.array([[0.9, 0.1, 0, 0, 0], [0.2, 0.8, 0, 0, 0], [0.6, 0.4, 0, 0, 0], [0, 0, 0, 0.7, 0.3]])
    return probabilities, np.array([0, 1, 1, 4])


def test_precision_recall_and_f1_by_hand() -> None:
    result = judge(*sample())
    assert result.confusion[:2, :2].tolist() == [[1, 0], [1, 1]]
    assert result.precision[:2] == pytest.approx([0.5, 1.0])
    assert result.recall[:2] == pytest.approx([1.0, 0.5])
    assert result.f1[:2] == pytest.approx([2 / 3, 2 / 3])
    assert result.present.tolist() == [True, True, False, False, True]
    assert result.macro_f1 == pytest.approx((2 / 3 + 2 / 3 + 0) / 3)
    assert result.accuracy == 0.5


def test_calibration_error_by_hand() -> None:
    probabilities = np.zeros((10, 5))
    probabilities[:, 1], probabilities[:, 2] = 0.75, 0.25
    assert judge(probabilities, np.array([1] * 5 + [2] * 5)).calibration_error() == pytest.approx(0.25)


def test_tables_name_every_class_that_occurs() -> None:
    result = judge(*sample())
    table = class_table(result)
    assert "car" in table
    assert "large_vehicle" not in table
    assert "accuracy 0.500" in table
    assert all(name in confusion_table(result) for name in CLASSES)


def write_folder(folder: Path, clusters: LabelledClusters) -> None:
    for k, label in enumerate(clusters.labels):
        place = folder / CLASSES[label]
        place.mkdir(parents=True, exist_ok=True)
        points = clusters.points[clusters.offsets[k] : clusters.offsets[k + 1]]
        (points - points.mean(axis=0)).astype(np.float32).tofile(place / f"{k:04d}.bin")


@pytest.mark.slow
def test_train_and_evaluate_a_folder(tmp_path: Path) -> None:
    pytest.importorskip("sklearn", reason="needs the train extra")
    pytest.importorskip("matplotlib", reason="needs the plot extra")
    write_folder(tmp_path / "data" / "train", generated_clusters(1, 12))
    write_folder(tmp_path / "data" / "test", generated_clusters(2, 6))
    app = typer.Typer()
    add_commands(app)
    model, pictures = tmp_path / "forest.npz", tmp_path / "pictures"
    run = CliRunner().invoke(app, ["train", str(tmp_path / "data"), "-o", str(model), "--trees", "8"])
    assert run.exit_code == 0, run.output
    assert "8 trees" in run.output
    data = str(tmp_path / "data")
    run = CliRunner().invoke(app, ["evaluate", data, "--model", str(model), "-o", str(pictures)])
    assert run.exit_code == 0, run.output
    assert "macro" in run.output
    assert sorted(path.name for path in pictures.iterdir()) == ["confidence.png", "confusion.png"]
