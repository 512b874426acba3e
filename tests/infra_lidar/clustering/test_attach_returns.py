"""Single returns of a bus seen along its side: which are attached to it, and which never."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.infra_lidar.clustering.attach_returns import attach_small_fragments
from services.infra_lidar.clustering.merge_vehicles import footprints

END_FACE = (60.0, 0.0, 1.6, 2.4, 0.1, 2.6, np.pi / 2, 0.3)  # x, y, z, length, width, height, yaw, gap to the road
FEW = 10


def _point(x, y, above=1.5):
    return (x, y, above, 0.0, 0.0, 0.0, 0.0, above)


def _attach(pieces, counts, group=None):
    box, counts = np.array(pieces, np.float32), np.array(counts, np.int64)
    group = np.arange(len(box), dtype=np.int32) if group is None else np.array(group, np.int32)
    attach_small_fragments(footprints(box), counts, FEW, group)
    return group


def test_an_end_face_takes_the_single_returns_along_the_side_behind_it():
    side = [_point(60.0 + 2.1 * k, -1.2) for k in range(1, 6)]  # 60 m away the columns hit the side every 2 m
    group = _attach([END_FACE, *side], [30, 1, 1, 1, 1, 1])
    assert (group == 0).all()


@pytest.mark.parametrize(
    ("single", "why"),
    [
        (_point(62.0, -4.5), "beside the vehicle"),
        (_point(66.0, -1.2), "behind a gap of six metres"),
        (_point(62.0, -1.2, above=5.0), "higher than any vehicle"),
    ],
)
def test_what_does_not_continue_the_vehicle_is_left(single, why):
    assert _attach([END_FACE, single], [30, 1]).tolist() == [0, 1], why


def test_it_never_grows_longer_than_a_large_vehicle():
    side = [_point(60.0 + 2.0 * k, -1.2) for k in range(1, 20)]
    group = _attach([END_FACE, *side], [30] + [1] * 19)
    longest_m = max(2.0 * k for k in range(20) if group[k] == 0)
    assert 12.0 <= longest_m <= 14.0


def test_a_car_takes_nothing():
    car = (60.0, 0.0, 0.8, 4.2, 1.8, 1.3, 0.0, 0.2)
    assert _attach([car, _point(63.0, 0.0)], [60, 1]).tolist() == [0, 1]


@given(
    st.lists(
        st.tuples(st.floats(-15, 15), st.floats(-15, 15), st.floats(0.0, 4.5), st.integers(1, 40)),
        min_size=1, max_size=30,
    )
)  # fmt: skip
def test_no_cluster_loses_a_piece_and_every_piece_has_one_place(things):
    pieces = [(x, y, top / 2, 0.5, 0.3, top, 0.3, 0.0) for x, y, top, _ in things]
    counts = [count for *_, count in things]
    group = _attach(pieces, counts)
    large = [k for k, count in enumerate(counts) if count >= FEW]
    assert len({group[k] for k in large}) == len(large)  # each keeps a group of its own
    for k in range(len(counts)):
        assert group[group[k]] == group[k] <= k
        members = np.flatnonzero(group == group[k])
        assert len(members) == 1 or sum(counts[j] >= FEW for j in members) == 1


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (1, 0, 2)])
def test_a_group_that_loses_its_first_piece_is_named_after_the_next(order):
    """The two loose pieces are one small group, of which the vehicle takes only the one on its side."""
    pieces, counts, of = [END_FACE, _point(62.1, -1.2), _point(62.1, -5.5)], [30, 1, 1], [0, 1, 1]
    place = [order.index(k) for k in range(3)]  # where each piece comes to stand
    group = [min(place[j] for j in range(3) if of[j] == of[k]) for k in order]
    group = _attach([pieces[k] for k in order], [counts[k] for k in order], group)
    for k in range(3):
        assert group[group[k]] == group[k] <= k
    assert group[place[1]] == group[place[0]] != group[place[2]]
