"""The camera's picture: left is left, boxes follow the projection, faults."""

from __future__ import annotations

import numpy as np
import pytest

from common.geometry import transform_points
from spotter_sim import camera
from spotter_sim.model import DeviceUnplugged
from spotter_sim.view import F_Y_PX, lens_of
from spotter_sim.world import T_vehicle_camera, world_at

CAMERA_X_M, CAMERA_Z_M = T_vehicle_camera[0, 3], T_vehicle_camera[2, 3]


def test_picture_format_and_brightness():
    picture = camera.image("crossing", 1.0)
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    assert 80 < picture.mean() < 180
    assert camera.image("crossing", 1.0, 320, 240).shape == (240, 320, 3)


def test_dark_is_dark_and_a_pulled_plug_raises():
    assert camera.image("faults", 23.0).mean() < 40
    assert camera.image("faults", 28.0).mean() > 80
    with pytest.raises(DeviceUnplugged):
        camera.image("faults", 32.0)


def test_pictures_repeat_exactly_and_are_noisy():
    np.testing.assert_array_equal(camera.image("crossing", 2.0), camera.image("crossing", 2.0))
    change = camera.image("empty", 2.0).astype(int) - camera.image("empty", 2.1)
    assert 1.0 < change.std() < 10.0


def test_pinhole():
    lens = lens_of(world_at("empty", 0.0))
    pixel, depth = lens.project(np.array([[CAMERA_X_M + 5.0, 1.0, CAMERA_Z_M + 0.5]]))
    np.testing.assert_allclose(pixel[0], [320 - F_Y_PX / 5.0, 240 - F_Y_PX * 0.1])
    assert depth[0] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("kind", "x_m", "y_m", "height_m", "label"),
    [
        ("pedestrian", 4.0, 0.0, 1.72, "person"),
        ("pedestrian", 6.0, 2.0, 1.72, "person"),  # at the left
        ("cyclist", 6.0, -2.0, 1.75, "bicycle"),
        ("car", 9.0, -1.0, 1.48, "car"),
        ("bus", 20.0, 3.0, 3.1, "bus"),
        ("truck", 18.0, 0.0, 3.4, "truck"),
    ],
)
def test_box_is_the_projection_of_the_body(one_actor, kind, x_m, y_m, height_m, label):
    scenario = one_actor(kind, x_m, y_m)
    (box,) = camera.boxes(scenario, 0.0)
    assert box.label == label
    assert box.visible > 0.95
    assert not box.truncated
    x0, y0, x1, y1 = box.box_xyxy_px
    assert (0.5 * (x0 + x1) < 320) == (y_m > 0) or abs(y_m) < 0.1  # left in the world is left in the picture
    expected = F_Y_PX * height_m / box.distance_m  # what a height in the picture means
    length = scenario.at(0.0).actors[0].size_m[0]
    assert expected * box.distance_m / (box.distance_m + length) * 0.97 <= y1 - y0 <= expected * 1.08
    assert box.distance_m == pytest.approx(x_m - CAMERA_X_M - length / 2, abs=0.25)


def test_box_against_brute_force_points(one_actor):
    """The box holds thousands of points inside the body's solids and is not larger than they need."""
    scenario = one_actor("car", 7.0, 1.0, yaw_rad=2.5)
    world = scenario.at(0.0)
    solids = world.actors[0].solids
    rng = np.random.default_rng(0)
    unit = rng.uniform(-1, 1, (4000, 3))
    cloud = np.concatenate(
        [
            solids.centre_m[i] + (unit if shape == 2 else unit[(unit**2).sum(1) <= 1]) @ solids.from_unit[i].T
            for i, shape in enumerate(solids.shape)
        ]
    )
    local = transform_points(lens_of(world).T_camera_map, cloud)
    u, v = 320 - F_Y_PX * local[:, 1] / local[:, 0], 240 - F_Y_PX * local[:, 2] / local[:, 0]
    (box,) = camera.boxes(scenario, 0.0)
    np.testing.assert_allclose(box.box_xyxy_px, [u.min(), v.min(), u.max(), v.max()], atol=6.0)


def test_the_picture_changes_inside_the_box_only(one_actor):
    with_person = camera.image(one_actor("pedestrian", 5.0, 0.5), 0.0).astype(int)
    without = camera.image(one_actor("pedestrian", -50.0, 0.5), 0.0).astype(int)
    changed = np.argwhere(np.abs(with_person - without).max(axis=2) > 40)
    (box,) = camera.boxes(one_actor("pedestrian", 5.0, 0.5), 0.0)
    x0, y0, x1, y1 = box.box_xyxy_px
    assert len(changed) > 500
    low, high = changed.min(axis=0), changed.max(axis=0)
    np.testing.assert_allclose([low[1], low[0], high[1], high[0]], [x0, y0, x1, y1], atol=4)


def test_near_bodies_are_truncated_and_hidden_ones_known():
    boxes = {b.actor_id: b for b in camera.boxes("crossing", 5.5)}
    assert boxes[1].truncated
    assert boxes[1].visible == pytest.approx(1.0, abs=0.02)
    assert boxes[2].visible < 0.6  # the car waits behind the person's legs
    assert boxes[1].distance_m < 0.8


def test_nothing_behind_the_camera(one_actor):
    assert camera.boxes(one_actor("car", -5.0, 0.0), 0.0) == []
    assert camera.boxes(one_actor("car", 3.0, 30.0), 0.0) == []
