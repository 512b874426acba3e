"""The kernels' own sorting and sifting against numpy's."""

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.infra_lidar import ordering
from services.infra_lidar.jit import alone
from services.infra_lidar.ordering import COUNTED, places_of
from services.infra_lidar.vectors import LANES

rising, sort_rising = alone(ordering.rising), alone(ordering.sort_rising)
NUMBERS = st.lists(st.floats(-1e6, 1e6, width=32), max_size=120)


@numba.njit
def _places(flags):
    return places_of(flags)


@given(NUMBERS)
def test_rising_is_numpys_stable_argsort(numbers):
    keys = np.array(numbers, np.float64)
    assert np.array_equal(rising(keys), np.argsort(keys, kind="stable"))


@pytest.mark.parametrize("n", [0, 1, LANES, COUNTED, COUNTED + 1, 3000])
def test_many_with_equals_among_them_rise_as_well(n):
    keys = np.random.default_rng(n).integers(0, 200, n) / 8.0
    assert np.array_equal(rising(keys), np.argsort(keys, kind="stable"))


def test_what_is_no_number_comes_last():
    keys = np.array([2.0, np.nan, -np.inf, np.nan, 1.0])
    assert rising(keys).tolist() == [2, 4, 0, 1, 3]


@given(NUMBERS)
def test_sorted_in_place(numbers):
    values = np.array(numbers, np.float32)
    expected = np.sort(values)
    sort_rising(values)
    assert np.array_equal(values, expected)


@given(st.lists(st.integers(-1, 1), max_size=60))
def test_places_are_numpys_flatnonzero(numbers):
    for flags in (np.array(numbers, np.int64), np.array(numbers, np.int64) > 0):
        assert np.array_equal(_places(flags), np.flatnonzero(flags))
