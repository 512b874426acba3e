"""A recorded result that cannot be read is told in a line, not in a traceback."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from common import topics
from common.codec import encode
from common.messages import LidarZones, RawBytes
from common.recording.file import RecordingFile
from spotter_tools.cli.__main__ import app


def test_a_damaged_result_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    piece = RawBytes(stamp_ns=1, kind="ld06", index=0, data=np.zeros(4, np.uint8))
    with RecordingFile(path, {}) as file:
        file.add(topics.LIDAR_RAW.key("car"), RawBytes, encode(piece), 1, 0, 0)
        file.add(topics.LIDAR_ZONES.key("car"), LidarZones, b"\xc1", 2, 0, 0)
    result = CliRunner().invoke(app, ["replay", str(path), "--verify", "--service", "lidar"])
    assert result.exit_code == 1
    assert "lidar/zones" in result.stderr
    assert result.stderr.count("\n") == 1
