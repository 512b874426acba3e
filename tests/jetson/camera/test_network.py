"""Networks as people export them: what is understood, and what is refused with expected and found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from services.jetson.camera.config import CameraConfig, DetectorConfig
from services.jetson.camera.detector import Detector
from services.jetson.camera.network import ModelError, anchors
from services.jetson.camera.pipeline import CameraPipeline
from tests.jetson.camera.onnx_writer import FLOAT16, UINT8

ModelMaker = Callable[..., Path]

NAMES = "{0: 'person', 1: 'bicycle', 2: 'car'}"
SHAPE = (1, 3, 256, 256)
N = 1344  # anchors of 256 x 256 at strides 8, 16 and 32
PERSON = (128.0, 128.0, 60.0, 150.0)  # centre x, y, width, height
CORNERS = (98.0, 53.0, 158.0, 203.0)


def v8(classes: int = 3, n: int = N, score: float = 0.9) -> np.ndarray:
    """(1, 4 + classes, n): one person, and small boxes without a score."""
    output = np.zeros((1, 4 + classes, n), np.float32)
    output[0, :4] = np.array([[10], [10], [5], [5]])
    output[0, :4, 7], output[0, 4, 7] = PERSON, score
    return output


def v5() -> np.ndarray:
    output = np.zeros((1, 3 * N, 8), np.float32)
    output[0, :, :4] = (10, 10, 5, 5)
    output[0, 7] = (*PERSON, 0.95, 0.9, 0.0, 0.0)
    return output


def end_to_end(rows: int = 300) -> np.ndarray:
    output = np.zeros((1, rows, 6), np.float32)
    output[0, 0] = (*CORNERS, 0.9, 0)
    return output


def pose() -> np.ndarray:
    output = v8(classes=52)
    output[0, 5:, 7] = np.tile([128, 80, 0.9], 18)[:51]
    return output


def masks() -> np.ndarray:
    output = v8(classes=3 + 32)
    output[0, 7:, 7] = np.linspace(-1, 1, 32)
    return output


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("v8", {"output": v8()}),
        ("v8 without names", {"output": v8(), "names": None}),
        ("v8 with dynamic axes", {"output": v8(), "shape": ("batch", 3, "height", "width"), "declared": ("b", 7, "a")}),
        ("batch axis called N", {"output": v8(), "shape": ("N", 3, 256, 256), "declared": ("N", 7, N)}),
        ("batch axis unk__1", {"output": v8(), "shape": ("unk__1", 3, 256, 256), "declared": ("unk__1", 7, N)}),
        ("half precision", {"output": v8(), "kind": FLOAT16}),
        ("one class", {"output": v8(classes=1), "names": "{0: 'pallet'}"}),
        ("names as a list", {"output": v8(), "names": "['person', 'bicycle', 'car']"}),
        ("names as JSON", {"output": v8(), "names": '{"0": "person", "1": "bicycle", "2": "car"}'}),
        ("256 x 320", {"output": v8(n=1680), "shape": (1, 3, 256, 320)}),
        ("transposed", {"output": v8().transpose(0, 2, 1)}),
        ("transposed without names", {"output": v8().transpose(0, 2, 1), "names": None}),
        ("v5", {"output": v5()}),
        ("v5 without names", {"output": v5(), "names": None}),
        ("end to end", {"output": end_to_end(), "end2end": "True"}),
        ("end to end without names", {"output": end_to_end(), "names": None}),
        ("end to end with 1000 rows", {"output": end_to_end(1000)}),
    ],
)
def test_what_people_export_is_understood(make_model: ModelMaker, name: str, model: dict[str, object]) -> None:
    path = make_model(**{"names": NAMES, "shape": SHAPE} | model)
    detector = Detector(DetectorConfig(model=str(path), dynamic_input_px=256))
    image = np.zeros((256, 320 if name == "256 x 320" else 256, 3), np.uint8)
    boxes = detector.detect(image)
    np.testing.assert_allclose(boxes.xyxy_px, [CORNERS], atol=0.5)
    assert boxes.class_id.tolist() == [0], name
    assert boxes.confidence[0] == pytest.approx(0.9, abs=0.05)
    assert detector.names[0] in ("person", "pallet", "class 0")


@pytest.mark.parametrize(
    ("name", "model", "found"),
    [
        ("pose with names", {"output": pose(), "names": "{0: 'person'}", "task": "pose"}, "for the task 'pose'"),
        ("pose", {"output": pose(), "names": None}, "scores from 0 to 128, expected 0..1 (keypoints"),
        ("pose named person", {"output": pose(), "names": "{0: 'person'}"}, "scores from 0 to 128"),
        ("segmentation", {"output": masks(), "outputs": 2, "task": "segment"}, "for the task 'segment'"),
        ("masks in one output", {"output": masks(), "names": None}, "scores from -1 to 1"),
        ("another number of names", {"output": v8(classes=4)}, "3 class names in its metadata, but 4 rows"),
        ("names that are no names", {"output": v8(), "names": "person and car"}, "class names 'person and car'"),
        ("names without numbers", {"output": v8(), "names": "{'person': 0}"}, "class names \"{'person': 0}\""),
        ("a number is missing", {"output": v8(), "names": "{1: 'a', None: 'b'}"}, "class names"),
        ("a classifier", {"output": np.full((1, 1000), 0.001)}, "(1, 1000)"),
        ("logits", {"output": v8(score=3.2)}, "scores from 0 to 3.2"),
        ("negative logits", {"output": v8() - np.r_[0, 0, 0, 0, 6, 6, 6][None, :, None]}, "scores from -6"),
        ("boxes in 0..1", {"output": v8() / np.r_[[256] * 4, 1, 1, 1][None, :, None]}, "not in 0..1"),
        ("no numbers", {"output": v8() * np.nan}, "values that are no numbers"),
        ("anchors of another size", {"output": v8(n=8400)}, "(1, 7, 8400), which fits no layout for an input of 256"),
        ("a batch of four", {"output": np.repeat(v8(), 4, 0), "shape": (4, 3, 256, 256)}, "(4, 3, 256, 256)"),
        ("channels last", {"output": v8(), "shape": (1, 256, 256, 3)}, "(1, 256, 256, 3)"),
        ("grey", {"output": v8(), "shape": (1, 1, 256, 256)}, "(1, 1, 256, 256)"),
        ("bytes", {"output": v8(), "kind": UINT8}, "tensor(uint8)"),
        ("half a class", {"output": end_to_end() + np.r_[0, 0, 0, 0, 0, 0.5]}, "class numbers that are not whole"),
        ("corners in another order", {"output": end_to_end()[:, :, [2, 3, 0, 1, 4, 5]]}, "right or lower edge"),
    ],
)
def test_what_is_not_understood_is_refused_with_expected_and_found(
    make_model: ModelMaker, name: str, model: dict[str, object], found: str
) -> None:
    path = make_model(**{"names": NAMES, "shape": SHAPE} | model)
    with pytest.raises(ModelError) as refusal:
        Detector(DetectorConfig(model=str(path)))
    text = str(refusal.value)
    assert str(path) in text
    assert "expected one input (1, 3, H, W)" in text, name
    assert found in text
    assert "yolo export" in text


def test_the_anchors_of_known_networks() -> None:
    assert 8400 in anchors(640, 640)
    assert 6300 in anchors(480, 640)
    assert 320 in anchors(256, 320)  # the demo network: stride 16 alone
    assert 300 not in anchors(640, 640)


def test_a_class_number_beyond_the_names_is_still_an_obstacle(make_model: ModelMaker) -> None:
    output = end_to_end()
    output[0, 0, 5] = 7
    detector = Detector(DetectorConfig(model=str(make_model(output, names=NAMES, shape=SHAPE))))
    boxes = detector.detect(np.zeros((256, 256, 3), np.uint8))
    assert [detector.names[one] for one in boxes.class_id] == ["unnamed"]


def test_classes_without_a_size_are_said_once(make_model: ModelMaker, caplog: pytest.LogCaptureFixture) -> None:
    path = make_model(v8(classes=2), names="{0: 'Person', 1: 'pallet'}", shape=SHAPE)
    pipeline = CameraPipeline(CameraConfig(detector=DetectorConfig(model=str(path))))
    assert pipeline.unsized == ["pallet"]
    assert [record.getMessage().count("pallet") for record in caplog.records] == [1]
