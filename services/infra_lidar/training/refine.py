"""The leaves of a random forest refined over all trees together.

The trees of a forest are grown one by one, and the shares of the classes in a leaf know nothing of the other trees.
Here the trees stay as they are and the scores of all leaves are fitted at once: a logistic regression whose inputs say
in which leaf of each tree a cluster ends (Ren, Cao, Wei and Sun, "Global refinement of random forest", CVPR 2015).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier
from sklearn.linear_model import LogisticRegression

from services.infra_lidar.classification.classes import CLASSES

C = 0.007  # of the regression: smaller pulls the scores harder towards 0
TOLERANCE, ITERATIONS = 1e-3, 500


class RefinedForest:
    """A scikit-learn forest whose leaves hold scores of the classes, with the interface of a classifier.

    The probabilities are the softmax of the scores' sums over the trees. forest: not fitted yet.
    """

    def __init__(self, forest: RandomForestClassifier | ExtraTreesClassifier) -> None:
        self.forest = forest
        self._regression = LogisticRegression(C=C, tol=TOLERANCE, max_iter=ITERATIONS)

    @property
    def classes_(self) -> np.ndarray:
        """(P,) the classes that there were in training, rising."""
        return np.asarray(self._regression.classes_)

    def fit(self, x: np.ndarray, labels: np.ndarray, weight: np.ndarray | None) -> RefinedForest:
        """Grow the trees, then fit the scores; x (K, F), labels (K,), weight (K,)."""
        self.forest.fit(x, labels, weight)
        self._regression.fit(self._leaves(x), labels, weight)
        return self

    def predict_proba(self, x: np.ndarray) -> np.ndarray:
        """(K, P) probability of each class of ``classes_``."""
        return np.asarray(self._regression.predict_proba(self._leaves(x)))

    def scores(self) -> list[np.ndarray]:
        """(N, len(CLASSES)) scores of the nodes of each tree; minus infinity for a class that training did not have."""
        of_nodes, present = self._regression.coef_.T, self.classes_
        if len(present) == 2:  # scikit-learn keeps the second class only
            of_nodes = np.column_stack((np.zeros(len(of_nodes)), of_nodes))
        constant = np.zeros(len(present))
        constant[-len(self._regression.intercept_) :] = self._regression.intercept_ / len(self._firsts)
        table = np.full((len(of_nodes), len(CLASSES)), -np.inf)
        table[:, present] = of_nodes + constant
        return np.split(table, self._firsts[1:])

    @property
    def _firsts(self) -> np.ndarray:
        """(T,) the number of the first node of each tree, with all nodes of the forest in one row."""
        counts = [tree.tree_.node_count for tree in self.forest.estimators_]
        return np.cumsum([0, *counts[:-1]])

    def _leaves(self, x: np.ndarray) -> csr_array:
        """(K, all nodes) 1 where a cluster ends."""
        ends = self.forest.apply(x) + self._firsts
        rows, trees = ends.shape
        nodes = self._firsts[-1] + self.forest.estimators_[-1].tree_.node_count
        begins = np.arange(rows + 1) * trees
        return csr_array((np.ones(ends.size), ends.ravel(), begins), shape=(rows, nodes))
