"""What the camera's tests share: made-up networks in ONNX, a textured picture, a quiet report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.status import Report

ModelMaker = Callable[..., Path]


@pytest.fixture
def report() -> Report:
    return Report("test")


@pytest.fixture
def texture() -> np.ndarray:
    """(480, 640, 3) uint8: a picture with structure at every scale, about as rich as a photograph."""
    rng = np.random.default_rng(3)
    picture = np.zeros((480, 640, 3), np.float32)
    for cells, strength in ((4, 40), (8, 30), (16, 24), (32, 18), (64, 18), (128, 18), (256, 18)):
        noise = rng.normal(0, strength, (cells * 3 // 4, cells, 1)).astype(np.float32)
        picture += cv2.resize(noise, (640, 480), interpolation=cv2.INTER_NEAREST)[..., None]
    return np.clip(picture + 115, 0, 255).astype(np.uint8)


@pytest.fixture
def make_model(tmp_path: Path) -> ModelMaker:
    """``make_model(output, names=..., shape=...)`` writes a network that always gives ``output``."""
    onnx = pytest.importorskip("onnx", reason="the onnx package builds the networks of this test")
    from onnx import TensorProto, helper, numpy_helper

    def build(
        output: np.ndarray,
        names: str | None = "{0: 'person', 1: 'car'}",
        shape: tuple[int | str, ...] = (1, 3, 64, 96),
        outputs: int = 1,
    ) -> Path:
        inputs = [helper.make_tensor_value_info("images", TensorProto.FLOAT, shape)]
        declared = [
            helper.make_tensor_value_info(f"output{i}", TensorProto.FLOAT, output.shape) for i in range(outputs)
        ]
        # output = constant + 0 * mean(input), so that the input is really used
        nodes = [helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0)]
        nodes += [helper.make_node("Mul", ["mean", "zero"], ["nothing"])]
        nodes += [helper.make_node("Add", ["constant", "nothing"], [f"output{i}"]) for i in range(outputs)]
        constants = [
            numpy_helper.from_array(output.astype(np.float32), "constant"),
            numpy_helper.from_array(np.float32(0.0), "zero"),
        ]
        graph = helper.make_graph(nodes, "test", inputs, declared, constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
        if names is not None:
            model.metadata_props.add(key="names", value=names)
        path = tmp_path / "network.onnx"
        onnx.save(model, str(path))
        return path

    return build
