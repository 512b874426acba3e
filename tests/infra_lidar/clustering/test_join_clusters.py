"""Joining clusters: what belongs together, without what has no possible size."""

import numpy as np
import pytest

from services.infra_lidar.clustering.boxes import group_by_label, join_clusters, size_rules
from services.infra_lidar.config import ClusteringConfig

VALUES = {"min_points": 4, "max_points": 40, "max_height_m": 5.0, "min_top_m": 0.4, "max_diagonal_m": 6.0}
CONFIG = ClusteringConfig(**VALUES)


def clusters_at(*places):
    """One cluster of four points, 1 m wide and 1 m high, at each place x (m)."""
    corner = np.array([[0, 0, 0, 0.1], [1, 0, 0, 0.1], [0, 0, 1, 1.1], [1, 0, 1, 1.1]], np.float32)
    points = np.concatenate([corner + np.float32([x, 0, 0, 0]) for x in places])
    label = np.repeat(np.arange(len(places), dtype=np.int32), 4)
    return group_by_label(points, np.arange(len(points), dtype=np.int32), label, 1000)


@pytest.mark.parametrize(
    ("places", "group", "kept"),
    [
        ((0, 3, 20), (0, 1, 2), [[0], [1], [2]]),
        ((0, 3, 20), (0, 0, 2), [[0, 1], [2]]),
        ((0, 20, 3), (0, 1, 0), [[0, 2], [1]]),  # a member that does not follow its first
        ((0, 8, 20), (0, 0, 2), [[2]]),  # 9 m long together: none of it is kept, and the next takes its place
        ((0, 8, 20, 22), (0, 0, 2, 2), [[2, 3]]),
        ((), (), []),
    ],
)
def test_members_are_joined_and_what_is_too_large_is_left_out(places, group, kept):
    if places:
        clusters = clusters_at(*places)
    else:
        none = np.zeros((0, 4), np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32)
        clusters = group_by_label(*none, 1000)
    found = join_clusters(clusters, np.array(group, np.int32), size_rules(CONFIG))
    expected = [[4 * k + i for k in members for i in range(4)] for members in kept]
    got = [found.members[a:b].tolist() for a, b in zip(found.offsets[:-1], found.offsets[1:], strict=True)]
    assert got == expected
    for box, members in zip(found.box, kept, strict=True):
        x = [places[k] for k in members]
        assert box[0] == pytest.approx((min(x) + max(x) + 1) / 2, abs=1e-5)
        assert box[3] == pytest.approx(max(x) + 1 - min(x), abs=1e-5)


@pytest.mark.parametrize(
    "change",
    [{"min_points": 5}, {"max_points": 3}, {"max_height_m": 0.9}, {"min_top_m": 1.2}, {"max_diagonal_m": 0.9}],
    ids=lambda change: next(iter(change)),
)
@pytest.mark.parametrize("together", [False, True])
def test_each_rule_counts_for_one_and_for_joined_clusters(change, together):
    places, group = ((0, 0), (0, 0)) if together else ((0,), (0,))
    if together and "min_points" in change:
        change = {"min_points": 9}
    rules = size_rules(ClusteringConfig(**{**VALUES, **change}))
    assert len(join_clusters(clusters_at(*places), np.array(group, np.int32), rules).box) == 0
    assert len(join_clusters(clusters_at(*places), np.array(group, np.int32), size_rules(CONFIG)).box) == 1
