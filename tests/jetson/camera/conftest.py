"""What the camera's tests share: made-up networks in ONNX, a textured picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.jetson.camera.onnx_writer import FLOAT, FLOAT16, Port, constant_network

ModelMaker = Callable[..., Path]


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

    def build(
        output: np.ndarray,
        names: str | None = "{0: 'person', 1: 'car'}",
        shape: tuple[int | str, ...] = (1, 3, 64, 96),
        kind: int = FLOAT,
        **options: Any,
    ) -> Path:
        """``declared``: the output's shape as the file says it; ``outputs``: how many; others: metadata."""
        count, declared = options.pop("outputs", 1), options.pop("declared", output.shape)
        metadata = {**options, **({} if names is None else {"names": names})}
        values = output.astype(np.float16 if kind == FLOAT16 else np.float32)
        path = tmp_path / "network.onnx"
        network = constant_network(Port("images", kind, shape), [values] * count, metadata, [declared] * count)
        path.write_bytes(network)
        return path

    return build
