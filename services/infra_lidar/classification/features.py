"""Geometric features of clusters.

The definitions are those of the article's table (bonsai89/lidar-perception-pipeline), with three changes: heights are
above the local ground instead of absolute, so that a cluster has the same features on a slope and in a centred file;
their percentiles are counted in 256 bins, exact to a 255th of the cluster's height; and our own set has the fill of the
hull seen from above, the length of every height slice and the width of three instead of the 3-D hull and the neighbour
search. The article's costly features are in ``benchmarks/article/costly_features.py``.

Of a cluster with ``MOST_POINTS`` points or more a part is looked at: fewer than 1,024 of them, evenly chosen.

Every feature is finite for every cluster, a single point included: what cannot be computed is 0.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from services.infra_lidar.classification.band_kernels import BAND_NAMES, BANDS
from services.infra_lidar.classification.feature_kernels import FEATURE_NAMES, SLICES, cluster_features

ARTICLE_19: tuple[str, ...] = (
    "xy_spread", "xy_area", "z_range", "height_to_footprint", "density", "z_25", "z_75", "z_std", "num_points",
    "xy_aspect_ratio", "scattering", "linearity", "planarity",
    "layer_frac_0", "layer_frac_1", "layer_frac_2", "layer_frac_3", "layer_frac_4", "cross_section_var",
)  # fmt: skip
"""The article's set of 19 features, in its order."""

_OWN = (
    "x_range", "y_range", "z_median", "z_bottom", "z_top", "hull_fill",
    "slice_length_0", "slice_length_1", "slice_length_2", "slice_length_3", "slice_length_4",
    "slice_width_0", "slice_width_2", "slice_width_4", "ground_gap_ratio",
)  # fmt: skip
FROM_RANGE = ("depth_scatter", "depth_extent")
_OF_THE_SENSOR = ("num_points", "density", "range_m", "points_by_range")  # beams and spacing decide them, not the body
_BANDS = tuple(name for name in BAND_NAMES if name not in FROM_RANGE)
_ALL = (*ARTICLE_19, "cross_section_mean", "z_range_cleaned", *_OWN, *_BANDS)
_SHAPE = tuple(name for name in _ALL if name not in _OF_THE_SENSOR)
_OF_THE_SPREAD = (
    "scattering", "linearity", "planarity", "cross_section_var", "cross_section_mean", "depth_scatter",
    *(f"layer_frac_{s}" for s in range(SLICES)), *(f"band_frac_{b}" for b in range(BANDS)),
)  # fmt: skip
"""How the returns are spread over a body: decided by beams, glass and dark paint as much as by the body."""

FEATURE_SETS: dict[str, tuple[str, ...]] = {
    "spotter": (*_SHAPE, *FROM_RANGE),
    "any_sensor": tuple(name for name in (*_SHAPE, *FROM_RANGE) if name not in _OF_THE_SPREAD),
    "shape": _SHAPE,
}
"""By name. ``spotter`` is for the sensor that the examples are from, ``any_sensor`` for others, too. ``shape`` is
``spotter`` without what needs the distance to the sensor, for clusters that were centred when they were stored."""


def compute_features(
    points: np.ndarray, offsets: np.ndarray, ground_z_m: np.ndarray, names: tuple[str, ...]
) -> np.ndarray:
    """The features ``names`` of K clusters.

    Args:
        points: (M, 3+) float32, x, y, z in metres, in the level frame with the sensor above (0, 0); grouped by cluster.
        offsets: (K + 1,) integers, cluster k is ``points[offsets[k]:offsets[k + 1]]``.
        ground_z_m: (K,) height of the local ground under each cluster, metres, in the frame of ``points``.
        names: which features, in which order (see ``FEATURE_SETS``).

    Returns:
        (K, F) float32, finite.

    Raises:
        ValueError: an unknown name, an empty cluster, or shapes that do not belong together.
    """
    columns = _columns(names)
    points = np.ascontiguousarray(points, np.float32)
    offsets = np.ascontiguousarray(offsets, np.int64)
    ground = np.ascontiguousarray(ground_z_m, np.float32)
    _check(points, offsets, ground)
    table = np.empty((len(ground), len(FEATURE_NAMES)), np.float32)
    bands = not set(BAND_NAMES).isdisjoint(names)
    cluster_features(points, offsets, ground, "hull_fill" in names, bands, table)
    return table.take(columns, axis=1)


@cache
def _columns(names: tuple[str, ...]) -> np.ndarray:
    """(F,) place of each name in ``FEATURE_NAMES``."""
    unknown = sorted(set(names) - set(FEATURE_NAMES))
    if unknown:
        raise ValueError(f"unknown feature(s) {unknown}; known: {', '.join(FEATURE_NAMES)}")
    return np.array([FEATURE_NAMES.index(name) for name in names], np.intp)


def _check(points: np.ndarray, offsets: np.ndarray, ground: np.ndarray) -> None:
    if points.ndim != 2 or points.shape[1] < 3:
        raise ValueError(f"points: expected shape (M, 3+), got {points.shape}")
    if offsets.ndim != 1 or len(offsets) != len(ground) + 1:
        raise ValueError(f"offsets: expected {len(ground) + 1} values for {len(ground)} clusters, got {offsets.shape}")
    if offsets[0] != 0 or offsets[-1] != len(points):
        raise ValueError(f"offsets: expected 0 .. {len(points)}, got {offsets[0]} .. {offsets[-1]}")
    if np.any(np.diff(offsets) <= 0):
        raise ValueError("offsets: every cluster needs at least one point")
