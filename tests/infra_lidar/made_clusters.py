"""Blocks of points on a road at z = 0, and what the clustering makes of them."""

import numpy as np

from services.infra_lidar.clustering.clustering import Clustering
from services.infra_lidar.segmentation.ground import Obstacles


def solid(middle, size, heights, n=400, seed=0):
    """(n, 3) points inside an upright block: its middle x, y, its size along x and y, its lowest and highest z (m)."""
    (x, y), (length, width), (low, high) = middle, size, heights
    rng = np.random.default_rng(seed)
    return rng.uniform([x - length / 2, y - width / 2, low], [x + length / 2, y + width / 2, high], (n, 3))


def clusters_of(xyz, config):
    """Clusters of level-frame points (N, 3) whose road is z = 0."""
    xyz = np.asarray(xyz, np.float32)
    index, is_ground = np.arange(len(xyz), dtype=np.int32), np.zeros(len(xyz), bool)
    frame = Obstacles(np.column_stack((xyz, xyz[:, 2])), index, is_ground)
    return Clustering(config, 100.0).cluster(frame)


def clusters_of_parts(*parts, config):
    """The same of several bodies; and which one each point came from."""
    owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return clusters_of(np.vstack(parts), config), owner
