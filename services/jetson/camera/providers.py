"""What ONNX Runtime shall run the network on, and where TensorRT keeps what it builds."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from services.jetson.camera.config import DetectorConfig

log = logging.getLogger(__name__)


def choose_providers(config: DetectorConfig, available: list[str]) -> list[tuple[str, dict[str, object]]]:
    """What onnxruntime shall try, in the order of the configuration, with options; the CPU if nothing else is there."""
    chosen = [name for name in config.providers if name in available] or ["CPUExecutionProvider"]
    return [(name, tensorrt_options(config) if name.startswith("Tensorrt") else {}) for name in chosen]


def tensorrt_options(config: DetectorConfig) -> dict[str, object]:
    """Where TensorRT keeps the engines that it builds for minutes; none where that folder cannot be written."""
    folder = engine_folder(config.tensorrt_cache)
    if folder is None:
        return {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK | os.X_OK)
    except OSError:
        writable = False
    if not writable:
        log.warning("[detector] tensorrt_cache: %s cannot be written; the engine is built at every start", folder)
        return {}
    return {"trt_engine_cache_enable": True, "trt_engine_cache_path": str(folder)}


def engine_folder(setting: str) -> Path | None:
    """``auto``: below the cache of the unit (systemd names it), else of the user. Empty = no folder."""
    if not setting:
        return None
    if setting != "auto":
        return Path(setting).expanduser()
    unit, user = os.environ.get("CACHE_DIRECTORY"), os.environ.get("XDG_CACHE_HOME")
    return Path(unit) / "tensorrt" if unit else Path(user or "~/.cache").expanduser() / "spotter" / "tensorrt"
