"""Whether data is live is told wherever a person looks: `ls`, `health`, `top`, `info` of a recording."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest
from typer.testing import CliRunner

from common.bus.runtime import Service
from common.codec import encode
from common.config import ServiceConfig, ZenohConfig
from common.messages import Verdict
from common.recording.file import RecordingFile
from spotter_tools.cli.__main__ import app
from spotter_tools.cli.render import health_lines, origin_line, verdict_text

pytestmark = pytest.mark.patient

runner = CliRunner()


def test_ls_tells_a_simulated_sensor_from_a_live_one(zenoh_config: ZenohConfig) -> None:
    def config(host: str, source: str) -> ServiceConfig:
        return ServiceConfig(host=host, zenoh=zenoh_config, source=source)

    with (
        Service("radar", config("pi0", "sim:crossing")),
        Service("lidar", config("jetson0", "serial:/dev/ttyTHS1")),
        Service("fusion", config("jetson0", "")),
    ):
        lines = runner.invoke(app, ["ls", "--connect", zenoh_config.connect[0]]).stdout.splitlines()
        rows = runner.invoke(app, ["ls", "--connect", zenoh_config.connect[0], "--json"]).stdout.splitlines()
    assert [line.split()[3] for line in lines] == ["-", "live", "simulated"]
    assert {row["service"]: row["source_kind"] for row in map(json.loads, rows)}["radar"] == "simulated"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("live", ""),
        ("recorded", "NOT LIVE, RECORDED DATA: LiDAR recorded"),
        ("emulated", "NOT LIVE, EMULATED DEVICE: LiDAR emulated"),
        ("simulated", "NOT LIVE, SIMULATED DATA: LiDAR simulated"),
        ("unknown", "NOT LIVE, DATA OF UNKNOWN ORIGIN: LiDAR unknown"),
    ],
)
def test_a_verdict_that_is_not_live_has_a_line_above_it(speakers: ModuleType, kind: str, words: str) -> None:
    verdict = speakers.verdict(1)
    verdict.source_kind = verdict.inputs["lidar"].source_kind = kind
    assert origin_line(verdict) == words
    assert verdict_text(verdict, 0.0).startswith(words + "\nCAUTION" if words else "CAUTION")


def test_a_simulated_motion_is_named(speakers: ModuleType) -> None:
    verdict = speakers.verdict(1)
    verdict.source_kind, verdict.inputs["lidar"].source_kind = "simulated", "live"
    assert origin_line(verdict) == "NOT LIVE, SIMULATED DATA: the motion of the vehicle"


def test_while_no_sensor_has_spoken_nothing_is_said_of_them(speakers: ModuleType) -> None:
    verdict = speakers.verdict(1)
    verdict.inputs["lidar"].age_ms = None
    assert origin_line(verdict) == origin_line(None) == ""


def test_health_says_it_of_every_sensor(speakers: ModuleType) -> None:
    system = speakers.health(1)
    system.sensors["lidar"].source_kind = "recorded"
    assert any("LiDAR" in line and "recorded" in line for line in health_lines(system))


def test_info_of_a_recording_says_what_was_live(tmp_path: Path, speakers: ModuleType) -> None:
    path = tmp_path / "drive.mcap"
    origin = {"vehicle": "car1", "version": "1", "source": "sim:crossing", "source_kind": "simulated"}
    about = {**origin, "instance": "a", "config": "{}"}
    with RecordingFile(path, {"spotter": {"version": "1"}, "pi0/radar": about}) as file:
        for at_s in range(3):
            zones, radar = speakers.zones(at_s), speakers.radar(at_s)
            zones.source_kind, radar.source_kind = "live", "simulated" if at_s else "live"
            file.add("jetson0/lidar/zones", type(zones), encode(zones), 10**9 * (at_s + 1), 0, at_s)
            file.add("pi0/radar/tracks", type(radar), encode(radar), 10**9 * (at_s + 1), 0, at_s)
    found = json.loads(runner.invoke(app, ["info", str(path), "--json"]).stdout)
    assert found["messages"] == {"jetson0/lidar/zones": {"live": 3}, "pi0/radar/tracks": {"live": 1, "simulated": 2}}
    assert found["services"] == {"pi0/radar": origin}
    assert (found["duration_s"], found["complete"]) == (2.0, True)
    assert "simulated: 2" in runner.invoke(app, ["info", str(path)]).stdout


@pytest.mark.parametrize("set_by_s", [-3600, 86_400])
def test_length_and_picture_of_a_recording_in_which_the_clock_was_set(
    tmp_path: Path, speakers: ModuleType, set_by_s: int
) -> None:
    path, picture = tmp_path / "drive.mcap", str(tmp_path / "drive.png")
    with RecordingFile(path, {}) as file:
        for i in range(40):
            log_ns = 10**13 + i * 10**8 + (set_by_s * 10**9 if i >= 20 else 0)
            file.add("jetson0/fusion/verdict", Verdict, encode(speakers.verdict(log_ns)), log_ns, 0, i)
    assert json.loads(runner.invoke(app, ["info", str(path), "--json"]).stdout)["duration_s"] == 3.9
    assert runner.invoke(app, ["plot", str(path), picture, "--from", "3"]).exit_code == 0
    late = runner.invoke(app, ["plot", str(path), picture, "--from", "5"])
    assert late.output == f"spotter: {path} is 3.9 s long; --from 5 is past its end\n"


def test_info_of_a_recording_that_was_cut_off_says_so(tmp_path: Path, speakers: ModuleType) -> None:
    path, cut = tmp_path / "drive.mcap", tmp_path / "cut.mcap"
    with RecordingFile(path, {"spotter": {"version": "1"}}) as file:
        for at_s in range(2000):
            zones = speakers.zones(at_s)
            file.add("jetson0/lidar/zones", type(zones), encode(zones), 10**9 * (at_s + 1), 0, at_s)
    cut.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    shown = runner.invoke(app, ["info", str(cut), "--json"])
    assert shown.exit_code == 1
    assert "cut off" in shown.stderr
    found = json.loads(shown.stdout)
    assert not found["complete"]
    assert runner.invoke(app, ["info", str(path)]).exit_code == 0


def test_info_of_what_is_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    assert runner.invoke(app, ["info", str(path)]).exit_code == 2
    path.write_bytes(b"nothing of the kind")
    refused = runner.invoke(app, ["info", str(path)])
    assert (refused.exit_code, "not an MCAP file" in refused.output) == (1, True)
