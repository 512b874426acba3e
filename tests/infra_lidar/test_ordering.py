"""The kernels' own sorting against numpy's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from services.infra_lidar.ordering import rising, sort_rising

NUMBERS = st.lists(st.floats(-1e6, 1e6, width=32), max_size=120)


@given(NUMBERS)
def test_rising_is_numpys_stable_argsort(numbers):
    keys = np.array(numbers, np.float64)
    assert np.array_equal(rising(keys), np.argsort(keys, kind="stable"))


@given(NUMBERS)
def test_sorted_in_place(numbers):
    values = np.array(numbers, np.float32)
    expected = np.sort(values)
    sort_rising(values)
    assert np.array_equal(values, expected)
