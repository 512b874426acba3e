"""Clusters within fixed things are told from those beside them."""

import numpy as np
import pytest

from services.infra_lidar.clustering.boxes import ClusterPoints
from services.infra_lidar.clustering.grid import CellGrid
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.segmentation.ground import Obstacles
from services.infra_lidar.segmentation.scene import MIN_SHARE
from services.infra_lidar.segmentation.static_map import MapCells, Occupancy
from tests.infra_lidar.made_clusters import solid

CONFIG = ClusteringConfig()


def _obstacles(*parts):
    xyz = np.vstack(parts).astype(np.float32)
    n = len(xyz)
    return Obstacles(np.column_stack((xyz, xyz[:, 2])), np.arange(n, dtype=np.int32), np.zeros(n, bool))


def _clusters(points, counts, road_z_m=0.0):
    offsets = np.append(0, np.cumsum(counts)).astype(np.int32)
    members = np.arange(len(points), dtype=np.int32)
    box = np.zeros((len(counts), 8), np.float32)
    points = np.column_stack((points, points[:, 2] - road_z_m)).astype(np.float32)
    return ClusterPoints(points=points, members=members, offsets=offsets, box=box)


def _is_within(drawn, part):
    share = MapCells(CONFIG, 100.0).share_within(drawn, _clusters(part, [len(part)]))
    return bool(share[0] >= MIN_SHARE)


HEDGE = solid((20, 0), (3, 12), (0.2, 2.0), n=6000)
CANOPY = solid((12, 20), (8, 8), (2.6, 4.5), n=6000)
PARKED = solid((10, -10), (4, 1.8), (0.2, 1.5), n=800)


def _drawn():
    obstacles = _obstacles(HEDGE, CANOPY, PARKED)
    road_user = np.zeros(len(obstacles), np.float32)
    road_user[-len(PARKED) :] = 0.9
    return _map_of([obstacles], [road_user])


def _map_of(frames, road_users):
    occupancy = Occupancy(MapCells(CONFIG, 100.0))
    for obstacles, road_user in zip(frames, road_users, strict=True):
        occupancy.add(obstacles, road_user)
    return occupancy.static_map()


def test_a_piece_of_the_hedge_is_structure_and_a_person_before_it_is_not():
    assert _is_within(_drawn(), solid((20, 2), (1.0, 1.0), (0.4, 1.8), n=80, seed=1))
    assert not _is_within(_drawn(), solid((17.6, 2), (0.5, 0.5), (0.2, 1.7), n=80, seed=1))


def test_a_car_under_a_tree_is_no_part_of_the_tree():
    assert not _is_within(_drawn(), solid((12, 20), (4.2, 1.8), (0.2, 1.5), n=400, seed=2))
    assert _is_within(_drawn(), solid((12, 20), (3.0, 3.0), (2.7, 4.0), n=400, seed=2))


def test_a_large_cluster_is_judged_by_all_of_its_length():
    assert _is_within(_drawn(), solid((20, 0), (2.5, 11), (0.2, 1.9), n=9000, seed=3))
    assert not _is_within(_drawn(), solid((20, 10), (2.5, 13), (0.2, 1.9), n=9000, seed=3))  # a fifth of it is hedge


def test_what_was_a_road_user_is_not_drawn():
    assert not _is_within(_drawn(), PARKED)


@pytest.mark.parametrize(
    ("frames", "called_road_user", "fixed"),
    [(10, 0, True), (10, 4, True), (10, 6, False), (10, 10, False), (4, 0, False), (6, 0, True), (6, 4, False)],
)
def test_fixed_is_what_stood_in_most_frames_and_was_mostly_called_background(frames, called_road_user, fixed):
    bare, with_hedge = _obstacles(CANOPY), _obstacles(CANOPY, HEDGE)
    calls = [(bare, 0.0)] * (10 - frames) + [(with_hedge, 1.0)] * called_road_user
    calls += [(with_hedge, 0.0)] * (frames - called_road_user)
    drawn = _map_of([o for o, _ in calls], [np.full(len(o.points), sure, np.float32) for o, sure in calls])
    assert _is_within(drawn, solid((20, 2), (1.0, 1.0), (0.4, 1.8), n=80, seed=1)) is fixed


def test_leaves_that_return_from_other_places_in_every_frame_are_fixed():
    frames = [_obstacles(solid((20, 0), (3, 12), (0.2, 2.0), n=1500, seed=seed)) for seed in range(20)]
    drawn = _map_of(frames, [np.zeros(len(frame.points), np.float32) for frame in frames])
    assert _is_within(drawn, solid((20, 0), (2.8, 11), (0.3, 1.9), n=200, seed=99))


def test_before_the_first_frame_nothing_is_fixed():
    assert not Occupancy(MapCells(CONFIG, 100.0)).static_map().any()


def test_no_clusters():
    share = MapCells(CONFIG, 100.0).share_within(_drawn(), _clusters(np.zeros((0, 3)), []))
    assert share.shape == (0,)


@pytest.mark.parametrize("growth_m", [0.0, 30.0])
def test_the_share_counts_the_points_on_marked_cells_of_their_layer(growth_m):
    rng = np.random.default_rng(4)
    config = ClusteringConfig(cell_growth_m=growth_m)
    side, body_m = CellGrid(config, 100.0).side, config.body_height_m
    static_map = rng.random((2, side, side)) < MIN_SHARE
    counts = rng.integers(1, 80, 300)
    points = rng.uniform([-140, -140, 0], [140, 140, 4], (counts.sum(), 3)).astype(np.float32)  # some beyond the grid
    road_z_m = rng.uniform(-1, 1, len(points)).astype(np.float32)

    radius, c = np.hypot(points[:, 0], points[:, 1]), config.cell_m
    stretch = growth_m * np.log1p(radius / growth_m) / radius if growth_m else np.ones(len(points))
    column, row = (np.floor(points[:, k] * stretch / c).astype(int) + side // 2 for k in (0, 1))
    layer = (points[:, 2] - road_z_m >= body_m).astype(int)
    hit = static_map[layer, np.clip(row, 0, side - 1), np.clip(column, 0, side - 1)]
    expected = [part.mean() for part in np.split(hit, np.cumsum(counts)[:-1])]
    share = MapCells(config, 100.0).share_within(static_map, _clusters(points, counts, road_z_m))
    apart = np.abs(share - expected) * counts  # a point on the edge of a cell may go either way
    assert apart.max() < 1.5
    assert apart.mean() < 0.02


def test_a_map_of_other_cells_is_not_taken():
    drawn = _drawn()
    assert MapCells(CONFIG, 100.0).fits(drawn)
    assert MapCells(CONFIG, 100.0).fits(drawn[:, :0])
    assert not MapCells(CONFIG, 60.0).fits(drawn)
    assert not MapCells(CONFIG, 100.0).fits(drawn.astype(np.int32))
