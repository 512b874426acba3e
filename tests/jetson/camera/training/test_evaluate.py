"""Reading KITTI's labels and matching them, on lines written for the test."""

from __future__ import annotations

import json

import pytest

from common.messages import CameraDetection
from services.jetson.camera.config import LensConfig
from services.jetson.camera.training.evaluate import (
    Solid,
    compare,
    json_labels,
    lens_of,
    nearest_in_view_m,
    object_labels,
    projection,
    tracking_labels,
)

OBJECT = "Car 0.00 0 1.5 100.0 50.0 200.0 150.0 1.5 1.6 4.0 1.0 1.6 {depth} 0.1"
BOX = (100.0, 50.0, 200.0, 150.0)
LENS = LensConfig(width_px=1242, height_px=375, f_x_px=700, f_y_px=700, c_x_px=621, c_y_px=187)


def seen(box: tuple[float, float, float, float], distance_m: float, label: str = "car") -> CameraDetection:
    return CameraDetection(
        label=label, confidence=0.9, box_xyxy_px=box, distance_m=distance_m, level="SAFE", in_zone=True,
        truncated=False,
    )  # fmt: skip


def test_object_and_tracking_lines_say_the_same() -> None:
    line = OBJECT.format(depth=10.0)
    (label,) = object_labels(line)
    assert (label.kind, label.box_xyxy_px, label.depth_m) == ("Car", BOX, 10.0)
    by_frame = tracking_labels(f"7 3 {line}\n7 -1 DontCare -1 -1 -10 0 0 9 9 -1 -1 -1 -1 -1 -1 -1\n8 3 {line}")
    assert by_frame == {7: [label], 8: [label]}


def test_json_labels_leave_out_what_has_no_class() -> None:
    box_3d = [1.0, 1.6, 10.0, 4.0, 1.5, 1.6, 0.1]
    instances = [{"bbox_label": 2, "bbox": list(BOX), "bbox_3d": box_3d}, {"bbox_label": -1, "bbox": [0, 0, 1, 1]}]
    (label,) = json_labels(json.dumps({"data_list": [{"instances": instances}]}))
    assert label == object_labels(OBJECT.format(depth=10.0))[0]


def test_the_lens_comes_from_the_projection() -> None:
    lens = lens_of(projection("P0: " + "0 " * 12 + "\nP2: 700 0 600 1 0 710 170 2 0 0 1 3\n"), 1242, 375)
    assert (lens.f_x_px, lens.f_y_px, lens.c_x_px, lens.c_y_px) == (700, 710, 600, 170)
    with pytest.raises(KeyError, match="P2"):
        projection("P0: 1")


def test_matching_is_one_to_one_and_errors_are_relative() -> None:
    labels = object_labels(OBJECT.format(depth=10.0) + "\n" + OBJECT.format(depth=20.0))
    errors = compare([seen(BOX, 9.0), seen((300, 0, 400, 90), 5.0)], labels, LENS, {"car": 1.5})
    assert len(errors) == 1
    (error,) = errors
    assert error.ours == pytest.approx(abs(9.0 - error.label.depth_m) / error.label.depth_m)
    assert error.plain_m == pytest.approx(10.5)  # 700 * 1.5 / 100


@pytest.mark.parametrize(
    ("solid", "nearest_m"),
    [
        (Solid(1.5, 1.6, 4.0, 0.0, 1.6, 10.0, 0.0), 9.2),  # across the way: half its width nearer than its middle
        (Solid(1.5, 1.6, 4.0, 0.0, 1.6, 10.0, 1.5707963), 8.0),  # along the way: half its length
        (Solid(1.5, 1.6, 4.0, 2.8, 1.6, 3.0, 1.5707963), 2.5),  # beside us: its front is outside the picture
        (Solid(1.5, 1.6, 4.0, 90.0, 1.6, 3.0, 0.0), 3.0),  # nothing of it in the picture
    ],
)
def test_the_nearest_part_in_view(solid: Solid, nearest_m: float) -> None:
    assert nearest_in_view_m(solid, LENS) == pytest.approx(nearest_m, abs=0.01)
