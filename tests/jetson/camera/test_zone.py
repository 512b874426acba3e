"""The forward zone goes by overlap, the bands by the worse of two triggers, limits inclusive."""

from __future__ import annotations

import numpy as np
import pytest

from common.messages import Level
from services.jetson.camera.config import ZoneConfig
from services.jetson.camera.zone import band, forward_zone, in_forward_zone

ZONE = ZoneConfig()


def test_the_zone_is_the_centre_of_the_picture() -> None:
    assert forward_zone(640, ZONE) == (192.0, 448.0)


@pytest.mark.parametrize(
    ("left", "right", "inside"),
    [
        (300, 340, True),  # in the middle
        (0, 150, False),
        (500, 640, False),
        (0, 400, True),  # its centre is outside, it reaches in: a wide near object
        (430, 640, True),
        (0, 640, True),  # wider than the zone
        (0, 192.5, False),  # less than one pixel
    ],
)
def test_what_reaches_into_the_zone_counts(left: float, right: float, inside: bool) -> None:
    assert in_forward_zone(np.array([left, 100, right, 200]), 640, ZONE) is inside


@pytest.mark.parametrize(
    ("distance_m", "share", "level"),
    [
        (5.0, 0.3, "SAFE"),
        (1.21, 0.3, "SAFE"),
        (1.2, 0.3, "CAUTION"),  # inclusive
        (0.51, 0.3, "CAUTION"),
        (0.5, 0.3, "IMMINENT"),
        (0.0, 0.0, "IMMINENT"),
        (5.0, 0.80, "CAUTION"),  # far by its class, yet it fills most of the picture
        (5.0, 0.95, "IMMINENT"),
        (1.0, 0.99, "IMMINENT"),  # the worse of both
    ],
)
def test_bands(distance_m: float, share: float, level: Level) -> None:
    assert band(distance_m, share, ZONE) == level
