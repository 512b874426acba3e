"""What a cluster is: a calibrated random forest over its features.

The forest that is shipped (``forest.npz`` beside this file) says in its header what it was trained on. Probabilities
are calibrated per class on scenes the forest had not seen (isotonic regression, Zadrozny & Elkan 2002), so that 0.9
means nine in ten; what stays under ``min_confidence`` is called unknown, which is an obstacle all the same.

A forest of the article's features asks how evenly points are spaced, which costs four times as much as all its other
questions, and decides hardly anything: so it is answered only where a class hangs on it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from services.infra_lidar.buffers import Buffers
from services.infra_lidar.classes import CLASSES, LABELS, UNKNOWN
from services.infra_lidar.config import ClassifierConfig
from services.infra_lidar.features import SPACING, compute_spacing, features_of, may_wait, wanted_of
from services.infra_lidar.forest import Forest, ModelError, load_forest
from services.infra_lidar.forest_walk import decide

__all__ = ["CLASSES", "LABELS", "SHIPPED_MODEL", "UNKNOWN", "Classifier"]

SHIPPED_MODEL = Path(__file__).with_name("forest.npz")


class Classifier:
    """``feature_names`` says which features, in which order, ``classify`` expects. ``forest``: instead of the file.

    Raises:
        ModelError: the model is missing, damaged, or made for other classes.
    """

    def __init__(self, config: ClassifierConfig, forest: Forest | None = None) -> None:
        path = Path(config.model) if config.model else SHIPPED_MODEL
        try:
            self.forest = forest or load_forest(path)
        except ModelError as error:
            raise ModelError(f"[classifier] model: {error}") from None
        if self.forest.classes != CLASSES:
            known = f"made for the classes {self.forest.classes}, expected {CLASSES}"
            raise ModelError(f"[classifier] model: {path}: {known}")
        self.feature_names = self.forest.features
        self._min_confidence = config.min_confidence
        self._wanted, self._waits = wanted_of(self.feature_names), may_wait(self.feature_names)
        self._column = self.feature_names.index(SPACING) if self._waits else -1
        self._typical = self.forest.typical(self._column) if self._waits else 0.0

    def recognise(
        self,
        planar: np.ndarray,
        offsets: np.ndarray,
        ground_z_m: np.ndarray,
        buffers: Buffers | None = None,
        counts: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Features of K clusters (see ``compute_features``), whose points are planar here, (3, M) float32, and their
        classes (see ``classify``).

        Classes are those that ``classify`` finds with all features. Where the spacing of points cannot change the class
        it is not computed: then a typical one stands in its column and in the probabilities.

        Returns:
            features (K, F) float32, labels (K,), confidence (K,), probabilities (K, C).
        """
        buffers, counts = buffers or Buffers(), np.diff(offsets) if counts is None else counts
        x = features_of(planar, offsets, counts, ground_z_m, self._wanted, buffers, not self._waits)
        if not self._waits:
            return x, *self.classify(x)
        x[:, self._column] = self._typical
        shares, certain = self.forest.settled(x, self._column, self._min_confidence)
        (open_,) = np.nonzero(~certain)
        x[open_, self._column] = compute_spacing(planar, offsets, open_, buffers)
        shares[open_] = self.forest.shares(x[open_])
        return x, *self._decide(shares)

    def classify(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Classes of K clusters.

        Args:
            features: (K, F) float32, columns as in ``feature_names``.

        Returns:
            labels (K,) int64, index into ``LABELS`` (``UNKNOWN`` where no class is likely enough);
            confidence (K,) float32, probability of the likeliest class; probabilities (K, C) float32 over ``CLASSES``.
        """
        return self._decide(self.forest.shares(features))

    def _decide(self, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        labels, confidence, forest = np.empty(len(shares), np.int64), np.empty(len(shares), np.float32), self.forest
        decide(shares, forest.calibration_x, forest.calibration_y, self._min_confidence, UNKNOWN, labels, confidence)
        return labels, confidence, shares
