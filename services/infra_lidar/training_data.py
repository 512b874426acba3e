"""Where training and test clusters come from: folders in the article's layout, or generated scenes and bodies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.forest import Forest
from services.infra_lidar.train import train_forest
from services.infra_lidar.training_clusters import (
    LabelledClusters,
    generated_clusters,
    join_clusters,
    read_folder,
)
from services.infra_lidar.training_scenes import scene_clusters

_BACKGROUND = 2  # generated fixtures per body of any class: the street has more kinds of things than of road users


def training_set(folder: Path | None, scenes: int, bodies: int, seed: int) -> tuple[LabelledClusters, dict[str, Any]]:
    """Clusters and the story of where they come from, for the model's header."""
    if folder:
        return read_folder(folder / "train"), {"source": "labelled clusters", "folder": folder.name}
    parts = [scene_clusters(range(seed, seed + scenes), InfraLidarConfig(), frames=3)]
    if bodies:
        parts.append(generated_clusters(seed, bodies, background=_BACKGROUND))
    story = {"source": "generated roadside scenes and single bodies", "scenes": [seed, seed + scenes - 1]}
    return join_clusters(parts), story | {"bodies_per_class": bodies, "frames_per_scene": 3}


def test_set(folder: Path | None, scenes: int, seed: int) -> LabelledClusters:
    """Clusters of groups that ``training_set`` does not use."""
    if folder:
        return read_folder(folder / "test")
    return scene_clusters(range(seed, seed + scenes), InfraLidarConfig(), frames=3)


def small_forest(clusters: LabelledClusters, feature_set: str) -> Forest:
    """The article's forest without limit on the leaves, for comparing feature sets."""
    return train_forest(clusters, feature_set, {"source": "ablation"})
