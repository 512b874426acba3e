"""Every setting of the infrastructure lidar service; ``infra_lidar.toml`` lists them with units and reasons.

The defaults are our own design; ``benchmarks/article/presets.py`` has the settings of the article it started from.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from common.config import Section, ServiceConfig
from common.geometry import is_rigid
from services.infra_lidar.tracking.config import NotNegative, Positive, Share, TrackingConfig

__all__ = ["InfraLidarConfig", "TrackingConfig"]

Degrees = Annotated[float, Meta(ge=0.0, le=90.0)]
THREE_DECIMALS = 0.002  # what the products of a rotation's rows are off at the most when it is written with three


class CalibrationConfig(Section, frozen=True, kw_only=True):
    """Where the road is, as seen from the sensor: estimated from the first frames, then kept."""

    radius_m: Positive = 20.0  # points farther away (3-D) do not count, unless there is too little road within
    inlier_m: Positive = 0.10
    max_tilt_deg: Degrees = 35.0  # the mounting prior: the road's normal lies within this cone about the prior's
    prior_roll_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 0.0  # 180 = upside down
    prior_pitch_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] = 0.0  # positive = looks down
    height_min_m: float = -0.5
    height_max_m: float = 25.0
    hypotheses: Annotated[int, Meta(ge=16, le=20_000)] = 1000
    seed: int = 1
    frames: Annotated[int, Meta(ge=1, le=100)] = 5  # frames that are pooled; the first one already gives an answer
    max_error_deg: Positive = 0.5  # stated error above which the calibration is refused
    store: str = ""  # folder where calibration and background are kept; empty = nowhere
    check_period_s: Positive = 2.0  # nudge watch: how often the road is looked at again
    nudge_tilt_deg: Positive = 0.5
    nudge_height_m: Positive = 0.10


class GroundConfig(Section, frozen=True, kw_only=True):
    """Polar grid of low-percentile heights in the levelled frame."""

    range_max_m: Annotated[float, Meta(gt=0.0, le=250.0)] = 100.0
    height_min_m: Annotated[float, Meta(ge=-10.0, lt=0.0)] = -3.0  # clip, relative to the road at the pole's foot
    height_max_m: Annotated[float, Meta(gt=0.0, le=20.0)] = 6.0
    ring_m: Annotated[float, Meta(ge=0.5, le=50.0)] = 2.5  # radial size of a cell
    sector_deg: Annotated[float, Meta(ge=1.0, le=90.0)] = 5.0
    percentile: Share = 0.05
    min_points: Annotated[int, Meta(ge=1)] = 5
    limit_base_m: NotNegative = 0.5  # a cell height is believed within min(base + slope * range, max) of the plane
    limit_slope: NotNegative = 0.08
    limit_max_m: NotNegative = 2.0
    below_m: NotNegative = 0.30  # a point is ground from this far below the surface ...
    above_m: NotNegative = 0.15  # ... to this far above it
    keep_below: bool = False  # points lower than that are obstacles or nothing
    max_step: Share = 0.12  # slope that may be overlooked while the road is hidden
    step_up_m: NotNegative = 0.20  # a cell farther above its inner neighbours is a thing on the road ...
    step_down_m: NotNegative = 0.40  # ... and farther below them a hole

    def __post_init__(self) -> None:
        if (self.range_max_m / self.ring_m + 2.0) * (360.0 / self.sector_deg) > 32_000:
            raise ValueError("ground: more than 32000 cells; make ring_m or sector_deg larger")


class ClusteringConfig(Section, frozen=True, kw_only=True):
    """Connected components of occupied bird's-eye-view cells."""

    cell_m: Annotated[float, Meta(ge=0.02, le=2.0)] = 0.15  # near the sensor
    cell_growth_m: Annotated[float, Meta(ge=0.0, le=1000.0)] = 25.0  # range at which a cell is twice that; 0 = constant
    min_cell_points: Annotated[int, Meta(ge=1, le=100)] = 1
    connectivity: Literal[4, 8] = 4
    min_points: Annotated[int, Meta(ge=1)] = 10
    max_points: Annotated[int, Meta(ge=1)] = 30_000
    max_height_m: Positive = 5.0
    min_top_m: float = 0.4  # a cluster that does not reach this far above the road is no road user
    max_diagonal_m: Positive = 20.0
    body_height_m: NotNegative = 2.2  # cells are filled by points below this; higher ones join tall things. 0 = off
    split: Literal["heads", "off"] = "heads"  # groups of pedestrians are split at their heads
    merge: Literal["fragments", "off"] = "fragments"  # pieces of one vehicle are merged


class BackgroundConfig(Section, frozen=True, kw_only=True):
    """The fixed scene, learned in (ring, azimuth): returns that were always there need no further thought."""

    enabled: bool = True
    learn_s: Positive = 20.0
    min_frames: Annotated[int, Meta(ge=5)] = 100
    azimuth_cells: Annotated[int, Meta(ge=90, le=7200)] = 1800
    min_share: Share = 0.8  # of the frames with a return in a cell, in which it was of the same range
    tolerance_m: Positive = 0.15
    tolerance_slope: NotNegative = 0.004  # metres per metre of range


class VisibilityConfig(Section, frozen=True, kw_only=True):
    """Limits of what a sensor that sees well returns; outside of them the service reports it as degraded."""

    min_points: Annotated[int, Meta(ge=0)] = 1000
    min_points_share: Share = 0.5  # of what this sensor usually returns
    max_lost_beams_share: Share = 0.2
    min_sectors_share: Share = 0.7  # of the sectors of ground.sector_deg that usually have returns
    max_near_share: Share = 0.25  # returns closer than near_m: rain, fog, dirt on the window
    near_m: Positive = 2.5
    max_packet_loss_share: Share = 0.02
    budget_ms: Positive = 100.0
    window_frames: Annotated[int, Meta(ge=1)] = 10


class ClassifierConfig(Section, frozen=True, kw_only=True):
    """The forest."""

    model: str = ""  # an .npz made by `spotter-infra-lidar train`; empty = the one that is shipped
    site_model: str = ""  # what `spotter-infra-lidar adapt` writes; used instead of `model` as long as it is there
    min_confidence: Share = 0.45  # below this an object is "unknown": an obstacle of no known class

    def __post_init__(self) -> None:
        if self.site_model and not self.site_model.endswith(".npz"):
            raise ValueError(f'site_model = "{self.site_model}": the name has to end in .npz')


class InfraLidarConfig(ServiceConfig, frozen=True, kw_only=True):
    """The whole service."""

    host: Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")] = "infra0"
    source: str = ""
    frame_id: str = "map"
    T_map_sensor: tuple[float, ...] = ()  # 16 numbers, row by row; empty: map = road plane at the pole's foot
    points_limit: Annotated[int, Meta(ge=100, le=1_000_000)] = 20_000  # published cloud, after thinning
    calibration: CalibrationConfig = msgspec.field(default_factory=CalibrationConfig)
    ground: GroundConfig = msgspec.field(default_factory=GroundConfig)
    clustering: ClusteringConfig = msgspec.field(default_factory=ClusteringConfig)
    background: BackgroundConfig = msgspec.field(default_factory=BackgroundConfig)
    visibility: VisibilityConfig = msgspec.field(default_factory=VisibilityConfig)
    classifier: ClassifierConfig = msgspec.field(default_factory=ClassifierConfig)
    tracking: TrackingConfig = msgspec.field(default_factory=TrackingConfig)

    def __post_init__(self) -> None:
        if self.T_map_sensor and len(self.T_map_sensor) != 16:
            raise ValueError(f"T_map_sensor: expected 16 numbers, got {len(self.T_map_sensor)}")
        if self.T_map_sensor and not is_rigid(np.reshape(self.T_map_sensor, (4, 4)), THREE_DECIMALS):
            allowed = "a rotation and a translation: 3 columns at right angles and of length 1, last row 0, 0, 0, 1"
            raise ValueError(f"T_map_sensor = {list(self.T_map_sensor)}: expected {allowed}")
