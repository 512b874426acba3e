"""The table that training prints: clusters per class, and the recall on groups that were held out. Pure."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.classification.forest import calibrated
from services.infra_lidar.training.clusters import LabelledClusters
from services.infra_lidar.training.evaluate import judge

FEW_CLUSTERS = 100  # of a class; with fewer, its calibration curve and figures are unreliable


def held_out_table(
    shares: np.ndarray, curve_x: np.ndarray, curve_y: np.ndarray, clusters: LabelledClusters
) -> Iterator[str]:
    """Lines for a person: clusters and groups by class, recall and macro F1 before and after calibration.

    shares: (K, C) of the trees' votes, each by a forest that was trained without the cluster's group. curve_x, curve_y:
    (C, B), the calibration. It was fitted to these very shares, so its column is a little too good.
    """
    labels, groups = clusters.labels, clusters.groups
    plain, after = judge(shares, labels), judge(calibrated(shares, curve_x, curve_y), labels)
    yield f"{'held out':<15}{'clusters':>10}{'groups':>10}{'recall':>10}{'calibrated':>12}"
    for c, name in enumerate(CLASSES):
        if plain.present[c]:
            count, of = int(np.sum(labels == c)), len(np.unique(groups[labels == c]))
            few = "  few: its figures and its calibration are rough" if count < FEW_CLUSTERS else ""
            yield f"{name:<15}{count:10d}{of:10d}{plain.recall[c]:10.3f}{after.recall[c]:12.3f}{few}"
    yield f"{'macro F1':<15}{len(labels):10d}{len(np.unique(groups)):10d}{plain.macro_f1:10.3f}{after.macro_f1:12.3f}"
    lost = [
        f"{name} {plain.recall[c]:.2f} to {after.recall[c]:.2f}"
        for c, name in enumerate(CLASSES)
        if plain.present[c] and after.recall[c] < plain.recall[c] - 0.05
    ]
    if lost:
        yield f"calibration lowers recall: {', '.join(lost)}"
