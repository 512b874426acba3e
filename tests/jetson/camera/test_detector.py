"""From the network's raw output to boxes, and which model files are refused and how."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.jetson.camera.config import DetectorConfig
from services.jetson.camera.detector import Boxes, Detector, ModelError, decode, suppress

ModelMaker = Callable[..., Path]


def columns(*candidates: tuple[float, ...]) -> np.ndarray:
    """(4 + classes, N) from rows cx, cy, w, h, scores..."""
    return np.array(candidates, np.float32).T


def reference_decode(output: np.ndarray, confidence: float) -> list[tuple[float, ...]]:
    """The layout read slowly, candidate by candidate."""
    found = []
    for cx, cy, w, h, *scores in output.T.tolist():
        best = max(range(len(scores)), key=lambda i: scores[i])
        if scores[best] >= confidence and w > 0 and h > 0:
            found.append((cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2, scores[best], best))
    return found


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    shared = np.prod(np.maximum(np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2]), 0))
    return float(shared / (np.prod(one[2:] - one[:2]) + np.prod(other[2:] - other[:2]) - shared))


def reference_suppress(boxes: Boxes, iou: float) -> set[int]:
    kept: list[int] = []
    for i in np.argsort(-boxes.confidence, kind="stable"):
        rivals = [k for k in kept if boxes.class_id[k] == boxes.class_id[i]]
        if all(overlap(boxes.xyxy_px[i], boxes.xyxy_px[k]) <= iou for k in rivals):
            kept.append(int(i))
    return set(kept)


@given(seed=st.integers(0, 10_000), count=st.integers(0, 40), confidence=st.floats(0.1, 0.9))
def test_decode_reads_the_layout(seed: int, count: int, confidence: float) -> None:
    rng = np.random.default_rng(seed)
    output = np.concatenate([rng.uniform(-5, 100, (4, count)), rng.random((3, count))]).astype(np.float32)
    boxes = decode(output, confidence)
    expected = reference_decode(output, confidence)
    assert len(boxes.confidence) == len(expected)
    for i, row in enumerate(expected):
        got = (*boxes.xyxy_px[i], boxes.confidence[i], boxes.class_id[i])
        assert got == pytest.approx(row, abs=1e-4)


def test_candidates_that_are_no_numbers_are_dropped() -> None:
    good = (50.0, 50.0, 10.0, 20.0, 0.9, 0.1)
    broken = [(np.nan, 50, 10, 20, 0.9, 0.1), (50, np.inf, 10, 20, 0.9, 0.1), (50, 50, -1, 20, 0.9, 0.1)]
    boxes = decode(columns(*broken, good, (50, 50, 10, 20, np.inf, 0.1)), 0.4)
    assert len(boxes.confidence) == 1
    np.testing.assert_allclose(boxes.xyxy_px, [[45, 40, 55, 60]])


def test_hidden_classes_do_not_compete() -> None:
    """A box that is mostly a chair but also a person is a person when chairs are not asked for."""
    boxes = decode(columns((50, 50, 10, 20, 0.5, 0.8)), 0.4, np.array([True, False]))
    assert boxes.class_id.tolist() == [0]
    assert boxes.confidence.tolist() == pytest.approx([0.5])


@given(seed=st.integers(0, 10_000), count=st.integers(1, 30), iou=st.floats(0.2, 0.8))
def test_suppression_is_per_class_and_keeps_the_surest(seed: int, count: int, iou: float) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(0, 60, (count, 2))
    boxes = Boxes(
        np.concatenate([low, low + rng.uniform(10, 60, (count, 2))], axis=1).astype(np.float32),
        rng.permutation(np.linspace(0.5, 0.99, count)).astype(np.float32),
        rng.integers(0, 3, count),
    )
    kept = suppress(boxes, 0.4, iou)
    assert set(kept.confidence.tolist()) == {float(boxes.confidence[i]) for i in reference_suppress(boxes, iou)}
    assert np.all(np.diff(kept.confidence) <= 0)


def test_two_classes_in_one_place_both_stay() -> None:
    boxes = decode(columns((50, 50, 20, 20, 0.9, 0.0), (51, 50, 20, 20, 0.8, 0.0), (50, 50, 20, 20, 0.0, 0.7)), 0.4)
    assert suppress(boxes, 0.4, 0.5).class_id.tolist() == [0, 1]


ANCHORS = 126  # of 64 x 96 at strides 8, 16 and 32


def output_of(*candidates: tuple[float, ...]) -> np.ndarray:
    """(1, 4 + classes, ANCHORS) with these candidates and else small boxes without a score."""
    rows = np.zeros((4 + 2, ANCHORS), np.float32)
    rows[:4] = np.array([[10], [10], [5], [5]])
    rows[:, 7 : 7 + len(candidates)] = columns(*candidates)
    return rows[None]


ONE_CAR = output_of((48, 32, 24, 32, 0.1, 0.8))


def test_a_network_of_the_layout_runs(make_model: ModelMaker) -> None:
    detector = Detector(DetectorConfig(model=str(make_model(ONE_CAR))))
    assert (detector.width_px, detector.height_px, detector.names) == (96, 64, ["person", "car"])
    assert detector.provider == "CPUExecutionProvider"
    boxes = detector.detect(np.zeros((128, 192, 3), np.uint8))  # twice the input's size
    np.testing.assert_allclose(boxes.xyxy_px, [[72, 32, 120, 96]], atol=1e-3)
    assert boxes.class_id.tolist() == [1]


def test_a_model_without_a_size_takes_the_configured_one(make_model: ModelMaker) -> None:
    output = np.zeros((1, 6, 189), np.float32)  # 96 x 96
    output[0, 2:4] = 5.0
    path = make_model(output, shape=(1, 3, "height", "width"))
    assert Detector(DetectorConfig(model=str(path), dynamic_input_px=96)).width_px == 96


def test_a_model_without_names_counts_its_classes(make_model: ModelMaker) -> None:
    path = make_model(ONE_CAR, names=None)
    assert Detector(DetectorConfig(model=str(path))).names == ["class 0", "class 1"]


def test_only_the_wanted_classes_are_reported(make_model: ModelMaker) -> None:
    detector = Detector(DetectorConfig(model=str(make_model(ONE_CAR)), classes=("Person",)))
    assert len(detector.detect(np.zeros((64, 96, 3), np.uint8)).confidence) == 0


def test_a_missing_file_and_a_file_of_another_kind_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no such file"):
        Detector(DetectorConfig(model=str(tmp_path / "none.onnx")))
    picture = tmp_path / "picture.onnx"
    picture.write_bytes(b"\x89PNG not a network")
    with pytest.raises(ModelError, match="expected an ONNX network; found a file that does not load"):
        Detector(DetectorConfig(model=str(picture)))


def test_an_unknown_class_is_refused_with_the_known_ones(make_model: ModelMaker) -> None:
    path = make_model(ONE_CAR)
    with pytest.raises(ModelError, match=r"\['lorry'\].*person, car"):
        Detector(DetectorConfig(model=str(path), classes=("lorry",)))


def test_nothing_is_reported_home(tmp_path: Path) -> None:
    """ONNX Runtime would keep a file of what it wants to send, below the user's home."""
    code = "from services.jetson.camera.detector import *; print(Detector(DetectorConfig()).provider)"
    unasked = {
        name: value for name, value in os.environ.items() if name not in ("ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME")
    }
    ran = subprocess.run(
        [sys.executable, "-c", code], env={**unasked, "HOME": str(tmp_path)}, capture_output=True, text=True, check=True
    )
    assert "ExecutionProvider" in ran.stdout
    assert not [path for path in tmp_path.rglob("*") if "onnxruntime" in path.name]
