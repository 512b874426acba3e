"""What a cluster is: a calibrated random forest over its features.

The forest that is shipped (``forest.npz`` beside this file) says in its header what it was trained on. Probabilities
are calibrated per class on scenes the forest had not seen (isotonic regression, Zadrozny & Elkan 2002), so that 0.9
means nine in ten; what stays under ``min_confidence`` is called unknown, which is an obstacle all the same.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from services.infra_lidar.classes import CLASSES, LABELS, UNKNOWN
from services.infra_lidar.config import ClassifierConfig
from services.infra_lidar.forest import Forest, ModelError, load_forest

__all__ = ["CLASSES", "LABELS", "SHIPPED_MODEL", "UNKNOWN", "Classifier"]

SHIPPED_MODEL = Path(__file__).with_name("forest.npz")


class Classifier:
    """``feature_names`` says which features, in which order, ``classify`` expects.

    Raises:
        ModelError: the model is missing, damaged, or made for other classes.
    """

    def __init__(self, config: ClassifierConfig) -> None:
        path = Path(config.model) if config.model else SHIPPED_MODEL
        self.forest: Forest = load_forest(path)
        if self.forest.classes != CLASSES:
            raise ModelError(f"{path}: made for the classes {self.forest.classes}, expected {CLASSES}")
        self.feature_names = self.forest.features
        self._min_confidence = config.min_confidence

    def classify(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Classes of K clusters.

        Args:
            features: (K, F) float32, columns as in ``feature_names``.

        Returns:
            labels (K,) int64, index into ``LABELS`` (``UNKNOWN`` where no class is likely enough);
            confidence (K,) float32, probability of the likeliest class; probabilities (K, C) float32 over ``CLASSES``.
        """
        probabilities = self.forest.probabilities(features)
        confidence = probabilities.max(axis=1, initial=0.0)
        labels = np.where(confidence >= self._min_confidence, probabilities.argmax(axis=1), UNKNOWN)
        return labels, confidence, probabilities
