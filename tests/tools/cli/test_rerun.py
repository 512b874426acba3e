"""Rerun: every kind of message becomes something it can show, from a recording and from the live bus."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from typer.testing import CliRunner

from common import messages as m
from spotter_tools.cli.__main__ import app

runner = CliRunner()
HERE = importlib.util.find_spec("rerun") is not None
needs_rerun = pytest.mark.skipif(not HERE, reason="the extra `rerun` is not installed; it is in none of `make setup`'s")


def entities(path: Path) -> str:
    """What Rerun's own tool finds in a file, after it has found it sound."""
    tool = [sys.executable, "-W", "ignore", "-m", "rerun", "rrd"]
    subprocess.run([*tool, "verify", str(path)], check=True, capture_output=True)
    return subprocess.run([*tool, "print", str(path)], check=True, capture_output=True, text=True).stdout


@pytest.mark.skipif(HERE, reason="the extra `rerun` is installed")
def test_without_the_extra_it_is_said(recording: Path, tmp_path: Path) -> None:
    result = runner.invoke(app, ["rerun", str(recording), "--save", str(tmp_path / "out.rrd")])
    assert result.exit_code == 1
    assert "needs the extra `rerun`" in result.output


@needs_rerun
def test_a_recording_becomes_a_file_that_rerun_opens(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.rrd"
    result = runner.invoke(app, ["rerun", str(recording), "--save", str(out), "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout) == {"file": str(out), "logged": 360, "undecodable": 0}
    found = entities(out)
    for entity in (
        "/verdict/level",
        "/verdict/log",
        "/health/state/lidar",
        "/map/objects",
        "/map/vehicle/radar/tracks",
    ):
        assert entity in found
    assert "/camera/detections" in found


@needs_rerun
@pytest.mark.system
def test_the_live_bus_becomes_a_file(speaking: str, tmp_path: Path) -> None:
    out = tmp_path / "live.rrd"
    result = runner.invoke(app, ["rerun", "--save", str(out), "--seconds", "1.5", "--connect", speaking, "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["logged"] > 20
    assert "/verdict/level" in entities(out)


@needs_rerun
def test_every_kind_of_message_is_shown(speakers: ModuleType) -> None:
    from common.recording.rerun_scene import entries

    t = 1_700_000_000_000_000_000
    T = np.eye(4).tolist()
    some = np.array([0.5, 1.0], np.float32)
    one_byte = np.zeros(2, np.uint8)
    shown: dict[str, tuple[m.Message, set[str]]] = {
        "jetson0/lidar/scan": (
            m.LaserScan(stamp_ns=t, angles_rad=some, ranges_m=some, confidence=one_byte),
            {"map/vehicle/lidar/scan"},
        ),
        "infra0/infra_lidar/points": (
            m.PointCloud(stamp_ns=t, points=np.zeros((2, 3), np.float32), intensity=one_byte, kind=one_byte),
            {"map/cloud"},
        ),
        "jetson0/camera/image": (m.CompressedImage(stamp_ns=t, format="jpeg", data=b"\xff\xd8"), {"camera/image"}),
        "jetson0/ego/motion": (
            m.EgoMotion(stamp_ns=t, speed_mps=1.0, yaw_rate_radps=0.0, T_map_vehicle=T),
            {"map/vehicle"},
        ),
        "pi0/radar/tracks": (
            m.RadarTracks(stamp_ns=t, tracks=[], level="SAFE", settled=True, noise_floor_db=-60.0),
            {"map/vehicle/radar/tracks", "map/vehicle/radar/velocity"},
        ),
        "infra0/infra_lidar/tracks": (speakers.objects(t), {"map/objects", "map/objects/velocity"}),
        "jetson0/fusion/health": (speakers.health(t), {"health/log", "health/state/lidar"}),
        "jetson0/fusion/verdict": (speakers.verdict(t), {"verdict/level", "verdict/log", "verdict/age_ms/lidar"}),
    }
    for key, (message, expected) in shown.items():
        assert {path for path, _ in entries(key, message)} == expected, key


@needs_rerun
def test_a_sentence_is_logged_when_it_changes(speakers: ModuleType) -> None:
    from common.codec import encode
    from common.recording.rerun_scene import RerunLog

    logged: list[str] = []

    class Stream:
        def log(self, path: str, archetype: object, static: bool = False) -> None:
            logged.append(path)

        def set_time(self, timeline: str, timestamp: object) -> None:
            assert timeline == "stamp"

    log = RerunLog(Stream())
    say: Callable[[str], None] = lambda level: log.add("a/fusion/verdict", encode(speakers.verdict(10**18, level)))  # noqa: E731
    for level in ("SAFE", "SAFE", "CAUTION", "SAFE"):
        say(level)
    log.add("a/fusion/verdict", b"\xc1")
    assert logged.count("verdict/level") == 4
    assert logged.count("verdict/log") == 3
    assert log.undecodable == 1


@pytest.mark.parametrize(("arguments", "error_text"), [(["none.mcap"], "no such file"), (["--save", "it"], "already")])
@needs_rerun
def test_what_cannot_be_done_is_said(
    tmp_path: Path, arguments: list[str], error_text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "it").write_text("precious")
    result = runner.invoke(app, ["rerun", *arguments])
    assert result.exit_code == 2
    assert error_text in result.output
