"""Distance from a box: golden values, what a cut box may still say, and what the simulated world says."""

from __future__ import annotations

import math

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.jetson.camera.config import CameraConfig, DistanceConfig, LensConfig, MountConfig
from services.jetson.camera.distance import estimate, scaled
from services.jetson.camera.source import fitted
from spotter_sim import camera as simulated

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
    assert 0.2 * distance.distance_m < distance.near_m < distance.distance_m
    assert not distance.truncated


def test_another_shape_is_the_same_view_cut_and_pixels_stay_square() -> None:
    wide = scaled(LENS, 640, 360)  # the 16:9 mode of the same sensor
    assert (wide.f_x_px, wide.f_y_px, wide.c_x_px, wide.c_y_px) == (397, 397, 320, 180)
    full = scaled(LENS, 1920, 1080)
    assert full.f_y_px == pytest.approx(3 * 397)
    narrow = scaled(full, 640, 480)  # cut to 4:3 again
    assert narrow.f_x_px == narrow.f_y_px == pytest.approx(529, abs=1)
    sharp = estimate(np.array([900, 300, 1000, 750]), "person", full, UNKNOWN, CONFIG)
    small = estimate(np.array([300, 100, 1000 / 3, 250]), "person", wide, UNKNOWN, CONFIG)
    assert small.distance_m == pytest.approx(sharp.distance_m, rel=0.01)


@pytest.mark.parametrize("width_m", [0.25, 0.5, 0.8])
def test_an_adult_at_arm_s_length_before_a_low_camera_is_no_two_metres_away(width_m: float) -> None:
    """The mount is not known: how much of the body is out of view is not either."""
    seen = estimate(box_of(1.0, 1.70, 0.25, width_m), "person", LENS, UNKNOWN, CONFIG)
    assert seen.near_m < 1.0


def test_the_foot_point_tells_how_far_a_child_is() -> None:
    seen = estimate(box_of(1.5, 1.0, 0.25), "person", LENS, MountConfig(height_m=0.25), CONFIG)
    assert seen.distance_m == pytest.approx(1.5, rel=0.02)
    unknown = estimate(box_of(1.5, 1.0, 0.25), "person", LENS, UNKNOWN, CONFIG)
    assert 1.0 < unknown.near_m < 1.5


@pytest.mark.parametrize("camera_m", [0.25, 0.8, 1.53])
def test_a_car_is_as_far_as_the_camera_s_height_says(camera_m: float) -> None:
    """Its box reaches from the near bumper on the ground to the front edge of the roof, wherever the camera is."""
    true_m, length_m, height_m = 15.0, 4.2, 1.53
    bottom = LENS.c_y_px + LENS.f_y_px * camera_m / (true_m - length_m / 2)
    top = LENS.c_y_px + LENS.f_y_px * (camera_m - height_m) / (true_m - length_m / 4)
    half_px = LENS.f_x_px * 1.75 / 2 / (true_m - length_m / 2)
    no_ground = MountConfig(height_m=camera_m, pitch_sigma_rad=0.5)  # the height alone
    seen = estimate(np.array([320 - half_px, top, 320 + half_px, bottom]), "car", LENS, no_ground, CONFIG)
    assert seen.distance_m == pytest.approx(true_m, rel=0.01)


def test_what_is_only_bounded_may_be_nearer_than_its_bound() -> None:
    """A car cut off below and at the side, camera height known: half of it may be out of view."""
    road = LensConfig(width_px=1242, height_px=375, f_x_px=721, f_y_px=721, c_x_px=610, c_y_px=173)
    seen = estimate(np.array([0.0, 190.0, 380.0, 374.0]), "car", road, MountConfig(height_m=1.65), CONFIG)
    assert seen.truncated
    assert seen.distance_m == pytest.approx(5.9, abs=0.2)
    assert seen.near_m < 2.5


def test_what_reaches_below_the_picture_is_near_until_the_mount_is_known() -> None:
    box = np.array([300.0, 100.0, 340.0, 479.0])
    assert estimate(box, "person", LENS, UNKNOWN, CONFIG).near_m < 0.5
    assert estimate(box, "person", LENS, MountConfig(height_m=1.2), CONFIG).near_m > 0.5


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
    near_end_m = 397 * CONFIG.sizes["car"].lowest_m / 100  # of the lowest car, to its middle
    assert 2 * (near_end_m - distance.near_m) == pytest.approx(deep_m, rel=0.05)
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


def test_the_near_end_covers_the_true_distances_of_the_simulated_world() -> None:
    """Persons and the small car of `crossing`, whole or cut off, through the simulated camera's own calibration."""
    config = fitted(CameraConfig(source="sim:crossing"))
    over = []
    for t_s in np.arange(0.0, 15.0, 0.25):
        for box in simulated.boxes("crossing", float(t_s)):
            if box.visible < 0.9 or box.distance_m > 6:
                continue
            found = estimate(np.array(box.box_xyxy_px), box.label, config.lens, config.mount, config.distance)
            over.append((found.near_m - box.distance_m) / box.distance_m)
    assert len(over) > 30
    assert np.quantile(over, 0.95) < 0.0  # the near end covers the truth
    assert np.median(over) > -0.25
    assert np.quantile(over, 0.1) > -0.55


def test_names_of_classes_are_compared_without_case() -> None:
    box = np.array([300, 100, 340, 300])
    person, upper = (estimate(box, label, LENS, UNKNOWN, CONFIG) for label in ("person", "Person"))
    assert person == upper


def test_a_wide_lens_is_straightened_before_distances_are_taken() -> None:
    """A person at 3 m beside the axis, seen through a barrel: without the coefficients it would be farther away."""
    barrel = msgspec.structs.replace(LENS, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0))
    matrix = np.array([[LENS.f_x_px, 0, LENS.c_x_px], [0, LENS.f_y_px, LENS.c_y_px], [0, 0, 1]])
    x, top, bottom = 1.5 / 3, -0.9 / 3, 0.8 / 3  # of the middle of the body, normalised
    points = np.array([[x - 0.08, 0, 1], [x + 0.08, 0, 1], [x, top, 1], [x, bottom, 1]])
    seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(barrel.distortion))[0][:, 0]
    box = np.array([seen[0, 0], seen[2, 1], seen[1, 0], seen[3, 1]])
    assert estimate(box, "person", barrel, UNKNOWN, CONFIG).distance_m == pytest.approx(3.0, rel=0.01)
    assert estimate(box, "person", LENS, UNKNOWN, CONFIG).distance_m > 3.2
