"""`--version`, `info`, and colour where somebody looks."""

from __future__ import annotations

import importlib.metadata
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from spotter_tools.cli import render
from spotter_tools.cli.__main__ import app

runner = CliRunner()


def test_the_version_is_the_distribution_s() -> None:
    assert runner.invoke(app, ["--version"]).output == f"spotter {importlib.metadata.version('spotter')}\n"


def test_info_says_what_a_service_is(speaking: str) -> None:
    shown = runner.invoke(app, ["info", "lidar", "--connect", speaking, "--json"])
    row = json.loads(shown.stdout)
    assert row["key"] == "jetson0/lidar/info"
    assert row["message"]["version"] == importlib.metadata.version("spotter")


def test_info_of_nobody(speaking: str) -> None:
    shown = runner.invoke(app, ["info", "pi0/lidar", "--connect", speaking])
    assert (shown.exit_code, shown.output) == (
        1,
        "spotter: pi0/lidar does not answer; did you mean jetson0/lidar?\n",
    )


def test_a_command_that_looks_at_the_bus_keeps_its_colours(speaking: str) -> None:
    """At a real terminal: connecting once switched them off."""
    master, slave = os.openpty()
    environment = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "RUST_LOG")}
    command = [str(Path(sys.executable).with_name("spotter")), "ls", "--connect", speaking]
    subprocess.run(command, stdout=slave, env=environment, timeout=60, check=True)
    os.close(slave)
    shown = os.read(master, 4096).decode()
    os.close(master)
    assert "\x1b[32m" in shown, shown


@pytest.mark.parametrize(
    ("terminal", "no_colour", "marked"), [(True, False, True), (True, True, False), (False, False, False)]
)
def test_colour_on_a_terminal_only(
    monkeypatch: pytest.MonkeyPatch, terminal: bool, no_colour: bool, marked: bool
) -> None:
    monkeypatch.setattr(render.sys.stdout, "isatty", lambda: terminal, raising=False)
    monkeypatch.delenv("NO_COLOR", raising=False)
    if no_colour:
        monkeypatch.setenv("NO_COLOR", "1")
    word = render.coloured("IMMINENT", 10)
    assert ("\033[" in word) is marked
    assert "IMMINENT  " in word
