"""Nothing is started on data that nobody asked for: a source has to be there, and live in a live site."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from common.config import ConfigError, ServiceConfig, ZenohConfig
from common.host.process_plan import plan_of
from common.host.site import Site, load_site
from common.source_url import source_kind
from common.topics import RAW_TOPICS
from spotter_tools.cli.__main__ import app
from spotter_tools.configurations import check_configurations, config_type
from spotter_tools.sources import EXAMPLES, MEASURES, refuse_made_up, refuse_without_source

runner = CliRunner()
SITE = """
{top}
[tls]
enabled = false
[hosts.pi0]
local_port = {port}
port = {other}
[hosts.pi0.services.radar]
source = "{source}"
"""


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the processes that a supervisor would have started."""
    names: list[str] = []

    def note(children: list[Any]) -> object:
        names.extend(child.name for child in children)
        return object()

    up = import_module("spotter_tools.cli.up")
    monkeypatch.setattr(up, "Supervisor", note)
    monkeypatch.setattr(up, "run_supervised", lambda _: 0)
    return names


def written(folder: Path, free: Callable[[], int], source: str, top: str = "") -> Path:
    path = folder / "site.toml"
    path.write_text(SITE.format(top=top, source=source, port=free(), other=free()))
    return path


@pytest.mark.parametrize("service", [*(topic.service for topic in RAW_TOPICS), "ego"])
def test_no_sensor_has_a_source_by_default(service: str) -> None:
    assert service in MEASURES
    assert source_kind(EXAMPLES[service]) == "live"
    assert config_type(service)().source == ""


@pytest.mark.parametrize(("host", "without"), [("pi0", ["radar"]), ("jetson0", ["lidar", "camera"])])
def test_up_without_a_source_starts_nothing_and_gives_the_lines_to_write(
    started: list[str], host: str, without: list[str]
) -> None:
    refused = runner.invoke(app, ["up", host])
    assert (refused.exit_code, started) == (2, [])
    assert refused.output.startswith(f"spotter: {host}: no source for {', '.join(without)}: nothing would be measured")
    lines = tomllib.loads("\n".join(re.findall(r"^  (.*)$", refused.output, re.MULTILINE)))
    assert list(lines["hosts"][host]["services"]) == without
    assert "--simulated" in refused.output


@pytest.mark.parametrize("host", ["pi0", "jetson0"])
def test_the_lines_that_it_gives_are_accepted(tmp_path: Path, host: str) -> None:
    refused = runner.invoke(app, ["up", host])
    path = tmp_path / "site.toml"
    path.write_text("\n".join(re.findall(r"^  (.*)$", refused.output, re.MULTILINE)))
    site = load_site(path)
    configurations = check_configurations(site.rows(host), plan_of(site, host, path))
    refuse_without_source(host, configurations)
    refuse_made_up(site, host, configurations)


@pytest.mark.parametrize("words", [["--simulated"], ["--sim", "empty"]])
def test_a_simulated_world_is_there_when_it_is_asked_for_and_named(
    started: list[str], words: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    result = runner.invoke(app, ["up", "pi0", *words])
    assert (result.exit_code, started) == (0, ["router", "radar"])
    assert "(SIMULATED)" in result.output


@pytest.mark.parametrize("source", ["sim:crossing", "file:drive.radar", "mcap:drive.mcap", "spi:emulator"])
def test_a_live_site_refuses_what_is_not_live(
    tmp_path: Path, free_ports: Callable[[], int], started: list[str], source: str
) -> None:
    path = written(tmp_path, free_ports, source)
    refused = runner.invoke(app, ["up", "pi0", "--site", str(path)])
    assert (refused.exit_code, started) == (2, [])
    assert f"[hosts.pi0.services.radar] source = '{source}'" in refused.output
    assert "accept_simulated = true" in refused.output


@pytest.mark.parametrize("words", [["--simulated"], ["--sim", "empty"], ["--set", "radar.source=sim:crossing"]])
def test_a_live_site_is_not_simulated_from_the_command_line_either(
    tmp_path: Path, free_ports: Callable[[], int], started: list[str], words: list[str]
) -> None:
    refused = runner.invoke(app, ["up", "pi0", "--site", str(written(tmp_path, free_ports, "")), *words])
    assert (refused.exit_code, started) == (2, [])


def test_a_site_for_trials_takes_everything(tmp_path: Path, free_ports: Callable[[], int], started: list[str]) -> None:
    path = written(tmp_path, free_ports, "sim:crossing", "accept_simulated = true")
    assert runner.invoke(app, ["up", "pi0", "--site", str(path)]).exit_code == 0
    assert started == ["router", "radar"]


def test_a_live_source_is_taken(tmp_path: Path, free_ports: Callable[[], int], started: list[str]) -> None:
    assert runner.invoke(app, ["up", "pi0", "--site", str(written(tmp_path, free_ports, "spi:0.0"))]).exit_code == 0
    assert started == ["router", "radar"]


def test_a_scheme_that_nobody_knows_is_not_live() -> None:
    config = ServiceConfig(host="pi0", source="rtsp://camera", zenoh=ZenohConfig())
    with pytest.raises(ConfigError, match="unknown, and this site is live"):
        refuse_made_up(Site(), "pi0", {"radar": config})


@pytest.mark.parametrize(("top", "live_only"), [("", "true"), ("accept_simulated = true", "false")])
def test_fusion_is_told_what_its_site_accepts(tmp_path: Path, top: str, live_only: str) -> None:
    path = tmp_path / "site.toml"
    path.write_text(f"{top}\n[hosts.jetson0.services.fusion]\n")
    assert f"vehicle.live_only={live_only}" in plan_of(load_site(path), "jetson0", path).settings["fusion"]
