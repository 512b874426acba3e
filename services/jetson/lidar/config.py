"""Configuration of the LD06 lidar service; ``lidar.toml`` beside this file explains every key."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, field

from common.config import Section, ServiceConfig
from common.path import PathConfig

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Confidence = Annotated[int, Meta(ge=0, le=255)]
Scans = Annotated[int, Meta(ge=1, le=1000)]
Offset = Annotated[float, Meta(ge=-10.0, le=10.0)]
Degrees = Annotated[float, Meta(ge=-360.0, le=360.0)]


class SerialSection(Section, frozen=True, kw_only=True):
    """The UART and how patiently it is waited for."""

    baud_rate: Annotated[int, Meta(ge=1200, le=4_000_000)] = 230_400
    silence_s: Annotated[float, Meta(ge=0.1, le=10.0)] = 0.5
    retry_first_s: Annotated[float, Meta(ge=0.01, le=2.0)] = 0.1
    retry_max_s: Annotated[float, Meta(ge=0.05, le=60.0)] = 1.0


class MountingSection(Section, frozen=True, kw_only=True):
    """How the sensor sits on the vehicle."""

    clockwise: bool = True
    upside_down: bool = False
    yaw_deg: Degrees = 0.0
    left_m: Offset = 0.0
    front_m: Offset = 0.0
    vehicle_length_m: Positive = 0.30
    vehicle_width_m: Positive = 0.191


class ScanSection(Section, frozen=True, kw_only=True):
    """How packets become revolutions."""

    sample_rate_hz: Annotated[float, Meta(ge=100.0, le=100_000.0)] = 4500.0
    cut_after_cone_deg: Annotated[float, Meta(ge=0.0, le=180.0)] = 5.0
    longest_s: Annotated[float, Meta(ge=0.05, le=10.0)] = 0.4
    slowest_hz: Annotated[float, Meta(ge=0.1, le=20.0)] = 3.0


class IgnoredSector(Section, frozen=True, kw_only=True):
    """A part of the vehicle that the sensor sees, such as a bracket: what returns from there is not an obstacle."""

    from_deg: Degrees
    to_deg: Degrees
    within_m: Positive

    def __post_init__(self) -> None:
        if not 0.0 < self.to_deg - self.from_deg <= 180.0:
            raise ValueError(
                f"[filter] ignore: expected from_deg < to_deg, 180 degrees apart at the most (counter-clockwise, 0 is "
                f"ahead), got {self.from_deg} and {self.to_deg}"
            )


class FilterSection(Section, frozen=True, kw_only=True):
    """Which returns are believed."""

    min_range_m: NotNegative = 0.20
    max_range_m: Positive = 12.0
    body_clearance_m: NotNegative = 0.03
    min_confidence: Confidence = 15
    lone_confidence: Confidence = 220
    strong_echo: Confidence = 100
    isolated_within_m: NotNegative = 5.0
    neighbour_m: Positive = 0.05
    neighbour_share: Share = 0.05
    ignore: tuple[IgnoredSector, ...] = ()


class ZonesSection(Section, frozen=True, kw_only=True):
    """Field of view, lanes and bands."""

    fov_deg: Annotated[float, Meta(gt=0.0, le=180.0)] = 40.0
    look_ahead_m: Positive = 3.0
    centre_width_m: Positive = 0.251
    side_width_m: Positive = 0.191
    driving_side_m: Positive = 0.10
    imminent_m: Positive = 0.8
    caution_m: Positive = 1.8
    smallest_object_m: Positive = 0.06
    min_points: Annotated[int, Meta(ge=1, le=1000)] = 2
    max_points: Annotated[int, Meta(ge=1, le=1000)] = 6
    near_m: Positive = 0.15
    caution_lead_s: NotNegative = 1.9
    curve_lead_s: NotNegative = 0.3
    lines_wait: bool = True
    cover_far_m: NotNegative = 8.0
    cover_half_deg: Annotated[float, Meta(ge=1.0, le=90.0)] = 90.0
    thin_scans: Annotated[int, Meta(ge=1, le=10)] = 3

    def __post_init__(self) -> None:
        if not self.imminent_m <= self.caution_m <= self.look_ahead_m:
            raise ValueError(
                f"[zones] expected imminent_m <= caution_m <= look_ahead_m, "
                f"got {self.imminent_m}, {self.caution_m}, {self.look_ahead_m}"
            )
        if self.min_points > self.max_points:
            raise ValueError(f"[zones] expected min_points <= max_points, got {self.min_points} > {self.max_points}")


class PersistenceSection(Section, frozen=True, kw_only=True):
    """How long a distance has to be seen before it counts, and to be gone before it no longer does."""

    raise_scans: Scans = 3
    clear_scans: Scans = 4
    raise_s: NotNegative = 0.3
    clear_s: NotNegative = 0.4
    max_gap_s: Positive = 0.5


class MoversSection(Section, frozen=True, kw_only=True):
    """What moves beside the way while the vehicle drives, and whether it will be in it."""

    range_m: Positive = 7.0
    points: Annotated[int, Meta(ge=1, le=1000)] = 2
    join_m: Positive = 0.40
    size_m: Positive = 2.0
    free_m: Positive = 0.30
    same_size_m: Positive = 0.45
    gate_m: Positive = 0.40
    misses: Annotated[int, Meta(ge=0, le=10)] = 2
    place_sigma_m: Positive = 0.08
    speed_sigma_mps: Positive = 1.5
    acceleration_mps2: Positive = 2.0
    scans: Scans = 4
    slowest_mps: Positive = 0.5
    left_m: Positive = 0.25
    sure_sigmas: Annotated[float, Meta(ge=0.0, le=5.0)] = 1.5
    horizon_s: Positive = 4.0
    sigmas: Annotated[float, Meta(ge=0.1, le=5.0)] = 0.5
    imminent_s: Positive = 1.5
    caution_lead_s: NotNegative = 0.8
    hold_s: NotNegative = 0.4


class LeadSection(Section, frozen=True, kw_only=True):
    """What drives ahead of us in the lane."""

    window_s: Annotated[float, Meta(ge=0.2, le=3.0)] = 0.65
    scans: Annotated[int, Meta(ge=4, le=50)] = 5
    sigma_m: Positive = 0.03
    straight_radps: NotNegative = 0.1
    brake_mps2: Positive = 6.0


class HealthSection(Section, frozen=True, kw_only=True):
    """When the sensor no longer sees."""

    scans: Scans = 15
    seconds: Positive = 1.5
    good_scans: Scans = 3
    sectors: Annotated[int, Meta(ge=1, le=36)] = 4
    observed_share: Share = 0.5
    blind_share: Share = 0.2
    dirt_share: Share = 0.25
    scatter_share: Share = 0.3
    weak_share: Share = 0.4
    sector_share: Share = 0.5
    closed_ring_share: Share = 0.8
    flank_m: NotNegative = 4.0


class LidarConfig(ServiceConfig, frozen=True, kw_only=True):
    """The whole configuration."""

    host: Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"
    source: str = ""
    ego_host: Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"  # whose ego/motion is this vehicle's
    serial: SerialSection = field(default_factory=SerialSection)
    mounting: MountingSection = field(default_factory=MountingSection)
    scan: ScanSection = field(default_factory=ScanSection)
    filter: FilterSection = field(default_factory=FilterSection)
    zones: ZonesSection = field(default_factory=ZonesSection)
    path: PathConfig = field(default_factory=PathConfig)
    persistence: PersistenceSection = field(default_factory=PersistenceSection)
    movers: MoversSection = field(default_factory=MoversSection)
    lead: LeadSection = field(default_factory=LeadSection)
    health: HealthSection = field(default_factory=HealthSection)
