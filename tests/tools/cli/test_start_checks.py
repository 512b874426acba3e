"""`demo` and `up` look at configurations and ports before the first process starts."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from typer.testing import CliRunner

from common.host.process_plan import Plan
from common.topics import OPTIONAL_SERVICES, SERVICES, SERVICES_OF_ANY_HOST
from spotter_tools.cli.__main__ import app
from spotter_tools.configurations import check_configurations, config_type, start_lines

runner = CliRunner()
ROWS = (*SERVICES, *OPTIONAL_SERVICES, *SERVICES_OF_ANY_HOST)


@pytest.fixture
def taken_port() -> Iterator[int]:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]


@pytest.fixture(autouse=True)
def no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is refused here must be refused before a supervisor exists."""

    def refuse(*_: object) -> None:
        raise AssertionError("a process would have started")

    for module in ("demo", "up"):
        monkeypatch.setattr(import_module(f"spotter_tools.cli.{module}"), "Supervisor", refuse)


def test_every_service_has_its_configuration_class() -> None:
    classes = [config_type(row.name) for row in ROWS]
    assert len(set(classes)) == len(ROWS)
    assert all(config() for config in classes)


@pytest.mark.parametrize("command", [["demo"], ["up", "jetson0"]])
def test_one_wrong_key_starts_nothing(command: list[str]) -> None:
    refused = runner.invoke(app, [*command, "--set", "lidar.zones.spilt=3"])
    assert refused.exit_code == 2
    assert refused.output.startswith("spotter: lidar: --set: [zones] spilt = 3: no such key; allowed: ")


def test_a_wrong_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "radar.toml").write_text("[cfar]\nthreshold_db = 'high'\n")
    refused = runner.invoke(app, ["up", "pi0", "--config-dir", str(tmp_path)])
    assert refused.exit_code == 2
    assert f"radar: {tmp_path / 'radar.toml'}: [cfar] threshold_db = 'high'" in refused.output


def test_a_demo_does_not_join_a_router_that_is_there(taken_port: int) -> None:
    refused = runner.invoke(app, ["demo", "--listen", f"tcp/127.0.0.1:{taken_port}"])
    assert refused.exit_code == 2
    assert f"tcp/127.0.0.1:{taken_port}: the port is taken" in refused.output


def test_a_demo_does_not_start_without_its_page(taken_port: int) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        router = free.getsockname()[1]
    refused = runner.invoke(app, ["demo", "--listen", f"tcp/127.0.0.1:{router}", "--port", str(taken_port)])
    assert refused.exit_code == 2
    assert f"tcp/127.0.0.1:{taken_port}: the port is taken; another page" in refused.output


def test_what_runs_from_where_is_one_line_a_service() -> None:
    plan = Plan(sources={"lidar": "serial:/dev/ttyUSB0"})
    lines = start_lines(check_configurations([row for row in SERVICES if row.host == "jetson0"], plan))
    assert lines[0] == (
        "lidar      source serial:/dev/ttyUSB0, publishes spotter/jetson0/lidar/* on tcp/127.0.0.1:7447"
    )
    assert lines[-1] == "dashboard  publishes spotter/jetson0/dashboard/* on tcp/127.0.0.1:7447"
