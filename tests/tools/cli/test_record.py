"""`spotter record`: what cannot be recorded is said before anything is opened."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from common.bus.session import open_session
from common.codec import decode
from common.config import ZenohConfig, load, public
from common.messages import ServiceStatus
from services.jetson.dashboard.config import DashboardConfig
from spotter_tools.cli.__main__ import app

runner = CliRunner()


@pytest.mark.parametrize(
    ("arguments", "error_text"),
    [
        (["--raw", "lidar,sonar"], "--raw sonar: no raw bytes of that; known: radar, lidar, camera, infra_lidar"),
        (["--only", "fusion/opinion"], "--only fusion/opinion: no such product; known: "),
    ],
)
def test_what_is_not_there_is_refused_with_what_there_is(tmp_path: Path, arguments: list[str], error_text: str) -> None:
    result = runner.invoke(app, ["record", str(tmp_path / "drive"), *arguments])
    assert result.exit_code == 2
    assert error_text in result.output
    assert not (tmp_path / "drive").exists()


def test_a_configuration_in_a_recording_has_no_secrets() -> None:
    config = load(DashboardConfig, None, ["server.token=open-sesame"])
    redacted = public(config)
    assert "open-sesame" not in str(redacted)
    assert redacted["server"]["port"] == config.server.port
    assert "zenoh" not in redacted


def test_the_last_word_of_a_recorder_that_a_full_disk_ended_is_why(
    zenoh_config: ZenohConfig, tmp_path: Path, until: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # the command sets its own
    words = ["record", str(tmp_path), "--keep-free", "1000000", "--host", "laptop1"]
    with open_session(zenoh_config) as listener:
        statuses: list[ServiceStatus] = []
        listener.declare_subscriber(
            "laptop1/recorder/status", lambda one: statuses.append(decode(one.payload.to_bytes(), ServiceStatus))
        )
        result = runner.invoke(app, [*words, "--connect", zenoh_config.connect[0], "--namespace", "spotter"])
        until(lambda: statuses)
    assert (result.exit_code, "recording stopped, the files are complete" in result.output) == (1, True), result.output
    assert (statuses[-1].state, statuses[-1].reason) == ("degraded", result.output.strip().removeprefix("spotter: "))
