"""Real photographs through a real network of the wild: what is found, and how far it is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from services.jetson.camera.config import CameraConfig, DetectorConfig, HealthConfig, LensConfig, MountConfig
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.training.evaluate import Error, compare, kitti_pictures, label_boxes, lens_of

pytestmark = pytest.mark.slow
HEIGHTS_M = {"car": 1.53, "person": 1.75, "truck": 2.8, "bicycle": 1.05, "bus": 3.0}


@pytest.fixture(scope="module")
def config(recordings: Callable[[str], Path]) -> CameraConfig:
    network = recordings("camera") / "yolov8n_int8.onnx"
    return CameraConfig(source="file:", detector=DetectorConfig(model=str(network), confidence=0.3))


@pytest.fixture(scope="module")
def kitti(config: CameraConfig, recordings: Callable[[str], Path]) -> dict[float, list[Error]]:
    """Every matched object of the labelled street pictures, by the camera height that was told (0 = unknown)."""
    errors: dict[float, list[Error]] = {0.0: [], 1.65: []}
    for picture in kitti_pictures(recordings("camera").parent):
        image = cv2.imread(str(picture.path))
        lens = lens_of(picture.projection, image.shape[1], image.shape[0])
        for height_m, found in errors.items():
            placed = msgspec.structs.replace(config, lens=lens, mount=MountConfig(height_m=height_m))
            seen = CameraPipeline(placed).process(0, image)
            found += compare(seen.detections, picture.labels, lens, HEIGHTS_M)
    return errors


def test_the_bus_stop(config: CameraConfig, recordings: Callable[[str], Path]) -> None:
    pipeline = CameraPipeline(config)
    seen = pipeline.process(0, cv2.imread(str(recordings("camera") / "bus.jpg")))
    found = Counter(detection.label for detection in seen.detections)
    assert found["person"] >= 3
    assert found["bus"] == 1
    assert seen.state == "online"
    bus = next(detection for detection in seen.detections if detection.label == "bus")
    assert bus.in_zone


@pytest.mark.parametrize("camera_m", [0.0, 1.65])
def test_distances_beat_the_plain_formula_on_the_same_boxes(kitti: dict[float, list[Error]], camera_m: float) -> None:
    errors = kitti[camera_m]
    assert len(errors) >= 20
    ours, plain = np.array([e.ours for e in errors]), np.array([e.plain for e in errors])
    assert np.median(ours) < np.median(plain)
    assert np.median(ours) < 0.07
    whole = np.array([not e.truncated for e in errors])
    assert np.quantile(ours[whole], 0.9) < np.quantile(plain[whole], 0.9)
    assert ours.max() <= plain.max()


def test_the_ground_helps_where_boxes_are_cut_off(kitti: dict[float, list[Error]]) -> None:
    unknown, known = ([e.ours for e in kitti[height_m] if e.truncated] for height_m in (0.0, 1.65))
    assert len(unknown) >= 4
    assert np.mean(known) < 0.6 * np.mean(unknown)


def test_a_cut_off_object_is_never_farther_than_said(kitti: dict[float, list[Error]]) -> None:
    """ "At most" holds within the stated uncertainty; boxes that only touch the side edge far away are estimates."""
    near = [e for e in kitti[1.65] if e.truncated and e.label.depth_m < 10]
    assert near
    assert all(e.label.depth_m < 1.25 * e.distance_m for e in near)


def test_the_near_end_covers_the_truth(kitti: dict[float, list[Error]]) -> None:
    """In 95 of 100 objects. The middle of a car that is cut off at the side may lie outside the picture, nearer."""
    for errors in (kitti[0.0], [e for e in kitti[1.65] if not e.truncated]):
        assert np.mean([e.nearest_m <= e.label.depth_m for e in errors]) >= 0.95
    assert sum(e.nearest_m > e.label.depth_m for e in kitti[1.65]) <= 2


def test_distances_of_thousands_of_labelled_boxes(recordings: Callable[[str], Path]) -> None:
    """Without a network's errors, camera height known: the geometry alone, every tenth picture of ten drives."""
    boxes = list(label_boxes(recordings("tracking-kitti").parent, 1.65, noise_px=1.5, every=10))
    assert len(boxes) > 1000
    assert np.mean([found.near_m <= label.depth_m for label, found, _ in boxes]) > 0.97
    assert np.mean([found.near_m <= nearest_m for _, found, nearest_m in boxes]) > 0.97
    whole = [abs(found.distance_m / label.depth_m - 1) for label, found, _ in boxes if not found.truncated]
    assert np.median(whole) < 0.055
    assert np.quantile(whole, 0.9) < 0.15


def test_a_person_walks_through_the_room(config: CameraConfig, recordings: Callable[[str], Path]) -> None:
    """Every 60th picture of the video: somebody in more than half, never more than two, no false state."""
    video = cv2.VideoCapture(str(recordings("camera") / "one-by-one-person-detection.mp4"))
    sparse = HealthConfig(slow_below_hz=0.0)
    lens = LensConfig(width_px=768, height_px=432)
    pipeline = CameraPipeline(msgspec.structs.replace(config, lens=lens, health=sparse))
    counts = []
    for number in range(0, 900, 60):
        video.set(cv2.CAP_PROP_POS_FRAMES, number)
        seen = pipeline.process(number * 10**8, video.read()[1])
        assert seen.state == "online"
        counts.append(sum(detection.label == "person" for detection in seen.detections))
    video.release()
    assert sum(count > 0 for count in counts) >= len(counts) / 2
    assert max(counts) <= 2


def test_another_network_through_the_same_door_is_one_key(config: CameraConfig) -> None:
    pipeline = CameraPipeline(CameraConfig(detector=DetectorConfig(model=config.detector.model)))
    seen = pipeline.process(0, np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8))
    assert seen.image_size_px == (640, 480)
