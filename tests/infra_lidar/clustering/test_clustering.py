"""Clusters: what stays apart, what stays whole, and whole streets against their truth."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.infra_lidar.accuracy import article_steps
from services.infra_lidar.clustering.clustering import Clustering
from services.infra_lidar.config import ClusteringConfig, InfraLidarConfig
from services.infra_lidar.segmentation.ground import Obstacles
from services.infra_lidar.training.scenes import Steps
from tests.infra_lidar.made_clusters import clusters_of_parts, solid

LARGE = ("bus", "truck")
DEFAULT = ClusteringConfig()


def _cluster(*parts, config=DEFAULT):
    return clusters_of_parts(*parts, config=config)


def _own(found, owner):
    """Clusters that each part's points went to."""
    return [set(found.cluster_id(len(owner))[owner == k].tolist()) - {-1} for k in range(owner.max(initial=-1) + 1)]


def test_two_people_half_a_metre_apart_near_the_pole():
    found, owner = _cluster(solid((8, 0), (0.4, 0.4), (0.2, 1.7)), solid((8, 0.9), (0.4, 0.4), (0.2, 1.7)))
    assert len(found.box) == 2
    assert all(len(c) == 1 for c in _own(found, owner))


def test_a_sparse_far_car_stays_whole_where_fixed_cells_break_it():
    car = solid((60, 0), (4.2, 1.8), (0.2, 1.5), n=60)
    assert len(_cluster(car)[0].box) == 1
    fixed = ClusteringConfig(cell_m=0.15, cell_growth_m=0.0, merge="off")
    assert len(_cluster(car, config=fixed)[0].box) != 1


def test_a_canopy_does_not_join_the_cars_below():
    cars = solid((10, 0), (4.2, 1.8), (0.2, 1.5)), solid((10, 4), (4.2, 1.8), (0.2, 1.5))
    canopy = solid((10, 2), (7.0, 7.0), (2.6, 4.4), n=3000)
    found, owner = _cluster(*cars, canopy)
    of_car_a, of_car_b, of_canopy = _own(found, owner)
    assert len(of_car_a) == len(of_car_b) == 1
    assert not of_car_a & of_car_b
    assert not (of_car_a | of_car_b) & of_canopy
    all_heights = ClusteringConfig(body_height_m=0.0)
    assert len(_cluster(*cars, canopy, config=all_heights)[0].box) < 3


def test_a_car_at_the_foot_of_what_is_higher_than_any_vehicle_is_not_lost():
    """A trunk that touches it, and its crown up to 7 m: the crown is a thing of its own."""
    car = solid((12, 0), (4.2, 1.8), (0.2, 1.5), n=600)
    trunk, crown = solid((12, 1.05), (0.4, 0.4), (0.2, 6.0), n=600), solid((12, 2.5), (5.0, 5.0), (3.0, 7.0), n=2000)
    found, owner = _cluster(car, trunk, crown)
    cluster = np.bincount(found.cluster_id(len(owner))[owner == 0] + 1)[1:].argmax()
    assert found.box[cluster, 5] < 2.2
    inside = owner[found.cluster_id(len(owner)) == cluster] == 0
    assert inside.mean() > 0.5
    assert inside.sum() > 0.9 * np.sum(owner == 0)
    unbounded = ClusteringConfig(max_height_m=8.0)
    (joined,) = _own(_cluster(car, trunk, crown, config=unbounded)[0], owner)[0]
    assert _cluster(car, trunk, crown, config=unbounded)[0].box[joined, 5] > 5.0


def test_branches_that_hang_beside_a_car_do_not_tie_it_to_the_tree():
    """The trunk is 3 m away; the crown begins at 1.2 m and reaches the car's side."""
    car = solid((12, 0), (4.2, 1.8), (0.2, 1.5), n=600)
    trunk, crown = solid((12, 4.0), (0.4, 0.4), (0.2, 6.0), n=600), solid((12, 3.5), (5.0, 5.2), (1.2, 7.0), n=4000)
    found, owner = _cluster(car, trunk, crown)
    of_car = found.cluster_id(len(owner))[owner == 0]
    (cluster,) = _own(found, owner)[0]
    assert np.mean(of_car == cluster) > 0.9
    assert np.mean(owner[found.cluster_id(len(owner)) == cluster] == 0) > 0.95


def test_a_roof_below_a_crown_stays_with_its_car():
    """Of the car the near side and the roof are seen, and the crown above it."""
    side, roof = solid((12, -0.8), (4.2, 0.2), (0.2, 1.0), n=300), solid((12, 0.2), (4.0, 1.6), (1.35, 1.5), n=300)
    found, owner = _cluster(side, roof, solid((12, 0), (6.0, 5.0), (2.0, 7.0), n=3000))
    cluster = found.cluster_id(len(owner))
    (of_side,) = set(cluster[owner == 0])
    assert np.mean(cluster[owner == 1] == of_side) > 0.9
    assert np.mean(owner[cluster == of_side] < 2) > 0.9


def test_a_bus_keeps_its_roof():
    found, _ = _cluster(solid((15, 0), (12, 2.5), (0.3, 3.2), n=6000))
    assert len(found.box) == 1
    assert found.box[0, 5] == pytest.approx(2.9, abs=0.1)
    assert found.box[0, 3] == pytest.approx(12, abs=0.4)


def test_the_two_ends_of_a_hidden_bus_are_joined_and_a_cyclist_before_it_is_not():
    ends = solid((28, -4.5), (2.4, 2.0), (0.4, 3.0), n=200), solid((28, 0.2), (2.4, 3.0), (0.4, 3.0), n=200)
    cyclist = solid((25.6, -2.4), (0.6, 1.7), (0.2, 1.75), n=120)
    found, owner = _cluster(*ends, cyclist)
    one, other, rider = _own(found, owner)
    assert one == other
    assert len(one) == 1
    assert rider
    assert not rider & one


def test_a_sign_that_hangs_beside_the_end_of_a_car_is_not_its_own():
    """Half a metre beside it and more than that above it; as seen on a labelled street."""
    end, sign = solid((20, -4.0), (1.5, 0.7), (0.3, 1.1), n=60), solid((18.5, -4.0), (0.6, 0.4), (2.3, 2.9), n=30)
    found, owner = _cluster(end, sign)
    cluster = found.cluster_id(len(owner))
    of_end, of_sign = (np.bincount(cluster[owner == k] + 1).argmax() - 1 for k in (0, 1))
    assert of_end != of_sign
    assert np.mean(cluster[owner == 0] == of_end) > 0.9
    assert np.mean(owner[cluster == of_end] == 0) > 0.9


@pytest.mark.parametrize("width_m", [1.8, 2.35])  # noise makes boxes of moving cars up to 0.4 m wider
def test_a_lorry_close_behind_a_car_is_not_joined_with_it(width_m):
    car = solid((12, 0), (4.8, width_m), (0.2, 1.45), n=1200)
    lorry = solid((16.8, 0), (3.2, 2.4), (0.3, 3.5), n=1500)
    of_car, of_lorry = _own(*_cluster(car, lorry))
    assert len(of_car) == len(of_lorry) == 1
    assert of_car != of_lorry


def test_people_beside_a_parked_car_are_not_joined_to_it():
    found, owner = _cluster(solid((12, 0), (4.3, 1.8), (0.2, 1.5)), solid((12, 1.6), (0.5, 0.5), (0.2, 1.7)))
    car, person = _own(found, owner)
    assert not car & person


@pytest.mark.parametrize(
    ("part", "why"),
    [
        (solid((10, 0), (0.5, 0.5), (0.2, 1.7), n=6), "too few points"),
        (solid((10, 0), (30, 0.3), (0.2, 1.7), n=4000), "too long"),
        (solid((10, 0), (1.0, 1.0), (0.16, 0.3)), "too low"),
    ],
)
def test_impossible_sizes_are_dropped(part, why):
    found, owner = _cluster(part)
    assert len(found.box) == 0, why
    assert (found.cluster_id(len(owner)) == -1).all()


def test_grouped_points_and_ids_agree():
    parts = solid((8, 0), (0.5, 0.5), (0.2, 1.7)), solid((20, 9), (4, 1.8), (0.2, 1.5))
    found, owner = _cluster(*parts)
    cluster_id = found.cluster_id(len(owner))
    assert np.array_equal(found.cluster_id(len(owner))[found.members], np.repeat([0, 1], found.counts))
    for k in range(len(found.box)):
        points = found.points[found.offsets[k] : found.offsets[k + 1], :3]
        assert len(points) == (cluster_id == k).sum() == found.counts[k]
        mine = found.members[found.offsets[k] : found.offsets[k + 1]]
        assert np.array_equal(points, np.vstack(parts).astype(np.float32)[mine])
        assert np.allclose(points.mean(axis=0)[:2], found.box[k, :2], atol=0.5)


def _own_cluster_shares(frames, steps):
    """Share of objects with 20 points or more that have a cluster mostly theirs with at least half of those points."""
    good, total = Counter(), Counter()
    for frame in frames:
        found = steps.clusters(frame.points, frame.T_level_sensor)
        inside = steps.ground.level_only(frame.points, frame.T_level_sensor).cell >= 0
        for actor in np.unique(frame.actor[(frame.actor > 0) & inside]):
            mine = (frame.actor == actor) & inside
            if mine.sum() < 20:
                continue
            kind = frame.kind[mine][0]
            kind = "large_vehicle" if kind in LARGE else kind
            ids = found.cluster_id(len(mine))[mine]
            count = np.bincount(ids[ids >= 0], minlength=1)
            best = int(count.argmax())
            total[kind] += 1
            good[kind] += (
                bool(len(found.box)) and count[best] >= 0.5 * mine.sum() and count[best] > 0.5 * found.counts[best]
            )
    return {kind: good[kind] / total[kind] for kind in total}


def test_objects_of_streets_have_clusters_of_their_own(scene_frame):
    frames = [scene_frame(kind, seed) for kind in ("open", "level", "facade", "trees") for seed in (4, 5, 0)]
    ours = _own_cluster_shares(frames, Steps.of(InfraLidarConfig()))
    assert ours["car"] >= 0.90
    assert ours["pedestrian"] >= 0.85
    assert ours["cyclist"] >= 0.93
    assert ours["large_vehicle"] >= 0.90
    article = _own_cluster_shares(frames[:6], article_steps())
    assert article["car"] < 0.6  # the limit the article's author found


@pytest.mark.parametrize(("min_cell_points", "connectivity", "clusters"), [(1, 4, 2), (1, 8, 1), (2, 4, 0), (2, 8, 0)])
def test_cells_that_touch_at_a_corner_and_cells_of_one_point(min_cell_points, connectivity, clusters):
    """Two staircases of cells with a point each, which touch at a corner."""
    steps = np.array([(0, 0), (0, 1), (1, 1), (1, 2), (2, 3), (2, 4), (3, 4), (3, 5)]) + 0.5
    stairs = np.column_stack((8 + steps, np.linspace(0.5, 1.5, len(steps))))
    config = ClusteringConfig(
        cell_m=1.0, cell_growth_m=0.0, min_points=4, merge="off", split="off",
        min_cell_points=min_cell_points, connectivity=connectivity,
    )  # fmt: skip
    assert len(_cluster(stairs, config=config)[0].box) == clusters


def test_an_empty_frame():
    found, _ = _cluster(np.zeros((0, 3)), np.zeros((0, 3)))
    assert len(found.box) == 0
    assert found.points.shape == (0, 4)


def test_clusters_outlive_the_next_frame():
    """Whoever trains keeps those of many frames."""
    clustering, frames = Clustering(ClusteringConfig(), 100.0), []
    for x in (8, 20):
        xyz = solid((x, 0), (0.5, 0.5), (0.2, 1.7)).astype(np.float32)
        n = len(xyz)
        frame = Obstacles(np.column_stack((xyz, xyz[:, 2])), np.arange(n, dtype=np.int32), np.zeros(n, bool))
        found = clustering.cluster(frame)
        frames.append((found, found.points.copy(), found.offsets.copy(), found.box.copy()))
    for found, points, offsets, box in frames:
        assert np.array_equal(found.points, points)
        assert np.array_equal(found.offsets, offsets)
        assert np.array_equal(found.box, box)


@given(st.integers(0, 10_000))
@settings(max_examples=60)
def test_every_point_is_in_one_cluster_at_most_whatever_is_attached(seed):
    """Loose pieces of several points beside tall ends: taking the first of a group of them must not lose the others."""
    rng = np.random.default_rng(seed)
    ends = [solid(rng.uniform([10, -8], [30, 8]), (0.4, 2.5), (0.3, 3.0), n=60, seed=seed + k) for k in range(3)]
    loose = rng.uniform([8, -10, 0.3], [34, 10, 3.0], (60, 3))
    pieces = np.repeat(loose, 4, axis=0) + rng.uniform(-0.05, 0.05, (240, 3))
    found, owner = _cluster(*ends, pieces)
    assert len(np.unique(found.members)) == len(found.members) == found.offsets[-1] == found.counts.sum()
    assert (found.counts >= ClusteringConfig().min_points).all()
    assert np.array_equal(
        found.cluster_id(len(owner))[found.members], np.repeat(np.arange(len(found.box)), found.counts)
    )


@pytest.mark.parametrize(
    ("above_roof_m", "number", "stray"),
    [(0.6, 3, True), (0.6, 30, False), (0.2, 3, False), (0.6, 0, False)],
    ids=["three returns over the roof", "a box on the roof", "an aerial", "nothing"],
)
def test_few_returns_far_above_a_car_are_not_its_own(above_roof_m, number, stray):
    car = solid((12, 0), (4.2, 1.8), (0.2, 1.5), n=600)
    above = np.tile(np.array([12.0, 0.0, 1.5 + above_roof_m], np.float32), (number, 1))
    found, owner = _cluster(car, above)
    (k,) = _own(found, owner)[0]
    assert (np.unique(owner[found.members]).tolist() == [0]) == (stray or not number)
    assert found.box[k, 5] == pytest.approx(1.3 if stray or not number else 1.3 + above_roof_m, abs=0.05)
