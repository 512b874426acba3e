"""Connected components of bit rows against scipy's labelling of the same cells."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from services.infra_lidar import kernels_labels as kernels
from services.infra_lidar import kernels_runs
from services.infra_lidar.jit import alone
from services.infra_lidar.vectors import LANES

find_runs = alone(kernels_runs.find_runs)
occupy, label_runs = alone(kernels.occupy), alone(kernels.label_runs)
find_rows, join_rows, number_components = map(alone, (kernels.find_rows, kernels.join_rows, kernels.number_components))
ONES = np.ones((3, 3), int)


@given(st.lists(st.tuples(st.integers(-3, 3), st.integers(1, 40)), max_size=12))
@settings(deadline=None, max_examples=60)
def test_runs_begin_where_the_number_changes(pieces):
    values = np.array([number for number, times in pieces for _ in range(times)], np.int32)
    begin = np.zeros(len(values) + 1 + LANES, np.int32)
    runs = find_runs(values, begin)
    changes = [i for i in range(len(values)) if i == 0 or values[i] != values[i - 1]]
    assert begin[: runs + 1].tolist() == [*changes, len(values)]


def _label(cells, connectivity):
    """Labels of a boolean grid by the compiled path: every set cell is one point."""
    side, words = cells.shape[0], (cells.shape[1] + 63) // 64
    row, column = (a.astype(np.int32) for a in np.nonzero(cells))
    grid, touched = np.zeros((side, words, 4), np.uint64), np.zeros((side, (words + 63) // 64), np.uint64)
    key, begin = 2 * (row * np.int32(64 * words) + column) + 1, np.zeros(len(row) + 1 + LANES, np.int32)
    keys = find_runs(key, begin)
    occupy(key, begin, keys, grid, touched, False)
    parent, first, last = (np.zeros(len(row) + 1, np.int32) for _ in range(3))
    row_start = np.zeros(side + 1, np.int32)
    runs = find_rows(grid, touched, kernels.ONCE, parent, first, last, row_start)
    join_rows(parent, first, last, row_start, int(connectivity == 8))
    components = number_components(parent, runs)
    label = np.empty(len(row), np.int32)
    label_runs(key, begin, keys, grid, kernels.ONCE, parent, label)
    return label, components, (row, column)


def _same_partition(a, b):
    pairs = set(zip(a.tolist(), b.tolist(), strict=True))
    return len(pairs) == len(set(a.tolist())) == len(set(b.tolist()))


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000), width=st.integers(1, 200), density=st.floats(0.02, 0.95),
    connectivity=st.sampled_from([4, 8]),
)  # fmt: skip
def test_the_partition_is_scipys(seed, width, density, connectivity):
    cells = np.random.default_rng(seed).random((40, width)) < density
    label, components, (row, column) = _label(cells, connectivity)
    reference, found = ndimage.label(cells, ONES if connectivity == 8 else None)
    assert components == found
    assert _same_partition(label, reference[row, column])


@pytest.mark.parametrize("first", [0, 60, 62, 63, 64, 126, 127])
def test_runs_across_words(first):
    cells = np.zeros((3, 200), bool)
    cells[1, first : first + 70] = True
    cells[0, first + 69] = cells[2, first] = True
    label, components, _ = _label(cells, 4)
    assert components == 1
    assert set(label) == {0}


def test_corners_join_only_with_eight():
    cells = np.eye(5, 70, dtype=bool)
    assert _label(cells, 4)[1] == 5
    assert _label(cells, 8)[1] == 1


def test_cells_with_two_points_are_told_apart():
    row, column = np.array([0, 0, 1], np.int32), np.array([70, 70, 3], np.int32)
    grid, touched = np.zeros((2, 2, 4), np.uint64), np.zeros((2, 1), np.uint64)
    key, begin = 2 * (row * np.int32(128) + column) + 1, np.zeros(4 + LANES, np.int32)
    occupy(key, begin, find_runs(key, begin), grid, touched, True)
    assert grid[0, 1, kernels.TWICE] == np.uint64(1 << 6)
    assert grid[1, 0, kernels.TWICE] == 0
    assert touched[:, 0].tolist() == [2, 1]
