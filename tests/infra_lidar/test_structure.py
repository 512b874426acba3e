"""Clusters within fixed structure are told from those beside it."""

import numpy as np

from services.infra_lidar.clustering import Clustering
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.ground import Levelled
from services.infra_lidar.structure import StructureMap

CONFIG = ClusteringConfig()


def _frame(*parts):
    xyz = np.vstack(parts).astype(np.float32)
    n = len(xyz)
    x, y, z = (np.ascontiguousarray(xyz[:, k]) for k in range(3))
    return Levelled(
        x, y, z, np.zeros(n, np.int16), np.zeros(n, bool), np.arange(n, dtype=np.int32), np.stack([x, y, z, z])
    )


def _solid(x, y, length, width, low, high, n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform([x - length / 2, y - width / 2, low], [x + length / 2, y + width / 2, high], (n, 3))


def _judge(drawn, part):
    found = Clustering(CONFIG, 100.0).cluster(_frame(part))
    assert len(found) == 1
    return StructureMap(CONFIG, 100.0).inside(drawn, found, np.zeros(len(found), np.float32))[0]


HEDGE = _solid(20, 0, 3, 12, 0.2, 2.0, 6000)
CANOPY = _solid(12, 20, 8, 8, 2.6, 4.5, 6000)
PARKED = _solid(10, -10, 4, 1.8, 0.2, 1.5, 800)


def _drawn():
    frame = _frame(HEDGE, CANOPY, PARKED)
    road_user = np.zeros(len(frame.x), bool)
    road_user[-len(PARKED) :] = True
    return StructureMap(CONFIG, 100.0).draw(frame, road_user)


def test_a_piece_of_the_hedge_is_structure_and_a_person_before_it_is_not():
    assert _judge(_drawn(), _solid(20, 2, 1.0, 1.0, 0.4, 1.8, 80, seed=1))
    assert not _judge(_drawn(), _solid(17.6, 2, 0.5, 0.5, 0.2, 1.7, 80, seed=1))


def test_a_car_under_a_tree_is_no_part_of_the_tree():
    assert not _judge(_drawn(), _solid(12, 20, 4.2, 1.8, 0.2, 1.5, 400, seed=2))
    assert _judge(_drawn(), _solid(12, 20, 3.0, 3.0, 2.7, 4.0, 400, seed=2))


def test_what_was_a_road_user_is_not_drawn():
    assert not _judge(_drawn(), PARKED)


def test_no_clusters():
    found = Clustering(CONFIG, 100.0).cluster(_frame(np.zeros((0, 3))))
    assert StructureMap(CONFIG, 100.0).inside(_drawn(), found, np.zeros(0, np.float32)).shape == (0,)
