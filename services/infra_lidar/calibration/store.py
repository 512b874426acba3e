"""Calibration and background on disk, so that a restart begins where the last run ended."""

from __future__ import annotations

import json
import logging
import zipfile
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import TypeVar

import numpy as np

from common.geometry import is_rigid
from services.infra_lidar.calibration.plane_fit import Calibration
from services.infra_lidar.segmentation.background import BackgroundModel
from services.infra_lidar.segmentation.background_kernels import BLOCK

log = logging.getLogger(__name__)

T = TypeVar("T")
NO_LONGER_KEPT = ("residual_m", "road_points")  # stand in the files of earlier versions


class Store:
    """A folder with ``calibration.json`` (readable) and ``background.npz``; with an empty name nothing is kept."""

    def __init__(self, folder: str) -> None:
        self._folder = Path(folder).expanduser() if folder else None
        self._saved_calibration: Calibration | None = None
        self._saved_background: BackgroundModel | None = None
        self._fault = ""

    def load(self) -> tuple[Calibration | None, BackgroundModel | None]:
        """What is there; a damaged file is reported in the log and treated as missing."""
        if self._folder is None:
            return None, None
        self._saved_calibration = self._read("calibration.json", read_calibration)
        self._saved_background = self._read("background.npz", read_background)
        return self._saved_calibration, self._saved_background

    def keep(self, calibration: Calibration | None, background: BackgroundModel | None) -> None:
        """Write what is final since the last call; None = not final yet.

        A full or read-only disk does not stop the service: the log says so once, and the next start learns anew.
        """
        try:
            self._keep(calibration, background)
        except OSError as error:
            fault = f"{self._folder}: {error.strerror or error}; not kept, the next start learns anew"
            if self._folder is not None:
                for part in self._folder.glob("*.tmp*"):
                    part.unlink(missing_ok=True)
            if fault != self._fault:
                log.error(fault)
            self._fault = fault

    def _keep(self, calibration: Calibration | None, background: BackgroundModel | None) -> None:
        if self._folder is None:
            return
        if calibration is not None and calibration is not self._saved_calibration:
            self._saved_calibration = calibration
            self._write("calibration.json", calibration_text(calibration).encode())
        if background is not None and background is not self._saved_background:
            self._saved_background = background
            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._folder / "background.tmp.npz"
            np.savez(path, **{f.name: getattr(background, f.name) for f in fields(background)})
            path.replace(self._folder / "background.npz")

    def _read(self, name: str, read: Callable[[Path], T]) -> T | None:
        assert self._folder is not None
        path = self._folder / name
        if not path.exists():
            return None
        try:
            return read(path)
        except (ValueError, KeyError, TypeError, OSError, EOFError, zipfile.BadZipFile) as error:
            log.warning("%s is damaged, or of another version, and is made anew: %s", path, error)
            return None

    def _write(self, name: str, data: bytes) -> None:
        assert self._folder is not None
        self._folder.mkdir(parents=True, exist_ok=True)
        part = self._folder / f"{name}.tmp"
        part.write_bytes(data)
        part.replace(self._folder / name)  # never half a file


def calibration_text(calibration: Calibration) -> str:
    """The calibration as JSON for people and for ``read_calibration``."""
    document = asdict(calibration)
    document["T_level_sensor"] = calibration.T_level_sensor.tolist()
    return json.dumps(document, indent=2)


def read_calibration(path: Path) -> Calibration:
    """Raises ``ValueError``, ``KeyError`` or ``TypeError`` when it is no calibration."""
    document = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(document, dict):
        raise ValueError(f"expected a JSON object, found {type(document).__name__}")
    T = np.array(document.pop("T_level_sensor"), float)
    if not is_rigid(T, 1e-6):
        raise ValueError("T_level_sensor is no rigid transform")
    for name in NO_LONGER_KEPT:
        document.pop(name, None)
    if document.get("baseline") is not None:
        document["baseline"] = tuple(float(value) for value in document["baseline"])
    return Calibration(T_level_sensor=T, **document)


def read_background(path: Path) -> BackgroundModel:
    """Raises ``ValueError`` or ``KeyError`` when it is no background model."""
    with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        arrays = {f.name: file[f.name] for f in fields(BackgroundModel)}
    model = BackgroundModel(**{name: array if array.ndim else array.item() for name, array in arrays.items()})
    cells = model.columns * model.rows
    for name, shape, kind in (("intervals", (cells // BLOCK, 4, BLOCK), np.uint16), ("is_road", (cells,), np.bool_)):
        found = getattr(model, name)
        if found.shape != shape or found.dtype != kind:
            raise ValueError(f"{name}: expected {np.dtype(kind)} {shape}, found {found.dtype} {found.shape}")
    return model
