"""Clusters within fixed structure are told from those beside it."""

import numpy as np
import pytest

from services.infra_lidar.cells import CellGrid
from services.infra_lidar.clustering import Clustering, ClusterPoints
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.ground import Obstacles
from services.infra_lidar.structure import MIN_SHARE, StructureMap
from services.infra_lidar.vectors import LANES

CONFIG = ClusteringConfig()


def _frame(*parts):
    xyz = np.vstack(parts).astype(np.float32)
    n = len(xyz)
    x, y, z = (np.ascontiguousarray(xyz[:, k]) for k in range(3))
    return Obstacles(np.zeros(n, bool), np.arange(n, dtype=np.int32), np.stack([x, y, z, z]))


def _solid(x, y, length, width, low, high, n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform([x - length / 2, y - width / 2, low], [x + length / 2, y + width / 2, high], (n, 3))


def _inside(config, drawn, found, road_z_m):
    classes = np.arange(10, 10 + len(found))
    StructureMap(config, 100.0).mark(drawn, found, road_z_m, 3, classes)
    marked = classes == 3
    assert np.array_equal(classes[~marked], np.arange(10, 10 + len(found))[~marked])
    return marked


def _judge(drawn, part):
    found = Clustering(CONFIG, 100.0).cluster(_frame(part))
    assert len(found) == 1
    return _inside(CONFIG, drawn, found, np.zeros(len(found), np.float32))[0]


HEDGE = _solid(20, 0, 3, 12, 0.2, 2.0, 6000)
CANOPY = _solid(12, 20, 8, 8, 2.6, 4.5, 6000)
PARKED = _solid(10, -10, 4, 1.8, 0.2, 1.5, 800)


def _drawn():
    frame = _frame(HEDGE, CANOPY, PARKED)
    road_user = np.zeros(len(frame.rest), bool)
    road_user[-len(PARKED) :] = True
    return StructureMap(CONFIG, 100.0).draw(frame, road_user)


def test_a_piece_of_the_hedge_is_structure_and_a_person_before_it_is_not():
    assert _judge(_drawn(), _solid(20, 2, 1.0, 1.0, 0.4, 1.8, 80, seed=1))
    assert not _judge(_drawn(), _solid(17.6, 2, 0.5, 0.5, 0.2, 1.7, 80, seed=1))


def test_a_car_under_a_tree_is_no_part_of_the_tree():
    assert not _judge(_drawn(), _solid(12, 20, 4.2, 1.8, 0.2, 1.5, 400, seed=2))
    assert _judge(_drawn(), _solid(12, 20, 3.0, 3.0, 2.7, 4.0, 400, seed=2))


def test_a_large_cluster_is_judged_by_all_of_its_length():
    assert _judge(_drawn(), _solid(20, 0, 2.5, 11, 0.2, 1.9, 9000, seed=3))
    assert not _judge(_drawn(), _solid(20, 10, 2.5, 13, 0.2, 1.9, 9000, seed=3))  # a fifth of it is hedge


def test_what_was_a_road_user_is_not_drawn():
    assert not _judge(_drawn(), PARKED)


def test_no_clusters():
    found = Clustering(CONFIG, 100.0).cluster(_frame(np.zeros((0, 3))))
    assert _inside(CONFIG, _drawn(), found, np.zeros(0, np.float32)).shape == (0,)


@pytest.mark.parametrize("growth_m", [0.0, 30.0])
def test_a_cluster_is_within_if_enough_of_its_points_are_on_marked_cells(growth_m):
    rng = np.random.default_rng(4)
    config = ClusteringConfig(cell_growth_m=growth_m)
    grid, body_m = CellGrid(config, 100.0), np.float32(config.body_height_m)
    marked = rng.random((2, grid.side, grid.side)) < MIN_SHARE
    words = -(-grid.side // 32)
    drawn = np.zeros((2, grid.side, words), np.int32)
    for layer, row, column in zip(*np.nonzero(marked), strict=True):
        drawn[layer, row, column // 32] |= np.int32(np.uint32(1 << column % 32).view(np.int32))
    counts = rng.integers(1, 80, 300)
    offsets = np.append(0, np.cumsum(counts)).astype(np.int32)
    planar = np.empty(3 * offsets[-1] + LANES, np.float32)[: 3 * offsets[-1]].reshape(3, offsets[-1])
    planar[:] = rng.uniform([[-140], [-140], [0]], [[140], [140], [4]], planar.shape)  # some beyond the grid
    road_z_m = rng.uniform(-1, 1, len(counts)).astype(np.float32)

    x, y, z = planar
    row, column = grid.cells(x, y)
    layer = (z >= np.repeat(road_z_m + body_m, counts)).astype(int)
    hits = np.add.reduceat(marked[layer, row, column], offsets[:-1])
    found = ClusterPoints(
        planar, offsets, np.empty(0, np.int32), offsets, counts, np.empty((len(counts), 8), np.float32)
    )
    within = _inside(config, drawn, found, road_z_m)
    clear = np.abs(hits - MIN_SHARE * counts) > 1.0  # a point on the edge of a cell may go either way
    assert 0.2 < within[clear].mean() < 0.8
    np.testing.assert_array_equal(within[clear], (hits >= MIN_SHARE * counts)[clear])


def test_a_map_of_other_cells_is_not_taken():
    drawn = _drawn()
    assert StructureMap(CONFIG, 100.0).drawn_by_this(drawn)
    assert StructureMap(CONFIG, 100.0).drawn_by_this(drawn[:, :0])
    assert not StructureMap(CONFIG, 60.0).drawn_by_this(drawn)
    assert not StructureMap(CONFIG, 100.0).drawn_by_this(drawn.astype(bool))
