"""How good a forest is: per-class table, confusion, confidence and calibration.

Every figure is for clusters whose group (object or scene) the forest has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.classification.features import compute_features
from services.infra_lidar.classification.forest import Forest
from services.infra_lidar.training.clusters import LabelledClusters


@dataclass(frozen=True)
class Evaluation:
    """``confusion[true, called]`` (C, C) counts; ``confidence`` and ``correct`` (K,) of every cluster."""

    confusion: np.ndarray
    confidence: np.ndarray
    correct: np.ndarray

    @property
    def present(self) -> np.ndarray:
        """(C,) bool: classes that occur in the truth."""
        return np.asarray(self.confusion.sum(axis=1) > 0)

    @property
    def precision(self) -> np.ndarray:
        """(C,) of those called a class, the share that is of it; 0 where none is called so."""
        return np.asarray(np.diag(self.confusion) / np.maximum(self.confusion.sum(axis=0), 1))

    @property
    def recall(self) -> np.ndarray:
        """(C,) of those of a class, the share that is called so."""
        return np.asarray(np.diag(self.confusion) / np.maximum(self.confusion.sum(axis=1), 1))

    @property
    def f1(self) -> np.ndarray:
        """(C,) harmonic mean of precision and recall."""
        both = self.confusion.sum(axis=0) + self.confusion.sum(axis=1)
        return np.asarray(2 * np.diag(self.confusion) / np.maximum(both, 1))

    @property
    def macro_f1(self) -> float:
        """Mean over the classes that occur."""
        return float(self.f1[self.present].mean())

    @property
    def accuracy(self) -> float:
        """Share of all clusters that are called what they are."""
        return float(np.trace(self.confusion) / max(self.confusion.sum(), 1))

    def calibration_error(self, bins: int = 10) -> float:
        """Expected calibration error (Naeini et al. 2015): mean gap between confidence and share correct."""
        index = np.minimum((self.confidence * bins).astype(int), bins - 1)
        gaps = [
            abs(self.correct[index == b].mean() - self.confidence[index == b].mean()) * np.mean(index == b)
            for b in np.unique(index)
        ]
        return float(sum(gaps))


def judge(probabilities: np.ndarray, labels: np.ndarray) -> Evaluation:
    """(K, C) probabilities against (K,) true classes."""
    called = probabilities.argmax(axis=1)
    confusion = np.zeros((len(CLASSES), len(CLASSES)), np.int64)
    np.add.at(confusion, (labels, called), 1)
    return Evaluation(confusion, probabilities.max(axis=1, initial=0.0), called == labels)


def evaluate_forest(forest: Forest, clusters: LabelledClusters) -> Evaluation:
    """What a forest makes of clusters it should not have been trained on."""
    x = compute_features(clusters.points, clusters.offsets, clusters.ground_z_m, forest.features)
    return judge(forest.class_probabilities(x), clusters.labels)


def class_table(result: Evaluation) -> str:
    """Precision, recall, F1 and number of every class, and the means."""
    lines = [f"{'class':<15}{'precision':>10}{'recall':>10}{'F1':>10}{'clusters':>10}"]
    for c, name in enumerate(CLASSES):
        if result.present[c]:
            row = (result.precision[c], result.recall[c], result.f1[c])
            lines.append(f"{name:<15}" + "".join(f"{v:10.3f}" for v in row) + f"{result.confusion[c].sum():10d}")
    means = [float(v[result.present].mean()) for v in (result.precision, result.recall, result.f1)]
    lines.append(f"{'macro':<15}" + "".join(f"{v:10.3f}" for v in means) + f"{result.confusion.sum():10d}")
    right, wrong = result.confidence[result.correct], result.confidence[~result.correct]
    lines.append(
        f"accuracy {result.accuracy:.3f}; confidence {_mean(right)} where right, {_mean(wrong)} where wrong; "
        f"calibration error {result.calibration_error():.3f}"
    )
    return "\n".join(lines)


def confusion_table(result: Evaluation) -> str:
    """Rows are true, columns are called."""
    lines = [f"{'true / called':<15}" + "".join(f"{name:>15}" for name in CLASSES)]
    for c, name in enumerate(CLASSES):
        lines.append(f"{name:<15}" + "".join(f"{count:15d}" for count in result.confusion[c]))
    return "\n".join(lines)


def _mean(values: np.ndarray) -> str:
    return f"{values.mean():.3f}" if len(values) else "-"
