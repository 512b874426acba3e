"""Azimuth by a polynomial, against NumPy's arctan2 in double precision."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.segmentation.azimuth import azimuth_of

COORDINATE = st.floats(-1e4, 1e4, width=32)


@given(places=st.lists(st.tuples(COORDINATE, COORDINATE), min_size=1, max_size=40))
@settings(max_examples=200)
def test_azimuth_is_exact_to_a_millionth(places):
    x, y = np.array(places, np.float32).T.copy()
    off = azimuth_of(x, y) - np.arctan2(y.astype(np.float64), x.astype(np.float64))
    off = off[np.hypot(x.astype(np.float64), y.astype(np.float64)) > 1e-20]  # no angle at the sensor itself
    assert np.abs((off + np.pi) % (2.0 * np.pi) - np.pi).max(initial=0.0) < 1e-6


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [(0, 0, 0.0), (2, 0, 0.0), (3, 3, 0.25), (0, 5, 0.5), (-1, 1, 0.75), (-4, 0, 1.0), (0, -2, -0.5), (1, -1, -0.25)],
)
def test_azimuth_of_whole_eighths_of_a_turn(x, y, expected):
    azimuth = azimuth_of(np.array([x], np.float32), np.array([y], np.float32))
    assert azimuth == pytest.approx(expected * np.pi, abs=1e-6)


def test_no_points_have_no_azimuth():
    assert azimuth_of(np.empty(0, np.float32), np.empty(0, np.float32)).shape == (0,)
