"""The article's costly features: spacing of neighbours, DBSCAN components and the 3-D hull.

Spotter's forest uses none of them.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.classification import features as own
from services.infra_lidar.classification.features import ARTICLE_19, FEATURE_SETS

NEIGHBOURS = 5
_SET_23 = (*ARTICLE_19, "nn_dist_std", "cross_section_mean", "z_range_cleaned", "hull_point_ratio")
_REDUNDANT = (
    "x_range", "y_range", "bbox_volume", "z_median", "ev_norm_0", "ev_norm_1", "ev_norm_2", "vertical_uniformity",
    "bottom_to_top_ratio", "n_components", "largest_component_ratio", "ground_gap_ratio",
)  # fmt: skip
ARTICLE_SETS: dict[str, tuple[str, ...]] = {
    **{str(size): ARTICLE_19[:size] for size in (9, 11, 13, 18, 19)},
    "23": _SET_23,
    "35": (*_SET_23, *_REDUNDANT),
}
"""The article's sets by their size; each begins with the one before it."""
ALL_SETS = ARTICLE_SETS | FEATURE_SETS
"""The article's sets and Spotter's own."""


def compute_features(
    points: np.ndarray, offsets: np.ndarray, ground_z_m: np.ndarray, names: tuple[str, ...]
) -> np.ndarray:
    """As ``classification.features.compute_features``, and the article's costly features besides."""
    kept = tuple(name for name in names if name not in ("nn_dist_std", "hull_point_ratio", *_PIECES))
    columns = dict(zip(kept, own.compute_features(points, offsets, ground_z_m, kept).T, strict=True))
    if "nn_dist_std" in names:
        columns["nn_dist_std"] = spacing_deviation(points, offsets)
    if "hull_point_ratio" in names:
        columns["hull_point_ratio"] = hull_point_ratio(points, offsets)
    if set(_PIECES) & set(names):
        columns |= dict(zip(_PIECES, components(points, offsets).T, strict=True))
    return np.column_stack([columns[name] for name in names]).astype(np.float32)


_PIECES = ("n_components", "largest_component_ratio")


def spacing_deviation(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(K,) float32, metres: standard deviation, over the points of a cluster, of the mean distance to the five nearest
    others; 0 for up to six points."""
    from scipy.spatial import cKDTree

    out = np.zeros(len(offsets) - 1, np.float32)
    for k in range(len(out)):
        cluster = points[offsets[k] : offsets[k + 1]]
        if len(cluster) > NEIGHBOURS + 1:
            out[k] = cKDTree(cluster).query(cluster, NEIGHBOURS + 1)[0][:, 1:].mean(axis=1).std()
    return out


def components(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(K, 2) float32: number of DBSCAN components (three points a core, eps 2.5 times the median distance to the
    nearest point) and share of the points in the largest."""
    from scipy.spatial import cKDTree
    from sklearn.cluster import DBSCAN

    out = np.zeros((len(offsets) - 1, 2), np.float32)
    for k in range(len(out)):
        cluster = points[offsets[k] : offsets[k + 1]]
        out[k] = len(cluster), 1.0
        if len(cluster) > 1:
            nearest_m = np.median(cKDTree(cluster).query(cluster, 2)[0][:, 1])
            label = DBSCAN(eps=max(2.5 * nearest_m, 1e-6), min_samples=3).fit_predict(cluster)
            sizes = np.bincount(label[label >= 0], minlength=1)
            out[k] = label.max() + 1, sizes.max() / len(cluster)
    return out


def hull_point_ratio(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(K,) float32: vertices of the 3-D convex hull per point; 1 for up to 10 points or a flat cluster."""
    from scipy.spatial import ConvexHull, QhullError

    out = np.ones(len(offsets) - 1, np.float32)
    for k in range(len(out)):
        cluster = points[offsets[k] : offsets[k + 1]].astype(np.float64)
        if len(cluster) > 10:
            try:
                out[k] = len(ConvexHull(cluster).vertices) / len(cluster)
            except QhullError:
                out[k] = 1.0  # all points in one plane
    return out
