"""Distance from a box: golden values, what a cut box may still say, and what the simulated world says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.sim import camera as simulated
from services.jetson.camera.config import CameraConfig, DistanceConfig, LensConfig, MountConfig
from services.jetson.camera.distance import estimate, scaled
from services.jetson.camera.source import fitted

LENS, UNKNOWN, CONFIG = LensConfig(), MountConfig(), DistanceConfig()
LOW = MountConfig(height_m=0.24)  # on a model car


def box_of(distance_m: float, height_m: float, camera_m: float = 0.24, width_m: float = 0.5) -> np.ndarray:
    """Where an upright thing on the ground stands in the default picture, cut off by its edges."""
    f, row = LENS.f_y_px, LENS.c_y_px
    across = f * width_m / distance_m / 2
    box = [320 - across, row - f * (height_m - camera_m) / distance_m, 320 + across, row + f * camera_m / distance_m]
    return np.clip(box, 0, [640, 480, 640, 480]).astype(np.float32)


@pytest.mark.parametrize(
    ("label", "rows", "expected_m"),
    [
        ("person", 200, 3.4),  # data sheet 4.4 of the facts: f = 397 px, 1.7 m
        ("obstacle", 200, 0.6),  # 0.3 m
        ("person", 100, 6.75),
        ("something else", 200, 0.6),  # unknown: the nearest it could be, by the smallest height
    ],
)
def test_pinhole(label: str, rows: float, expected_m: float) -> None:
    distance = estimate(np.array([300, 100, 340, 100 + rows]), label, LENS, UNKNOWN, CONFIG)
    assert distance.distance_m == pytest.approx(expected_m, rel=0.01)
    assert distance.distance_m - 0.15 < distance.near_m < distance.distance_m
    assert not distance.truncated


def test_a_picture_squeezed_from_16_to_9_keeps_rows_and_columns_apart() -> None:
    binned = LensConfig(width_px=1920, height_px=1080, f_x_px=1258, f_y_px=1258, c_x_px=960, c_y_px=540)
    squeezed = scaled(binned, 640, 480)
    assert squeezed.f_y_px == pytest.approx(559, abs=0.5)
    assert squeezed.f_x_px == pytest.approx(419, abs=0.5)
    assert (squeezed.c_x_px, squeezed.c_y_px) == (320, 240)
    sharp = estimate(np.array([900, 300, 1000, 750]), "person", binned, UNKNOWN, CONFIG)
    small = estimate(np.array([300, 300 * 4 / 9, 1000 / 3, 750 * 4 / 9]), "person", squeezed, UNKNOWN, CONFIG)
    assert small.distance_m == pytest.approx(sharp.distance_m)


@pytest.mark.parametrize(
    ("box", "cut"),
    [
        ((100, 100, 200, 300), False),
        ((2, 100, 90, 300), True),
        ((100, 2, 200, 300), True),
        ((560, 100, 637, 300), True),
        ((100, 300, 200, 478), True),
    ],
)
def test_a_box_at_the_picture_edge_is_cut_off(box: tuple[float, ...], cut: bool) -> None:
    assert estimate(np.array(box), "person", LENS, UNKNOWN, CONFIG).truncated is cut


@given(near_m=st.floats(0.5, 1.4))
def test_what_a_cut_box_says_is_at_most(near_m: float) -> None:
    """Head and feet outside the picture, camera at 1.2 m: the visible rows bound the distance from above."""
    box = box_of(near_m, 1.70, camera_m=1.2)
    distance = estimate(box, "person", LENS, UNKNOWN, CONFIG)
    if box[1] == 0:
        assert distance.truncated
        # the width is believed too, within its spread
        assert distance.distance_m <= LENS.f_y_px * 1.70 / float(box[3] - box[1]) + 1e-6


@given(true_m=st.floats(0.5, 1.15))
def test_with_a_known_mount_feet_tell_the_distance_of_a_person_whose_head_is_cut_off(true_m: float) -> None:
    box = box_of(true_m, 1.70)
    assert box[1] == 0
    plain_m = LENS.f_y_px * 1.70 / float(box[3] - box[1])
    distance = estimate(box, "person", LENS, LOW, CONFIG)
    assert distance.distance_m == pytest.approx(true_m, rel=0.1)
    assert abs(distance.distance_m - true_m) < abs(plain_m - true_m)


def test_with_a_known_mount_the_top_tells_the_distance_when_the_feet_are_cut_off() -> None:
    mount = MountConfig(height_m=0.6, pitch_rad=0.35)
    horizon = LENS.c_y_px + LENS.f_y_px * math.tan(0.35)
    box = np.array([249, horizon - LENS.f_y_px * 1.1 / 1.4, 391, 480])
    assert estimate(box, "person", LENS, mount, CONFIG).distance_m == pytest.approx(1.4, rel=0.1)


def test_of_contradicting_cues_the_nearer_is_believed() -> None:
    """A child of half the class height: by its height 2.6 m, by where it stands 1.3 m."""
    distance = estimate(box_of(1.3, 0.85), "person", LENS, LOW, CONFIG)
    assert distance.distance_m == pytest.approx(1.3, rel=0.05)


@pytest.mark.parametrize(("width_px", "deep_m"), [(120, 4.2), (275, 1.75)])
def test_the_aspect_tells_how_deep_a_car_is(width_px: float, deep_m: float) -> None:
    """Seen from behind it is long, seen from the side it is as deep as it is wide."""
    box = np.array([300 - width_px / 2, 200, 300 + width_px / 2, 300])
    distance = estimate(box, "car", LENS, UNKNOWN, CONFIG)
    assert 2 * (distance.distance_m - distance.near_m) == pytest.approx(deep_m, rel=0.05)
    assert distance.distance_m == pytest.approx(397 * 1.53 / 100 + deep_m / 4, rel=0.02)


@given(
    left=st.floats(0, 600), top=st.floats(0, 440), width=st.floats(1, 640), height=st.floats(1, 480),
    label=st.sampled_from(["person", "car", "bus", "unheard of"]), camera_m=st.floats(0.0, 2.0, allow_subnormal=False),
)  # fmt: skip
def test_every_box_gives_a_positive_finite_distance(
    left: float, top: float, width: float, height: float, label: str, camera_m: float
) -> None:
    box = np.array([left, top, min(left + width, 640), min(top + height, 480)])
    distance = estimate(box, label, LENS, MountConfig(height_m=camera_m), CONFIG)
    assert 0 < distance.distance_m < 1e4
    assert 0 <= distance.near_m <= distance.distance_m
    assert 0 < distance.sigma_m < 1e4


@given(rows=st.floats(20, 300), more=st.floats(1.05, 1.4))
def test_a_taller_box_is_nearer(rows: float, more: float) -> None:
    def at(height: float) -> float:
        return estimate(np.array([300, 20, 340, 20 + height]), "person", LENS, UNKNOWN, CONFIG).distance_m

    assert at(rows * more) < at(rows)


def test_true_boxes_of_the_simulated_world_give_its_true_distances() -> None:
    """Persons and the small car of `crossing`, whole or cut off, through the simulated camera's own calibration."""
    config = fitted(CameraConfig())
    errors = []
    for t_s in np.arange(0.0, 15.0, 0.25):
        for box in simulated.boxes("crossing", float(t_s)):
            if box.visible < 0.9 or box.distance_m > 6:
                continue
            found = estimate(np.array(box.box_xyxy_px), box.label, config.lens, config.mount, config.distance)
            errors.append(abs(found.near_m - box.distance_m) / box.distance_m)
    assert len(errors) > 30
    assert np.median(errors) < 0.10
    assert np.quantile(errors, 0.9) < 0.30
