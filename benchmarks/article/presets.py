"""The article's settings of the pipeline, for comparison with our own.

Ground with one height for each cell, and a 15 cm grid with two points for each cell. Its tracker is
``article_tracker.py``.
"""

from __future__ import annotations

from services.infra_lidar.config import ClusteringConfig, GroundConfig

ARTICLE_GROUND = GroundConfig(
    range_max_m=80.0, height_min_m=-1.0, height_max_m=3.0, ring_m=5.0, below_m=0.10, keep_below=True
)  # fmt: skip
ARTICLE_CLUSTERING = ClusteringConfig(
    cell_m=0.15, cell_growth_m=0.0, min_cell_points=2, min_points=20, max_points=15_000,
    min_top_m=-100.0, max_diagonal_m=15.0, body_height_m=0.0, split="off", merge="off",
)  # fmt: skip
