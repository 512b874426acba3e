"""Clusters: connected components of occupied bird's-eye-view cells, sized by range, then split and merged.

Cells grow with range because the spacing of returns does: near the sensor 15 cm keep two pedestrians apart, far away
the same cell would break a car. Cells are filled by points up to the height of a body; what is above joins tall things
(buses) only. So the crown of a tree does not tie the cars below it together, and neither do branches that hang beside
them. Groups of people are split by their heads and fragments of vehicles merged.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.clustering.attach_returns import attach_small_fragments
from services.infra_lidar.clustering.boxes import ClusterPoints, group_by_label, join_clusters, size_rules
from services.infra_lidar.clustering.grid import CellGrid
from services.infra_lidar.clustering.label import label_points, label_rules
from services.infra_lidar.clustering.merge_vehicles import footprints, merge_fragments
from services.infra_lidar.clustering.split_people import split_pedestrian_groups
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.segmentation.ground import Obstacles


class Clustering:
    """Clusters one sensor's frames. Holds the cell grid: one instance per sensor, one thread at a time."""

    def __init__(self, config: ClusteringConfig, range_max_m: float) -> None:
        self._config = config
        self._grid = CellGrid(config, range_max_m)
        self._rules, self._sizes = label_rules(config), size_rules(config)
        self._cell_at = np.full(self._grid.side**2, -1, np.int32)

    def cluster(self, obstacles: Obstacles) -> ClusterPoints:
        """Group the points of a frame that are not ground."""
        config, points = self._config, obstacles.points

        # Connected components of cells; points above body height join tall components or form their own
        label = label_points(points, self._grid.scale, self._rules, self._cell_at)

        # Points sorted by component, each with its box
        found = group_by_label(points, obstacles.index, label, config.max_points)

        # Groups of pedestrians are split by their heads
        is_person = np.zeros(len(found.box), np.bool_)
        if config.split == "heads":
            found, is_person = split_pedestrian_groups(found, self._grid.scale, config.min_points)

        # Fragments of one vehicle are merged, small ones attached
        group = np.arange(len(found.box), dtype=np.int32)
        if config.merge == "fragments":
            foot, counts = footprints(found.box), found.counts
            group = merge_fragments(found.box, foot, counts, is_person)
            attach_small_fragments(foot, counts, config.min_points, group)

        # What has a possible size is kept
        return join_clusters(found, group, self._sizes)
