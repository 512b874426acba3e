"""What a blackbox answers: its incidents, their capsules, and requests to save one now."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zenoh
from typer.testing import CliRunner

from common.bus.runtime import Service
from common.bus.session import open_session
from common.config import ServiceConfig, ZenohConfig
from common.recording.reader import read_metadata
from services.blackbox.capsule import incidents, write_capsule
from services.blackbox.server import CapsuleServer
from services.blackbox.trigger import Incident
from spotter_tools.cli.__main__ import app

T0 = 1_795_000_000_000_000_000


@pytest.fixture
def served(zenoh_config: ZenohConfig, tmp_path: Path) -> Any:
    write_capsule(tmp_path, "pi0", Incident("20261119T010000.000Z-imminent", T0, "x"), [], {})
    (tmp_path / "secret.txt").write_text("no")
    with Service("blackbox", ServiceConfig(host="pi0", zenoh=zenoh_config)) as service:
        server = CapsuleServer(service, tmp_path)
        with open_session(zenoh_config) as laptop:
            yield laptop, server, tmp_path


def ask(session: zenoh.Session, key: str, **parameters: str) -> list[bytes]:
    replies = session.get(zenoh.Selector(key, zenoh.Parameters(parameters)), timeout=5)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def test_capsules_are_given_whole(served: Any) -> None:
    laptop, _, folder = served
    assert json.loads(ask(laptop, "*/blackbox/incidents")[0]) == ["20261119T010000.000Z-imminent"]
    (data,) = ask(laptop, "pi0/blackbox/capsule", name="20261119T010000.000Z-imminent", part="0")
    assert data == (folder / "20261119T010000.000Z-imminent" / "pi0.mcap").read_bytes()


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("../secret.txt", "0"),
        ("..", "0"),
        ("20261119T010000.000Z-imminent/../..", "0"),
        ("", "0"),
        ("20261119T010000.000Z-imminent", "-1"),
        ("20261119T010000.000Z-imminent", "x"),
        ("20990101T000000.000Z-none", "0"),
    ],
)
def test_nothing_else_is_given(served: Any, name: str, part: str) -> None:
    laptop, _, _ = served
    assert ask(laptop, "pi0/blackbox/capsule", name=name, part=part) == []


def test_saving_again_names_the_open_incident_and_keeps_the_words(
    zenoh_config: ZenohConfig, tmp_path: Path, spawn: Callable[..., Any], until: Callable[..., None]
) -> None:
    connect = f'zenoh.connect=["{zenoh_config.connect[0]}"]'
    spawn(
        "spotter-blackbox", "--set", "host=pi0", "--set", connect, "--set", f"folder={tmp_path}", "--set", "after_s=3.0"
    )
    with open_session(zenoh_config) as laptop:
        until(lambda: ask(laptop, "*/blackbox/incidents"), budget_s=40)
        answers = [
            json.loads(ask(laptop, "*/blackbox/save", why=why, at_ns=str(T0 + n))[0])
            for n, why in enumerate(("near miss at the gate", "he waved", "and left"))
        ]
        until(lambda: incidents(tmp_path), budget_s=20)
    (name,) = incidents(tmp_path)
    assert answers == [{"incident": name, "new": True}] + [{"incident": name, "new": False}] * 2
    kept = read_metadata(tmp_path / name / "pi0.mcap")["incident"]
    assert kept["why"] == "near miss at the gate; he waved; and left"
    assert kept["at_ns"] == str(T0)


def test_no_incident_and_no_blackbox_are_told_apart(served: Any, zenoh_config: ZenohConfig) -> None:
    _, _, folder = served
    shutil.rmtree(folder / "20261119T010000.000Z-imminent")
    words = ["incident", "list", "--connect", zenoh_config.connect[0]]
    assert CliRunner().invoke(app, words).output == "no incidents yet; the blackbox answers on pi0\n"


def test_without_a_blackbox_the_list_says_so(router_endpoint: str) -> None:
    listed = CliRunner().invoke(app, ["incident", "list", "--connect", router_endpoint])
    assert listed.exit_code == 1
    assert listed.output == "spotter: no blackbox answers; is spotter-blackbox running on the hosts?\n"


def test_a_disk_that_takes_no_merged_incident_is_one_sentence_and_keeps_nothing_of_it(
    served: Any, zenoh_config: ZenohConfig, tmp_path: Path, file_size_limit: Callable[[int], Any]
) -> None:
    name, out = "20261119T010000.000Z-imminent", tmp_path / "out" / "merged.mcap"
    words = ["incident", "open", name, "--fusion-host", "pi0", "--out", str(out)]
    words += ["--connect", zenoh_config.connect[0], "--namespace", "spotter"]
    capsule_bytes = (tmp_path / name / "pi0.mcap").stat().st_size  # the merged file says more and is longer
    for room in (10, capsule_bytes):
        with file_size_limit(room):
            result = CliRunner().invoke(app, words)
        assert result.exit_code == 1, result.output
        assert f"File too large; {name} was not opened and nothing of it is left here" in result.output
        assert list(out.parent.iterdir()) == []
    assert CliRunner().invoke(app, words).exit_code == 0


def test_a_capsule_that_came_damaged_is_one_sentence(served: Any, zenoh_config: ZenohConfig, tmp_path: Path) -> None:
    name = "20261119T010000.000Z-imminent"
    (tmp_path / name / "pi0.mcap").write_bytes(b"not a recording at all")
    words = ["incident", "open", name, "--out", str(tmp_path / "merged.mcap")]
    result = CliRunner().invoke(app, [*words, "--connect", zenoh_config.connect[0], "--namespace", "spotter"])
    assert (result.exit_code, result.output) == (
        1,
        "spotter: the capsules cannot be merged: pi0.mcap: not an MCAP file\n",
    )
