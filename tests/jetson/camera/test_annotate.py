"""The published picture: a JPEG of the right size with boxes, made from a copy."""

from __future__ import annotations

import cv2
import msgspec
import numpy as np

from common.messages import CameraDetection, CameraDetections
from services.jetson.camera.annotate import LEVEL_BGR, caption, draw, picture
from services.jetson.camera.config import ImageConfig, ZoneConfig

PERSON = CameraDetection(
    label="person", confidence=0.9, box_xyxy_px=(200.0, 100.0, 300.0, 400.0), distance_m=0.6, nearest_m=0.4,
    level="IMMINENT", in_zone=True, truncated=False,
)  # fmt: skip


def seen(*detections: CameraDetection, **fields: object) -> CameraDetections:
    return CameraDetections(
        stamp_ns=5, frame_id="camera", detections=list(detections), brightness=100.0, level=None,
        image_size_px=(640, 480), **fields,
    )  # fmt: skip


def test_the_message_is_a_jpeg_with_the_pictures_stamp() -> None:
    image = np.full((480, 640, 3), 90, np.uint8)
    message = picture(image, seen(PERSON), ZoneConfig(), ImageConfig())
    assert (message.format, message.stamp_ns, message.frame_id) == ("jpeg", 5, "camera")
    decoded = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == image.shape
    blue, _, red = decoded[250, 200].astype(int)
    assert red > blue + 80  # the side of the box, in the colour of IMMINENT
    assert np.all(image == 90)  # the picture itself is untouched


def test_a_large_picture_is_published_smaller_with_the_boxes_in_place() -> None:
    image = np.zeros((960, 1280, 3), np.uint8)
    canvas = draw(image, seen(PERSON), ZoneConfig(), max_width_px=640)
    assert canvas.shape == (480, 640, 3)
    assert canvas[125, 100].any()  # half of (200, 250)


def test_a_degraded_camera_says_why_in_the_picture() -> None:
    image = np.full((480, 640, 3), 90, np.uint8)
    canvas = draw(image, seen(state="degraded", reason="dark: mean brightness 12"), ZoneConfig(), 640)
    assert (canvas[2, 600] == 0).all()


def test_captions_say_at_most_for_cut_off_boxes() -> None:
    assert caption(PERSON) == "person 0.4 m"
    cut = CameraDetection(
        label="car", confidence=0.9, box_xyxy_px=(0, 0, 9, 9), distance_m=3.0, level="SAFE", in_zone=True,
        truncated=True,
    )  # fmt: skip
    assert caption(cut) == "car <= 3.0 m"


def test_the_message_has_the_captions_the_nearest_first() -> None:
    far = msgspec.structs.replace(PERSON, distance_m=3.0, nearest_m=2.5, in_zone=False)
    image = np.full((480, 640, 3), 90, np.uint8)
    assert picture(image, seen(far, PERSON), ZoneConfig(), ImageConfig()).captions == [
        "person 0.4 m", "person 2.5 m (beside)",
    ]  # fmt: skip


def test_captions_of_boxes_in_one_place_stand_below_each_other() -> None:
    """Each is legible: as many fields of the level's colour as there are boxes, whichever is the nearest."""
    near, far = (msgspec.structs.replace(PERSON, distance_m=m, nearest_m=m, level=level) for m, level in
                 ((0.4, "IMMINENT"), (1.1, "CAUTION")))  # fmt: skip
    canvas = draw(np.full((480, 640, 3), 90, np.uint8), seen(far, near), ZoneConfig(), 640)
    for level in ("IMMINENT", "CAUTION"):
        field = np.all(canvas == LEVEL_BGR[level], axis=2)
        assert field.sum(axis=1).max() > 60, level  # a line of the caption's field, longer than the box's two sides


def test_a_caption_stays_in_the_picture() -> None:
    at_the_edge = msgspec.structs.replace(PERSON, box_xyxy_px=(630.0, 0.0, 640.0, 40.0))
    canvas = draw(np.full((480, 640, 3), 90, np.uint8), seen(at_the_edge), ZoneConfig(), 640)
    assert np.all(canvas[4, 560] == LEVEL_BGR["IMMINENT"])
