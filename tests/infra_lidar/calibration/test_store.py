"""Files of the state folder: what is no calibration is damaged, and is made anew."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from services.infra_lidar.calibration.plane_fit import Calibration
from services.infra_lidar.calibration.store import Store, calibration_text

LEVEL = Calibration(np.eye(4), height_m=4.0, tilt_deg=0.0, error_deg=0.1, frames=1)


def test_a_calibration_is_read_as_it_was_written(tmp_path: Path) -> None:
    Store(str(tmp_path)).keep(LEVEL, None)
    found, background = Store(str(tmp_path)).load()
    assert found is not None
    assert background is None
    assert calibration_text(found) == calibration_text(LEVEL)


def test_a_calibration_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    document = {**json.loads(calibration_text(LEVEL)), "residual_m": 0.01, "road_points": 900}
    (tmp_path / "calibration.json").write_text(json.dumps(document))
    found, _ = Store(str(tmp_path)).load()
    assert found is not None
    assert calibration_text(found) == calibration_text(LEVEL)


@pytest.mark.parametrize("text", ["", "{", "null", '"x"', "7", "[]", "[1]", "{}", '{"T_level_sensor": null}'])
def test_what_is_no_calibration_is_damaged(text: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "calibration.json").write_text(text)
    assert Store(str(tmp_path)).load() == (None, None)
    (line,) = caplog.messages
    assert line.startswith(f"{tmp_path}/calibration.json is damaged, or of another version, and is made anew: ")
