"""The loop that the three generators share: bodies are drawn until enough of each class have been seen well."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.training.clusters import LabelledClusters, collect

MIN_POINTS, MIN_HEIGHT_M = 20, 0.15


def draw_clusters(seen: Callable[[str], np.ndarray], counts: Mapping[str, int]) -> LabelledClusters:
    """``counts`` clusters of each class; each its own group, road at 0.

    seen: makes the returns (n, 3) float32 of one more body of a class; what shows less than MIN_POINTS or is flatter
    than MIN_HEIGHT_M is drawn again.
    """
    points: list[np.ndarray] = []
    labels: list[int] = []
    for label, name in enumerate(CLASSES):
        wanted = len(points) + counts[name]
        while len(points) < wanted:
            cluster = seen(name)
            if len(cluster) >= MIN_POINTS and np.ptp(cluster[:, 2]) > MIN_HEIGHT_M:
                points.append(cluster)
                labels.append(label)
    return collect(points, [0.0] * len(points), labels, list(range(len(points))))
