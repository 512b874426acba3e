"""Stray returns of a bus seen along its side: who takes them, and what is never taken."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.infra_lidar import kernels_adopt, kernels_footprints
from services.infra_lidar.jit import alone

adopt_strays = alone(kernels_adopt.adopt_strays)
footprints = alone(kernels_footprints.footprints)
END_FACE = (60.0, 0.0, 1.6, 2.4, 0.1, 2.6, np.pi / 2, 0.3)  # x, y, z, length, width, height, yaw, gap to the road
FEW = 10


def _point(x, y, above=1.5):
    return (x, y, above, 0.0, 0.0, 0.0, 0.0, above)


def _adopt(pieces, counts, group=None):
    box, counts = np.array(pieces, np.float32), np.array(counts, np.int64)
    group = np.arange(len(box), dtype=np.int32) if group is None else np.array(group, np.int32)
    adopt_strays(footprints(box), counts, FEW, group)
    return group


def test_an_end_face_takes_the_single_returns_along_the_side_behind_it():
    side = [_point(60.0 + 2.1 * k, -1.2) for k in range(1, 6)]  # 60 m away the columns hit the side every 2 m
    group = _adopt([END_FACE, *side], [30, 1, 1, 1, 1, 1])
    assert (group == 0).all()


@pytest.mark.parametrize(
    ("stray", "why"),
    [
        (_point(62.0, -4.5), "beside the vehicle"),
        (_point(66.0, -1.2), "behind a gap of six metres"),
        (_point(62.0, -1.2, above=5.0), "higher than any vehicle"),
    ],
)
def test_what_does_not_continue_the_vehicle_is_left(stray, why):
    assert _adopt([END_FACE, stray], [30, 1]).tolist() == [0, 1], why


def test_it_never_grows_longer_than_a_large_vehicle():
    side = [_point(60.0 + 2.0 * k, -1.2) for k in range(1, 20)]
    group = _adopt([END_FACE, *side], [30] + [1] * 19)
    longest_m = max(2.0 * k for k in range(20) if group[k] == 0)
    assert 12.0 <= longest_m <= 14.0


def test_a_car_takes_nothing():
    car = (60.0, 0.0, 0.8, 4.2, 1.8, 1.3, 0.0, 0.2)
    assert _adopt([car, _point(63.0, 0.0)], [60, 1]).tolist() == [0, 1]


@given(
    st.lists(
        st.tuples(st.floats(-15, 15), st.floats(-15, 15), st.floats(0.0, 4.5), st.integers(1, 40)),
        min_size=1, max_size=30,
    )
)  # fmt: skip
def test_no_cluster_loses_a_piece_and_every_piece_has_one_place(things):
    pieces = [(x, y, top / 2, 0.5, 0.3, top, 0.3, 0.0) for x, y, top, _ in things]
    counts = [count for *_, count in things]
    group = _adopt(pieces, counts)
    for k, count in enumerate(counts):
        if count >= FEW:
            assert group[k] == k
        else:
            assert group[k] == k or counts[group[k]] >= FEW
