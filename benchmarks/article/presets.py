"""The article's settings of the pipeline, for comparison with our own.

Ground with one height for each cell, a 15 cm grid with two points for each cell, and a tracker of centroids with a
constant process noise, a gate by distance alone and classes that must agree.
"""

from __future__ import annotations

import math

from services.infra_lidar.config import ClusteringConfig, GroundConfig, TrackingConfig

ARTICLE_GROUND = GroundConfig(
    range_max_m=80.0, height_min_m=-1.0, height_max_m=3.0, ring_m=5.0, below_m=0.10, keep_below=True
)  # fmt: skip
ARTICLE_CLUSTERING = ClusteringConfig(
    cell_m=0.15, cell_growth_m=0.0, min_cell_points=2, min_points=20, max_points=15_000,
    min_top_m=-100.0, max_diagonal_m=15.0, body_height_m=0.0, split="off", merge="off",
)  # fmt: skip
ARTICLE_TRACKING = TrackingConfig(
    boxes="centroid", position_sigma_m=math.sqrt(0.3), height_sigma_m=math.sqrt(0.3),
    process="step", step_position_sigma_m=math.sqrt(0.5), step_velocity_sigma_mps=math.sqrt(2.0),
    birth_sigma_m=math.sqrt(0.5), velocity_sigma_mps=math.sqrt(10.0), climb_sigma_mps=math.sqrt(10.0),
    gate=7.81, cost="distance", classes="hard", confirm_hits=2, confirm_s=0.0, tentative_gap_s=0.05, coast_s=0.25,
    coast_as_known=False, votes="mean", vote_s=1e9, vote_margin=0.15, min_vote=0.0, movement_m=0.0,
    merge_duplicates=False,
)  # fmt: skip
"""Lifetimes at 10 frames a second: a tentative track ends at its first miss, a confirmed one at its third."""
