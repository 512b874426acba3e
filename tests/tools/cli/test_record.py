"""`spotter record`: what cannot be recorded is said before anything is opened."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from common.config import load, public
from services.jetson.dashboard.config import DashboardConfig
from spotter_tools.cli.__main__ import app

runner = CliRunner()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--raw", "lidar,sonar"], "--raw sonar: no raw bytes of that; known: radar, lidar, camera, infra_lidar"),
        (["--only", "fusion/opinion"], "--only fusion/opinion: no such product; known: "),
    ],
)
def test_what_is_not_there_is_refused_with_what_there_is(tmp_path: Path, arguments: list[str], complaint: str) -> None:
    result = runner.invoke(app, ["record", str(tmp_path / "drive"), *arguments])
    assert result.exit_code == 2
    assert complaint in result.output
    assert not (tmp_path / "drive").exists()


def test_a_configuration_in_a_recording_has_no_secrets() -> None:
    config = load(DashboardConfig, None, ["server.token=open-sesame"])
    told = public(config)
    assert "open-sesame" not in str(told)
    assert told["server"]["port"] == config.server.port
    assert "zenoh" not in told
