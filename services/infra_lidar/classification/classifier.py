"""What a cluster is: a calibrated random forest over its features.

The forest that is shipped (``forest.npz`` beside this file) says in its header what it was trained on; its leaves are
refined over all trees together (Ren, Cao, Wei and Sun, "Global refinement of random forest", CVPR 2015). Probabilities
are calibrated per class on scenes the forest had not seen (isotonic regression, Zadrozny & Elkan 2002), so that 0.9
means nine in ten. A cluster whose best class stays under ``min_confidence`` is called unknown, and is an obstacle all
the same.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from services.infra_lidar.classification.classes import CLASSES, UNKNOWN, VEHICLES
from services.infra_lidar.classification.feature_kernels import FEATURE_NAMES
from services.infra_lidar.classification.features import compute_features
from services.infra_lidar.classification.forest import Forest, ModelError, load_forest
from services.infra_lidar.clustering.boxes import ClusterPoints
from services.infra_lidar.config import ClassifierConfig

SHIPPED_MODEL = Path(__file__).with_name("forest.npz")


class Classification(NamedTuple):
    """Features, classes and probabilities of K clusters."""

    features: np.ndarray  # (K, F) float32, columns as in `Classifier.feature_names`
    labels: np.ndarray  # (K,) int64, index into `LABELS`; `UNKNOWN` where no class is likely enough
    confidence: np.ndarray  # (K,) float32, probability of the likeliest class
    probabilities: np.ndarray  # (K, C) float32 over `CLASSES`


def likeliest(probabilities: np.ndarray, min_confidence: float) -> tuple[np.ndarray, np.ndarray]:
    """The label of each cluster (K,), index into `LABELS`, and its confidence (K,), from probabilities (K, C).

    `UNKNOWN` is what no class is likely enough for.
    """
    confidence = probabilities.max(axis=1, initial=0.0)
    return np.where(confidence >= min_confidence, probabilities.argmax(axis=1), UNKNOWN), confidence


def reject_vehicles(found: Classification, no_road: np.ndarray) -> Classification:
    """Clusters labelled as vehicles where ``no_road`` (K,) bool is set become unknown, all classes equally probable."""
    if not no_road.any():
        return found
    doubted = no_road & np.isin(found.labels, VEHICLES)
    probabilities = np.where(doubted[:, None], np.float32(1.0 / len(CLASSES)), found.probabilities)
    labels = np.where(doubted, UNKNOWN, found.labels)
    return Classification(found.features, labels, probabilities.max(axis=1), probabilities)


def model_path(config: ClassifierConfig) -> Path:
    """The file that is used: the site's, as long as there is one."""
    if config.site_model and Path(config.site_model).exists():
        return Path(config.site_model)
    return Path(config.model) if config.model else SHIPPED_MODEL


class Classifier:
    """``feature_names`` says which features, in which order, ``classify`` expects. ``forest``: instead of the file.

    Raises:
        ModelError: the model is missing, damaged, made for other classes, or for other features.
    """

    def __init__(self, config: ClassifierConfig, forest: Forest | None = None) -> None:
        path = model_path(config)
        try:
            self.forest = forest or load_forest(path)
        except ModelError as error:
            raise ModelError(f"[classifier] model: {error}") from None
        if self.forest.classes != CLASSES:
            made_for = f"made for the classes {self.forest.classes}, expected {CLASSES}"
            raise ModelError(f"[classifier] model: {path}: {made_for}")
        unknown = sorted(set(self.forest.features) - set(FEATURE_NAMES))
        if unknown and forest is None:
            needs = f"needs the feature(s) {', '.join(unknown)}; expected some of {', '.join(FEATURE_NAMES)}"
            raise ModelError(f"[classifier] model: {path}: {needs}")
        self.feature_names = self.forest.features
        self._min_confidence = config.min_confidence

    def extract_and_classify(self, clusters: ClusterPoints, ground_z_m: np.ndarray) -> Classification:
        """Features and classes of K clusters above their local ground ``ground_z_m`` (K,), metres, level frame.

        Raises:
            ValueError: ``forest`` needs a feature that ``compute_features`` does not have.
        """
        return self.classify(compute_features(clusters.points, clusters.offsets, ground_z_m, self.feature_names))

    def classify(self, features: np.ndarray) -> Classification:
        """Classes of K clusters from their features (K, F) float32, columns as in ``feature_names``."""
        probabilities = self.forest.class_probabilities(features)
        labels, confidence = likeliest(probabilities, self._min_confidence)
        return Classification(features, labels, confidence, probabilities)
