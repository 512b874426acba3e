"""Labelled clusters: the input of training and evaluation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LabelledClusters:
    """K clusters: ``points`` (M, 3) float32 metres grouped by ``offsets`` (K + 1,), heights above ``ground_z_m`` (K,).

    ``labels`` (K,) index into ``CLASSES``; ``groups`` (K,) int64: clusters of one group show the same object or scene
    and never stand on both sides of a split.
    """

    points: np.ndarray
    offsets: np.ndarray
    ground_z_m: np.ndarray
    labels: np.ndarray
    groups: np.ndarray

    def __len__(self) -> int:
        return len(self.labels)


def collect(clusters: list[np.ndarray], ground: list[float], labels: list[int], groups: list[int]) -> LabelledClusters:
    """Lists, one entry a cluster, to arrays."""
    if not clusters:
        raise ValueError("no clusters")
    return LabelledClusters(
        np.concatenate(clusters).astype(np.float32),
        np.concatenate(([0], np.cumsum([len(c) for c in clusters]))).astype(np.int64),
        np.array(ground, np.float32),
        np.array(labels, np.int64),
        np.array(groups, np.int64),
    )


def join_clusters(parts: list[LabelledClusters]) -> LabelledClusters:
    """Several sets as one; their groups are kept apart."""
    shift, offsets, groups = 0, [np.zeros(1, np.int64)], []
    for part in parts:
        offsets.append(part.offsets[1:] + shift)
        shift += len(part.points)
    start = 0
    for part in parts:
        groups.append(part.groups + start)
        start += int(part.groups.max(initial=-1)) + 1
    return LabelledClusters(
        np.concatenate([p.points for p in parts]),
        np.concatenate(offsets),
        np.concatenate([p.ground_z_m for p in parts]),
        np.concatenate([p.labels for p in parts]),
        np.concatenate(groups),
    )
