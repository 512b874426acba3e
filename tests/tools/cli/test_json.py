"""Programs can use every command: what ends by itself prints JSON when asked to."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from spotter_tools.cli.__main__ import app

runner = CliRunner()
# They serve until Ctrl-C and print one line that says where; a router prints its configuration as JSON with --show.
SERVERS = {"up", "router", "metrics", "foxglove", "ros2", "cpm"}


def commands(group: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Every command with its full name."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*above, name))
        else:
            yield " ".join((*above, name)), command


def all_commands() -> dict[str, Any]:
    return dict(commands(typer.main.get_command(app)))


@pytest.mark.parametrize("name", sorted(set(all_commands()) - SERVERS))
def test_every_command_that_ends_by_itself_has_json(name: str) -> None:
    options = {option for parameter in all_commands()[name].params for option in parameter.opts}
    assert "--json" in options


def test_the_servers_are_all_there_is_besides() -> None:
    assert set(all_commands()) > SERVERS


def test_a_plot_and_a_replay_that_cannot_be_say_so_in_words(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "story.png"
    made = runner.invoke(app, ["plot", str(recording), str(out), "--json"])
    assert json.loads(made.stdout) == {"file": str(out)}
    assert out.stat().st_size > 1000
    refused = runner.invoke(app, ["replay", str(recording), "--service", "lidar"])
    assert refused.exit_code == 2
    assert "--verify" in refused.output
    nothing = runner.invoke(app, ["replay", "--verify", str(recording), "--json"])
    assert nothing.exit_code == 1
    assert json.loads(nothing.stdout)["decided_again"] == 0
