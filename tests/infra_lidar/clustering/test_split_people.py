"""Groups of people: one cluster for each head, and nothing else is cut."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.config import ClusteringConfig
from tests.infra_lidar.made_clusters import clusters_of, solid

HEADS = ClusteringConfig(merge="off")
WHOLE = ClusteringConfig(merge="off", split="off")


def _body(x, y, height_m=1.75, n=300, seed=0):
    """Trunk and legs, and a head on them: (n, 3) on the outside."""
    rng = np.random.default_rng(seed)
    angle, of_head = rng.uniform(0, 2 * np.pi, n), rng.random(n) < 0.2
    above = np.where(of_head, rng.uniform(height_m - 0.24, height_m, n), rng.uniform(0.2, height_m - 0.3, n))
    radius = np.where(of_head, 0.1, 0.22)
    return np.column_stack((x + radius * np.cos(angle), y + radius * np.sin(angle), above))


def _cluster(xyz, config=HEADS):
    return clusters_of(xyz, config)


def _interleaved(*bodies, seed=0):
    """Points of all bodies in any order, and whose each is."""
    owner = np.repeat(np.arange(len(bodies)), [len(b) for b in bodies])
    order = np.random.default_rng(seed).permutation(len(owner))
    return np.vstack(bodies)[order], owner[order]


@pytest.mark.parametrize(
    "places",
    [
        [(8.0, 0.0), (8.0, 0.5)],
        [(8.0, 0.0), (8.5, 0.0)],
        [(8.0, 0.0), (8.0, 0.5), (8.0, 1.0)],
        [(14.0, 3.0), (14.35, 3.35)],
        [(9.0, -5.0), (9.0, -4.5), (9.5, -5.0), (9.5, -4.5)],
    ],
)
def test_people_shoulder_to_shoulder_are_split_by_their_heads(places):
    xyz, owner = _interleaved(*(_body(*place, seed=k) for k, place in enumerate(places)))
    assert len(_cluster(xyz, WHOLE).box) == 1
    found = _cluster(xyz)
    assert len(found.box) == len(places)
    cluster_id = found.cluster_id(len(xyz))
    assert (cluster_id >= 0).all()
    for k in range(len(places)):
        assert np.bincount(cluster_id[owner == k]).max() > 0.97 * (owner == k).sum()
    for box in found.box:
        assert np.hypot(*(np.array(places) - box[:2]).T).min() < 0.05
        assert box[3] < 0.7
        assert box[5] == pytest.approx(1.55, abs=0.05)


def test_a_child_beside_an_adult_is_somebody_of_its_own():
    xyz, _ = _interleaved(_body(8.0, 0.0), _body(8.0, 0.5, height_m=1.35, seed=1))
    tops_m = sorted(box[7] + box[5] for box in _cluster(xyz).box)
    assert tops_m == pytest.approx([1.35, 1.75], abs=0.1)


@pytest.mark.parametrize(
    ("thing", "what"),
    [
        (_body(8, 0), "one person"),
        (np.vstack((_body(8, 0), solid((8, 0.32), (0.3, 0.2), (0.5, 0.9), n=60))), "one with a bag"),
        (solid((8, 0), (1.7, 0.5), (0.2, 1.7)), "a wall as high as people"),
        (np.vstack((solid((8, 0), (1.7, 0.3), (0.2, 1.0)), _body(8, 0))), "a cyclist"),
        (solid((8, 0), (2.3, 0.9), (0.2, 1.3)), "the end of a car"),
        (solid((25, 0), (1.9, 0.9), (1.16, 1.5), n=60), "the roof of a car behind another"),
        (np.vstack((solid((8, 0), (2.2, 1.0), (0.2, 1.0)), _body(7.3, 0), _body(8.7, 0))), "too wide for two people"),
    ],
)
def test_what_is_no_group_stays_whole(thing, what):
    assert len(_cluster(thing).box) == 1, what


def test_people_who_were_split_are_not_joined_again():
    xyz, _ = _interleaved(*(_body(12.0, 0.5 * k, seed=k) for k in range(3)))
    assert len(_cluster(xyz, ClusteringConfig()).box) == 3


def test_upper_bodies_behind_others_are_left_alone_and_pieces_of_a_car_are_not():
    pieces = [((12.0, y), (0.4, 0.45)) for y in (0.0, 0.9)]
    upper = np.vstack([solid(*piece, (1.2, 1.75), n=40) for piece in pieces])
    assert len(_cluster(upper, ClusteringConfig()).box) == 2
    of_a_car = np.vstack([solid(*piece, (0.9, 1.45), n=40) for piece in pieces])
    assert len(_cluster(of_a_car, ClusteringConfig()).box) == 1


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(6, 9), st.floats(-1.5, 1.5), st.floats(1.0, 2.1), st.integers(5, 150)),
        min_size=1, max_size=8,
    ),
    st.integers(0, 9),
)  # fmt: skip
def test_splitting_moves_no_point_in_or_out_and_all_arrays_agree(people, seed):
    xyz, _ = _interleaved(*(_body(x, y, h, n, k) for k, (x, y, h, n) in enumerate(people)), seed=seed)
    xyz = xyz.astype(np.float32)
    split, whole = _cluster(xyz), _cluster(xyz, WHOLE)
    assert len(split.box) >= len(whole.box)
    assert sorted(split.members.tolist()) == sorted(whole.members.tolist())
    assert np.array_equal(split.points[:, :3], xyz[split.members])
    for (first, last), box in zip(pairwise(split.offsets), split.box, strict=True):
        assert box[5] == pytest.approx(np.ptp(split.points[first:last, 2]), abs=1e-4)
    of_whole = whole.cluster_id(len(xyz))
    for a, b in pairwise(split.offsets):  # a part comes from one cluster
        assert len(set(of_whole[split.members[a:b]].tolist())) == 1
