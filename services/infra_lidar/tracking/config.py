"""Settings of the tracker."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

from msgspec import Meta

from common.config import Section

Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]


class TrackingConfig(Section, frozen=True, kw_only=True):
    """Constant-velocity Kalman filters, Hungarian assignment, lifetimes in seconds."""

    boxes: Literal["visible", "full"] = "visible"  # what is measured: the edges of the visible part, or the centre of
    # whole objects
    position_sigma_m: Positive = 0.15  # error of a box edge ("full": of the centre)
    height_sigma_m: Positive = 0.3
    acceleration_sigma: Positive = 2.0  # spectral density of the process noise, m/s^2 per sqrt(Hz)
    velocity_sigma_mps: Positive = 6.0  # of a new track
    climb_sigma_mps: Positive = 1.0  # of a new track, vertical
    gate: Positive = 7.81  # squared Mahalanobis distance: 95 % of a chi-square with 3 degrees of freedom
    class_weight: NotNegative = 1.0  # of the class term in the cost of a pair: another class costs more
    size_gain: Share = 0.3  # how fast a track's size follows the measured size
    yaw_gain: Share = 0.3
    initiate_confidence: Share = 0.0  # a detection below this updates a track, but initiates none
    confirm_hits: Annotated[int, Meta(ge=1)] = 3
    confirm_s: NotNegative = 0.15
    tentative_gap_s: NotNegative = 0.15  # a tentative track ends after this long without a detection
    coast_s: NotNegative = 0.6  # a confirmed track ends after this long without a detection ...
    coast_as_known: bool = True  # ... and after no longer than it had been observed before
    score_s: Positive = 0.5  # time constant of the score
    vote_s: Positive = 3.0  # time constant of the class votes, which are class probabilities added up
    min_vote: Share = 0.45  # a class needs this share of the votes, or the track is "unknown"
    movement_m: NotNegative = 0.5  # a track stands until it has moved this far within movement_s; 0 = all move
    movement_s: Positive = 1.0
    split_groups: bool = True  # split a cluster of people where the tracks of its members are predicted
    merge_duplicates: bool = True  # remove a second track inside a vehicle's box that moves with it
    first_id: Annotated[int, Meta(ge=0, le=9999)] = 0  # several sensors on one host: give each its own


class TrackingSettings(NamedTuple):
    """What the kernels need of ``TrackingConfig``, as numbers and flags; same names and units."""

    position_sigma_m: float
    height_sigma_m: float
    acceleration_sigma: float
    gate: float
    class_weight: float
    size_gain: float
    yaw_gain: float
    vote_s: float
    movement_m: float
    visible: bool  # boxes = "visible"


def kernel_settings(config: TrackingConfig) -> TrackingSettings:
    """The settings in the form that kernels take."""
    names = [name for name in TrackingSettings._fields if name != "visible"]
    numbers: dict[str, Any] = {name: float(getattr(config, name)) for name in names}
    return TrackingSettings(**numbers, visible=config.boxes == "visible")
