"""What a detection means: is it ahead, and in which band."""

from __future__ import annotations

import numpy as np

from common.messages import Level, worst
from services.jetson.camera.config import ZoneConfig


def in_forward_zone(box: np.ndarray, width_px: int, config: ZoneConfig) -> bool:
    """Does the box (x1, y1, x2, y2) reach into the centre of the picture? By overlap: a wide near object counts."""
    left_px, right_px = forward_zone(width_px, config)
    overlap_px = min(float(box[2]), right_px) - max(float(box[0]), left_px)
    return overlap_px >= config.min_overlap_px


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
