"""What a detection means: is it ahead, and in which band. While the vehicle drives a curve, ahead follows its arc."""

from __future__ import annotations

import math

import numpy as np

from common.messages import Cover, Level, worst
from common.path import Path
from services.jetson.camera.config import CameraConfig, LensConfig, ZoneConfig


def in_forward_zone(box: np.ndarray, width_px: int, config: ZoneConfig) -> bool:
    """Does the box (x1, y1, x2, y2) reach into the centre of the picture? By overlap: a wide near object counts."""
    left_px, right_px = forward_zone(width_px, config)
    overlap_px = min(float(box[2]), right_px) - max(float(box[0]), left_px)
    return overlap_px >= config.min_overlap_px


def shifted(box: np.ndarray, shift_px: float) -> np.ndarray:
    """The box (x1, y1, x2, y2) as it would be in the picture if the way were straight."""
    return np.asarray(box, float) - np.array([shift_px, 0.0, shift_px, 0.0])


def way_column_px(distance_m: float, path: Path, zone: ZoneConfig, lens: LensConfig) -> float:
    """How far right of where a straight way lies the middle of this way lies in the picture, at this distance."""
    if path.curvature_per_m == 0.0:
        return 0.0
    ahead_m = max(0.0, zone.camera_x_m + distance_m - path.config.front_m)
    ((x_m, y_m),) = path.place(np.array([ahead_m]), np.zeros(1))
    return -lens.f_x_px * float(y_m) / max(float(x_m) - zone.camera_x_m, 0.1)


def cover_of(config: CameraConfig, lens: LensConfig, why: str) -> Cover:
    """Where something would be recognised and count: the forward zone; nowhere while the picture is no view.

    ``lens``: of pictures of this size.
    """
    half_rad = math.atan(lens.width_px * config.zone.width / 2 / lens.f_x_px)
    return Cover(
        x_m=config.zone.camera_x_m,
        y_m=config.zone.camera_y_m,
        first_rad=-half_rad,
        step_rad=2 * half_rad,
        far_m=[0.0 if why else config.zone.cover_far_m],
        near_m=0.3,
        only="what its network knows",
        why=why,
    )


def forward_zone(width_px: int, config: ZoneConfig) -> tuple[float, float]:
    """Left and right end of the zone in columns."""
    half_px = width_px * config.width / 2
    return width_px / 2 - half_px, width_px / 2 + half_px


def band(near_m: float, height_share: float, config: ZoneConfig) -> Level:
    """The worse of two triggers: how near, and which share of the picture's height. Limits are inclusive."""
    by_distance = _level(near_m <= config.imminent_m, near_m <= config.caution_m)
    by_share = _level(height_share >= config.imminent_height, height_share >= config.caution_height)
    return worst(by_distance, by_share)


def _level(imminent: bool, caution: bool) -> Level:
    return "IMMINENT" if imminent else "CAUTION" if caution else "SAFE"
