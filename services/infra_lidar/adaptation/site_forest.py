"""Trains the forest of a site on its own clusters and on generated ones, so that it does not unlearn other cases."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from services.infra_lidar.adaptation.labels import SiteLabels
from services.infra_lidar.adaptation.recorder import SiteRecord
from services.infra_lidar.classification.feature_kernels import FEATURE_NAMES
from services.infra_lidar.classification.features import FEATURE_SETS, compute_features
from services.infra_lidar.classification.forest import Forest
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.training.clusters import LabelledClusters
from services.infra_lidar.training.scenes import Steps, scene_clusters
from services.infra_lidar.training.train import (
    BACKGROUND_WEIGHT,
    ForestSettings,
    TrainedForest,
    calibrate,
    expected_weight,
    flatten,
    generated_set,
    out_of_group_shares,
)

FEATURES = FEATURE_NAMES  # of every example: all, so that any forest in use can be evaluated
_GROWN = FEATURE_SETS["spotter"]
_COLUMNS = [FEATURES.index(name) for name in _GROWN]
SEED, STREETS, BODIES = 3000, 40, 700  # generated streets from this seed on, twice as many, and bodies per class
UNSEEN_SEED, UNSEEN_STREETS = 6000, 6  # streets that no forest was trained on, to measure what was unlearned
SETTINGS = ForestSettings(seed=SEED, background=BACKGROUND_WEIGHT, balanced=False)
"""Not refined: with the few clusters of a small site, a refined forest unlearned its clutter less well."""
GROUP_WEIGHT = 4.0  # greatest weight of one road user or place of the site; a cluster of a street weighs 1
FOLDS = 3


class Examples(NamedTuple):
    """K labelled clusters: features (K, F) as in ``FEATURES``, labels, groups (K,) and weight (K,)."""

    x: np.ndarray
    labels: np.ndarray
    groups: np.ndarray
    weight: np.ndarray


def generated_examples(config: InfraLidarConfig) -> Examples:
    """Streets and bodies of all classes, made with this site's settings of ground and clusters."""
    return _examples(*generated_set(Steps.of(config), STREETS, BODIES, SEED))


def unseen_examples(config: InfraLidarConfig) -> Examples:
    """Streets of other seeds, to measure what the new forest has unlearned."""
    streets = scene_clusters(range(UNSEEN_SEED, UNSEEN_SEED + UNSEEN_STREETS), Steps.of(config), frames=1)
    return _examples(streets, np.ones(len(streets)))


def site_examples(record: SiteRecord, labels: SiteLabels) -> Examples:
    """The labelled clusters of the site; those of one group share ``GROUP_WEIGHT``."""
    size = np.bincount(labels.groups)[labels.groups]
    weight = np.minimum(1.0, GROUP_WEIGHT / size)
    return Examples(record.x[labels.rows], labels.labels, labels.groups, weight)


def grow(examples: Examples, provenance: dict[str, Any]) -> Forest:
    """A forest of all examples, calibrated with the trees' results for groups that they were not trained on.

    provenance: is stored in the model's header.
    """

    x = examples.x[:, _COLUMNS]

    def fit(rows: np.ndarray) -> TrainedForest:
        return SETTINGS.grow(x[rows], examples.labels[rows], examples.weight[rows])

    shares = out_of_group_shares(fit, x, examples.groups, FOLDS)
    expected = expected_weight(examples.labels, examples.weight, SETTINGS.background)
    curve_x, curve_y = calibrate(shares, examples.labels, expected)
    return flatten(fit(np.arange(len(x))), _GROWN, curve_x, curve_y, provenance)


def join(first: Examples, second: Examples) -> Examples:
    """Both sets together; their groups stay different."""
    groups = np.concatenate((first.groups, second.groups + first.groups.max(initial=-1) + 1))
    pairs = (np.concatenate(pair) for pair in zip(first, second, strict=True))
    return Examples(*pairs)._replace(groups=groups)


def _examples(clusters: LabelledClusters, weight: np.ndarray) -> Examples:
    x = compute_features(clusters.points, clusters.offsets, clusters.ground_z_m, FEATURES)
    return Examples(x, clusters.labels, clusters.groups, weight)
