"""The article's costly features by their definitions, its sets, and the table over them."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist

pytest.importorskip("sklearn", reason="needs the train extra")
pytest.importorskip("matplotlib", reason="needs the plot extra")

from benchmarks.article.ablation import ablation, confidence_gap, draw, heading, row
from benchmarks.article.costly_features import ALL_SETS, ARTICLE_SETS, compute_features
from services.infra_lidar.training.evaluate import judge
from services.infra_lidar.training.varied import generated_clusters

COSTLY = ("nn_dist_std", "n_components", "largest_component_ratio", "hull_point_ratio")


def features(points: np.ndarray, *names: str) -> np.ndarray:
    """Of one cluster."""
    return compute_features(points.astype(np.float32), np.array([0, len(points)]), np.zeros(1), names)[0]


def test_the_sets_have_the_sizes_of_the_article_and_each_begins_with_the_one_before() -> None:
    for size, names in ARTICLE_SETS.items():
        assert len(names) == len(set(names)) == int(size)
    assert all(large[: len(small)] == small for small, large in pairwise(ARTICLE_SETS.values()))


@pytest.mark.parametrize(("n", "groups"), [(40, 1), (40, 2), (60, 3)])
def test_pieces_inside_a_cluster_are_counted(n: int, groups: int) -> None:
    grid = np.stack(np.meshgrid(np.arange(n // groups) * 0.1, [0.0, 0.1], [0.0, 0.1]), -1).reshape(-1, 3)
    points = np.concatenate([grid + np.array([0.0, 5.0 * g, 0.0]) for g in range(groups)])
    assert features(points, "n_components", "largest_component_ratio") == pytest.approx([groups, 1 / groups])


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000), n=st.integers(7, 400), size=st.tuples(*[st.sampled_from([0.0, 0.01, 0.5, 12.0])] * 3)
)
def test_neighbours_are_exact_in_every_shape(seed: int, n: int, size: tuple[float, float, float]) -> None:
    """Lines, plates, lumps with far outliers, doubled points: always the same as all pairs."""
    rng = np.random.default_rng(seed)
    points = (rng.uniform(0, 1, (n, 3)) ** rng.choice([1, 4]) * size).astype(np.float32)
    points[: n // 5] = points[n // 2]
    distance = np.sort(cdist(points.astype(float), points.astype(float)), axis=1)
    assert features(points, "nn_dist_std")[0] == pytest.approx(distance[:, 1:6].mean(axis=1).std(), rel=1e-3, abs=1e-5)


def test_the_share_of_points_on_the_hull() -> None:
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (200, 3))
    assert features(points, "hull_point_ratio")[0] == pytest.approx(len(ConvexHull(points).vertices) / 200, abs=0.006)


@pytest.mark.parametrize("points", [1, 2, 6, 7, 11, 33])
def test_tiny_and_flat_clusters_are_finite(points: int) -> None:
    line = np.column_stack((np.arange(points), np.zeros(points), np.zeros(points)))
    for cluster in (np.full((points, 3), 7.0), line):
        assert np.all(np.isfinite(features(cluster, *COSTLY)))


def test_one_forest_a_set_its_row_and_the_picture(tmp_path: Path) -> None:
    sets = {name: ALL_SETS[name] for name in ("9", "shape")}
    rows = list(ablation(generated_clusters(1, 10), generated_clusters(2, 5), sets))
    assert [name for name, _ in rows] == ["9", "shape"]
    assert all(0.3 < result.macro_f1 <= 1.0 for _, result in rows)  # by lot: 0.2
    cells = row(*rows[0]).split()
    assert (len(cells), cells[1], cells[-1]) == (len(heading().replace("macro F1", "F1").split()), "9", "0.731")
    draw(rows, tmp_path / "ablation.png")
    assert (tmp_path / "ablation.png").read_bytes().startswith(b"\x89PNG")


def test_the_gap_of_confidence_by_hand() -> None:
    shares = np.array([[0.9, 0.1, 0, 0, 0], [0.2, 0.8, 0, 0, 0], [0.6, 0.4, 0, 0, 0], [0, 0, 0, 0.7, 0.3]])
    assert confidence_gap(judge(shares, np.array([0, 1, 1, 4]))) == pytest.approx(0.85 - 0.65)
    assert np.isnan(confidence_gap(judge(shares, shares.argmax(axis=1))))
