"""Geometric features of clusters, the article's sets and our own, in one compiled pass.

The definitions are those of the article's table (bonsai89/lidar-perception-pipeline, feature sets of 9 to 35), with
three changes: heights are above the *local ground* instead of absolute, so that a cluster reads the same on a slope and
in a centred file; their percentiles are told from 256 bins, to a 255th of the cluster's height; and our own set does
without the 3-D hull and the neighbour search, which cost more than all others together, and has the fill of the
bird's-eye hull and the extent of every height slice instead.

Every feature is finite for every cluster, a single point included: what cannot be computed is 0 (1 for
``hull_point_ratio``, as in the article).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from services.infra_lidar.buffers import Buffers
from services.infra_lidar.feature_kernels import ALL_NAMES, cluster_features
from services.infra_lidar.feature_pieces import hull_point_ratio, piece_features
from services.infra_lidar.feature_spacing import cluster_spacing

SPACING = "nn_dist_std"  # needs the search for neighbours, which costs more than all others together

_BOX = (
    "xy_spread", "xy_area", "z_range", "height_to_footprint", "density", "z_25", "z_75", "z_std", "num_points",
)  # fmt: skip
_LAYERS = ("layer_frac_0", "layer_frac_1", "layer_frac_2", "layer_frac_3", "layer_frac_4")
_LOCAL = ("nn_dist_std", "cross_section_mean", "z_range_cleaned", "hull_point_ratio")
_REDUNDANT = (
    "x_range", "y_range", "bbox_volume", "z_median", "ev_norm_0", "ev_norm_1", "ev_norm_2", "vertical_uniformity",
    "bottom_to_top_ratio", "n_components", "largest_component_ratio", "ground_gap_ratio",
)  # fmt: skip
_OWN = (
    "x_range", "y_range", "z_median", "z_bottom", "z_top", "hull_fill", "range_m", "points_by_range",
    "slice_length_0", "slice_length_1", "slice_length_2", "slice_length_3", "slice_length_4",
    "slice_width_0", "slice_width_2", "slice_width_4", "ground_gap_ratio",
)  # fmt: skip
_FROM_RANGE = ("range_m", "points_by_range")

_SET_11 = (*_BOX, "xy_aspect_ratio", "scattering")
_SET_13 = (*_SET_11, "linearity", "planarity")
_SET_18 = (*_SET_13, *_LAYERS)
_SET_19 = (*_SET_18, "cross_section_var")
_SET_23 = (*_SET_19, *_LOCAL)

FEATURE_SETS: dict[str, tuple[str, ...]] = {
    "9": _BOX,
    "11": _SET_11,
    "13": _SET_13,
    "18": _SET_18,
    "19": _SET_19,
    "23": _SET_23,
    "35": (*_SET_23, *_REDUNDANT),
    "spotter": (*_SET_19, "cross_section_mean", "z_range_cleaned", *_OWN),
    "shape": (*_SET_19, "cross_section_mean", "z_range_cleaned", *(n for n in _OWN if n not in _FROM_RANGE)),
}
"""By name. ``spotter`` is the default; ``shape`` is the same without what needs the distance to the sensor, for
clusters that were centred when they were stored."""

_INDEX = {name: column for column, name in enumerate(ALL_NAMES)}
_PIECE_NAMES = ("n_components", "largest_component_ratio")


def compute_features(
    points: np.ndarray, offsets: np.ndarray, ground_z_m: np.ndarray, names: tuple[str, ...],
    buffers: Buffers | None = None, spacing: bool = True, counts: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """The features ``names`` of K clusters.

    Args:
        points: (M, 3) float32, metres, in the levelled frame with the sensor above (0, 0); grouped by cluster.
            Kept planar, as the transpose of a (3, M) array, they are not copied.
        offsets: (K + 1,) int64, cluster k is ``points[offsets[k]:offsets[k + 1]]``.
        ground_z_m: (K,) height of the local ground under each cluster, metres, in the frame of ``points``.
        names: which features, in which order (see ``FEATURE_SETS``).
        buffers: those of the sensor, so that nothing is allocated for each frame.
        spacing: without it ``nn_dist_std`` is left at 0, if ``may_wait``.
        counts: (K,) how many points each cluster has, if these are only some of them.

    Returns:
        (K, F) float32, finite.

    Raises:
        ValueError: an unknown name, an empty cluster, or shapes that do not belong together.
    """
    offsets = np.ascontiguousarray(offsets, np.int64)
    ground = np.ascontiguousarray(ground_z_m, np.float32)
    _check(points, offsets, ground)
    counts = np.diff(offsets) if counts is None else np.ascontiguousarray(counts, np.int64)
    planar = np.ascontiguousarray(points.T, np.float32)
    return features_of(planar, offsets, counts, ground, wanted_of(names), buffers or Buffers(), spacing)


def features_of(
    planar: np.ndarray, offsets: np.ndarray, counts: np.ndarray, ground_z_m: np.ndarray, wanted: Wanted,
    buffers: Buffers, spacing: bool,
) -> np.ndarray:  # fmt: skip
    """The same of points planar (3, M) float32, where all fits together; offsets and counts of any integers, ground_z_m
    float32.

    Raises:
        ValueError: an empty cluster.
    """
    table = np.empty((len(ground_z_m), len(wanted.columns)), np.float32)
    if not cluster_features(planar, offsets, counts, ground_z_m, wanted.hull, wanted.columns, table):
        raise ValueError("offsets: every cluster needs at least one point")
    if wanted.neighbours or wanted.hull_points:
        offsets = np.asarray(offsets, np.int64)
    if wanted.neighbours and (spacing or wanted.pieces):
        every = np.arange(len(table))
        deviation_m, nearest_m = cluster_spacing(planar, offsets, every, wanted.pieces, buffers)
        table[:, wanted.columns == _INDEX[SPACING]] = deviation_m[:, None]
    if wanted.pieces:
        pieces = piece_features(np.ascontiguousarray(planar.T), offsets, nearest_m)
        for k, name in enumerate(_PIECE_NAMES):
            table[:, wanted.columns == _INDEX[name]] = pieces[:, k : k + 1]
    if wanted.hull_points:
        table[:, wanted.columns == _INDEX["hull_point_ratio"]] = hull_point_ratio(planar.T, offsets)[:, None]
    return table


def compute_spacing(
    planar: np.ndarray, offsets: np.ndarray, which: np.ndarray, buffers: Buffers | None = None
) -> np.ndarray:
    """``nn_dist_std`` of the clusters ``which`` alone, (J,) float32; the rest as for ``features_of``."""
    return cluster_spacing(planar, np.ascontiguousarray(offsets, np.int64), which, False, buffers or Buffers())[0]


def may_wait(names: tuple[str, ...]) -> bool:
    """Whether ``nn_dist_std`` is among the features, and no other one needs the search for neighbours."""
    wanted = wanted_of(names)
    return wanted.neighbours and not wanted.pieces


@dataclass(frozen=True)
class Wanted:
    """Columns of ``ALL_NAMES``, and which of the costly ones are among them."""

    columns: np.ndarray
    hull: bool
    neighbours: bool
    pieces: bool
    hull_points: bool


@lru_cache(maxsize=32)
def wanted_of(names: tuple[str, ...]) -> Wanted:
    """What is to be computed for these. Raises ``ValueError`` on an unknown name."""
    unknown = sorted(set(names) - _INDEX.keys())
    if unknown:
        raise ValueError(f"unknown feature(s) {unknown}; known: {', '.join(ALL_NAMES)}")
    pieces = any(name in names for name in _PIECE_NAMES)
    return Wanted(
        columns=np.array([_INDEX[name] for name in names], np.intp), hull="hull_fill" in names,
        neighbours=pieces or SPACING in names, pieces=pieces, hull_points="hull_point_ratio" in names,
    )  # fmt: skip


def _check(points: np.ndarray, offsets: np.ndarray, ground: np.ndarray) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points: expected shape (M, 3), got {points.shape}")
    if offsets.ndim != 1 or len(offsets) != len(ground) + 1:
        raise ValueError(f"offsets: expected {len(ground) + 1} values for {len(ground)} clusters, got {offsets.shape}")
    if len(offsets) and (offsets[0] != 0 or offsets[-1] != len(points)):
        raise ValueError(f"offsets: expected 0 .. {len(points)}, got {offsets[0]} .. {offsets[-1]}")
