"""The benchmark's neighbour search against scipy's tree."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.article import costly_features
from benchmarks.article.neighbours import LANES, MOST_POINTS, neighbour_distances, spacing_deviation

SHAPES = {
    "a ball": lambda rng, n: rng.normal(size=(n, 3)),
    "a wall": lambda rng, n: rng.uniform([0, 0, 0], [9, 0.02, 3], (n, 3)),
    "a line": lambda rng, n: rng.uniform([0, 0, 0], [5, 0, 0], (n, 3)),
    "one place": lambda rng, n: np.zeros((n, 3)),
    "two heaps": lambda rng, n: rng.normal(size=(n, 3)) * 0.01 + np.where(np.arange(n)[:, None] % 2, 40.0, 0.0),
}


@pytest.mark.parametrize("shape", SHAPES)
@given(n=st.integers(1, 400), seed=st.integers(0, 99))
@settings(max_examples=15)
def test_distances_are_those_of_the_tree(shape, n, seed):
    points = SHAPES[shape](np.random.default_rng(seed), n).astype(np.float32)
    offsets = np.array([0, n // 3, n]) if n >= 3 else np.array([0, n])
    expected = costly_features.spacing_deviation(points, offsets)
    np.testing.assert_allclose(spacing_deviation(points, offsets), expected, atol=2e-5, rtol=1e-3)


@pytest.mark.parametrize("shape", ["a wall", "a line", "two heaps"])  # in the tail of a ball few points decide
@pytest.mark.parametrize("n", [MOST_POINTS, MOST_POINTS + 1, 3000])
def test_of_a_large_cluster_a_part_is_looked_at(shape, n):
    points, offsets = SHAPES[shape](np.random.default_rng(n), n).astype(np.float32), np.array([0, n])
    asked = len(neighbour_distances(points))
    assert asked == MOST_POINTS if n == MOST_POINTS else MOST_POINTS / 2 - LANES <= asked <= MOST_POINTS + LANES
    expected = costly_features.spacing_deviation(points, offsets)
    np.testing.assert_allclose(spacing_deviation(points, offsets), expected, rtol=1e-3 if n == MOST_POINTS else 0.2)
