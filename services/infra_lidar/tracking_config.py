"""Settings of the tracker, and the presets: the article's tracker, and one for boxes of a 3-D detector with scores."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta

from common.config import Section

Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]


class TrackingConfig(Section, frozen=True, kw_only=True):
    """Constant-velocity Kalman filters, Hungarian assignment, lifetimes in seconds."""

    boxes: Literal["visible", "full", "centroid"] = "visible"  # what is measured: the edges of the visible part, the
    # centre of whole objects, or the mean of the points (article)
    position_sigma_m: Positive = 0.15  # error of a box edge ("full": of the centre)
    height_sigma_m: Positive = 0.3
    process: Literal["acceleration", "step"] = "acceleration"  # noise by the real time, or so much a frame (article)
    acceleration_sigma: Positive = 2.0  # spectral density of the process noise, m/s^2 per sqrt(Hz)
    step_position_sigma_m: NotNegative = 0.7  # "step": grows by this in every frame ...
    step_velocity_sigma_mps: NotNegative = 1.4  # ... and by this
    birth_sigma_m: NotNegative = 0.0  # of a new track's position; 0 = that of a measurement
    velocity_sigma_mps: Positive = 6.0  # of a new track
    climb_sigma_mps: Positive = 1.0  # the same upwards
    gate: Positive = 7.81  # squared Mahalanobis distance: 95 % of a chi-square with 3 degrees of freedom
    cost: Literal["likelihood", "distance"] = "likelihood"  # of a pair; "distance": the article's, blind to how sure
    classes: Literal["soft", "hard"] = "soft"  # another class costs something, or is forbidden (article)
    class_weight: NotNegative = 1.0  # of the class term in the cost of a pair
    size_gain: Share = 0.3  # how fast a track's size follows what is seen
    yaw_gain: Share = 0.3
    found_confidence: Share = 0.0  # a detection below this keeps a track alive, but founds none
    confirm_hits: Annotated[int, Meta(ge=1)] = 3
    confirm_s: NotNegative = 0.15
    tentative_gap_s: NotNegative = 0.15  # a new track dies after this long without a detection
    coast_s: NotNegative = 0.6  # a confirmed one after this long ...
    coast_as_known: bool = True  # ... and after no longer than it had been seen
    score_s: Positive = 0.5  # time constant of the score
    votes: Literal["chances", "mean"] = "chances"  # sum of probabilities, or (article) mean confidence per class
    vote_s: Positive = 3.0  # how long a class vote counts
    vote_margin: Share = 0.0  # by how much another class must lead before the label changes
    min_vote: Share = 0.4  # a class needs this share of the votes, or the track is "unknown"
    movement_m: NotNegative = 0.5  # a track stands until it has come this far within movement_s; 0 = all move
    movement_s: Positive = 1.0
    split_groups: bool = True  # cut a cluster of people where the tracks of its members are (article)
    absorb: bool = True  # a second track inside a vehicle's box that goes with it is given up
    first_id: Annotated[int, Meta(ge=0, le=9999)] = 0  # several sensors on one host: give each its own


ARTICLE_TRACKING = TrackingConfig(
    boxes="centroid", position_sigma_m=math.sqrt(0.3), height_sigma_m=math.sqrt(0.3),
    process="step", step_position_sigma_m=math.sqrt(0.5), step_velocity_sigma_mps=math.sqrt(2.0),
    birth_sigma_m=math.sqrt(0.5), velocity_sigma_mps=math.sqrt(10.0), climb_sigma_mps=math.sqrt(10.0),
    gate=7.81, cost="distance", classes="hard", confirm_hits=2, confirm_s=0.0, tentative_gap_s=0.05, coast_s=0.25,
    coast_as_known=False, votes="mean", vote_s=1e9, vote_margin=0.15, min_vote=0.0, movement_m=0.0, absorb=False,
)  # fmt: skip
"""Lifetimes are those of 10 frames a second: a new track dies at its first miss, a confirmed one at its third."""


DETECTOR_TRACKING = TrackingConfig(
    boxes="full", gate=16.27, velocity_sigma_mps=10.0, acceleration_sigma=3.0, found_confidence=0.7, confirm_hits=2,
    confirm_s=0.05,
)  # fmt: skip
"""Scored whole boxes of a 3-D detector on a moving vehicle whose own motion is not taken out, every class alike.

The gate lets 99.9 % of a chi-square with 3 degrees of freedom pass: there is no clutter of pieces to keep out. What
stands goes backwards at the vehicle's speed and what comes towards it at twice that, and when the vehicle brakes all
brake: hence a wider prior of the velocity and more acceleration. Unsure detections keep tracks alive, but only sure
ones found them (Zhang et al., ByteTrack, 2022); therefore two hits confirm."""
