"""The shipped network: small, of the layout, with its names; and the pictures it learns from."""

from __future__ import annotations

import numpy as np

from services.jetson.camera.config import DetectorConfig
from services.jetson.camera.detector import DEMO_MODEL, Detector
from services.jetson.camera.training.training_world import Canvas, random_scenario, training_set
from spotter_sim import camera as simulated

NAMES = ("person", "bicycle", "car", "bus", "truck")


def test_it_is_small_and_knows_its_names() -> None:
    assert DEMO_MODEL.stat().st_size < 2_000_000
    detector = Detector(DetectorConfig())
    assert tuple(detector.names) == NAMES
    assert (detector.width_px, detector.height_px) == (320, 256)
    assert detector.infer(np.zeros((1, 3, 256, 320), np.float32)).shape == (4 + len(NAMES), 320)


def test_it_finds_people_and_cars_in_places_it_has_never_seen() -> None:
    """Fresh random places: most of what stands free and near is found, little else is."""
    rng = np.random.default_rng(999)
    detector = Detector(DetectorConfig())
    found, missed, invented = 0, 0, 0
    for number in range(12):
        scenario = random_scenario(f"unseen {number}", 5, rng)
        for second in range(5):
            truth = simulated.boxes(scenario, second + 0.5)
            boxes = detector.detect(simulated.image(scenario, second + 0.5))
            names = [detector.names[i] for i in boxes.class_id]
            for true in truth:
                if true.visible > 0.8 and true.distance_m < 4 and true.label in ("person", "car"):
                    hit = any(
                        n == true.label and _iou(b, true.box_xyxy_px) > 0.4
                        for n, b in zip(names, boxes.xyxy_px, strict=True)
                    )
                    found, missed = found + hit, missed + (not hit)
            invented += sum(all(_iou(b, t.box_xyxy_px) < 0.2 for t in truth) for b in boxes.xyxy_px)
    assert found >= 0.75 * (found + missed), (found, missed)
    assert invented <= 0.5 * 12 * 5, invented


def test_training_pictures_are_reproducible() -> None:
    canvas = Canvas(320, 256, NAMES)
    one, other = (training_set(1, 2, canvas, np.random.default_rng(4)) for _ in range(2))
    assert one[0].shape == (2, 3, 256, 320)
    np.testing.assert_array_equal(one[0], other[0])
    assert all(rows.shape[1] == 6 for rows in one[1])


def _iou(one: np.ndarray, other: tuple[float, ...]) -> float:
    low, high = np.maximum(one[:2], other[:2]), np.minimum(one[2:], other[2:])
    shared = float(np.prod(np.maximum(high - low, 0)))
    areas = [(box[2] - box[0]) * (box[3] - box[1]) for box in (one, other)]
    return shared / (sum(areas) - shared)
