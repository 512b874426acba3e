"""What the network runs on, and where TensorRT's engines are kept."""

from __future__ import annotations

from pathlib import Path

import pytest

from services.jetson.camera.config import DetectorConfig
from services.jetson.camera.providers import choose_providers, engine_folder

TENSORRT, CUDA, CPU = "TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"


@pytest.mark.parametrize(
    ("available", "chosen"),
    [
        ([CPU], [CPU]),
        ([CPU, CUDA, TENSORRT], [TENSORRT, CUDA, CPU]),  # our order, not the library's
        (["AzureExecutionProvider", CPU, CUDA], [CUDA, CPU]),
        (["AzureExecutionProvider"], [CPU]),
    ],
)
def test_providers_are_tried_in_order(available: list[str], chosen: list[str]) -> None:
    assert [name for name, _ in choose_providers(DetectorConfig(), available)] == chosen


def test_tensorrt_keeps_its_engines_by_itself(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Below the cache of the unit or the container; without one below the user's."""
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path))
    (name, options), *_ = choose_providers(DetectorConfig(), [TENSORRT, CPU])
    assert (name, options["trt_engine_cache_path"]) == (TENSORRT, str(tmp_path / "tensorrt"))
    assert (tmp_path / "tensorrt").is_dir()
    monkeypatch.delenv("CACHE_DIRECTORY")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert engine_folder("auto") == tmp_path / "spotter" / "tensorrt"
    assert choose_providers(DetectorConfig(tensorrt_cache=""), [TENSORRT])[0] == (TENSORRT, {})


def test_a_folder_that_cannot_be_written_is_said_and_not_needed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    config = DetectorConfig(tensorrt_cache=str(tmp_path / "file" / "engines"))
    assert choose_providers(config, [TENSORRT, CPU])[0] == (TENSORRT, {})
    assert "cannot be written; the engine is built at every start" in caplog.text
