"""Doctor looks at the things themselves: the path that the service opens, what kind of thing it is, what it says."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from common.bus.runtime import Service
from common.config import ServiceConfig, ZenohConfig
from common.host.site import HostConfig, Site, TlsConfig
from common.host.supervisor import Child
from spotter_tools.cli.__main__ import app
from spotter_tools.doctor import devices
from spotter_tools.doctor.bus import alive_on
from spotter_tools.doctor.devices import check_device, check_model, check_tools, device_of
from spotter_tools.doctor.findings import Finding
from spotter_tools.doctor.services import check_look, check_outputs, check_services, check_source

NOBODY = 65534
Plug = Callable[..., Any]
Turning = Callable[[float], bytes]
SPOTTER = str(Path(sys.executable).with_name("spotter"))
LIVE, TRIALS = Site(), Site(accept_simulated=True)


def grades(found: Iterable[Finding]) -> dict[str, str]:
    listed = list(found)
    assert all(finding.do for finding in listed if finding.grade != "ok")
    return {finding.check: finding.grade for finding in listed}


def lidar(path: str) -> Child:
    return Child("lidar", [str(Path(sys.executable).with_name("spotter-lidar")), "--source", f"serial:{path}"])


@pytest.mark.parametrize(
    ("source", "path"),
    [
        ("serial:/dev/ttyTHS1", "/dev/ttyTHS1"),
        ("serial:///dev/ttyUSB0", "/dev/ttyUSB0"),
        ("v4l2:0", "/dev/video0"),
        ("v4l2:/dev/video0", "/dev/video0"),  # was looked for at /dev/video/dev/video0
        ("v4l2:/dev/v4l/by-id/usb-x-video-index0", "/dev/v4l/by-id/usb-x-video-index0"),
        ("spi:0.0", "/dev/spidev0.0"),
        ("spi:emulator", None),
        ("csi:0", None),
        ("ouster://10.0.0.9", None),
        ("", None),
    ],
)
def test_the_path_is_the_one_that_the_service_opens(source: str, path: str | None) -> None:
    assert device_of(source) == (Path(path) if path else None)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("serial:/dev/nothing-here", "is not there"),
        ("serial:/dev/null", "is no serial port"),
        ("serial:/dev/zero", "is no serial port"),
        ("serial:/etc/passwd", "is no serial port"),
        ("v4l2:/etc/passwd", "is no device"),
        ("v4l2:99", "/dev/video99 is not there"),
        ("spi:9.9", "/dev/spidev9.9 is not there"),
    ],
)
def test_what_is_no_device_is_broken(source: str, words: str) -> None:
    (finding,) = check_device("lidar", source)
    assert (finding.grade, words in finding.what) == ("broken", True)


def test_a_serial_port_is_one(plug: Plug) -> None:
    assert grades(check_device("lidar", f"serial:{plug().path}")) == {"lidar device": "ok"}


def test_what_the_gate_acts_on(plug: Plug) -> None:
    assert grades(check_outputs([])) == {"gate outputs": "warning"}
    assert grades(check_outputs([f"serial:{plug().path}", "sim:"])) == {"gate device": "ok"}
    (finding,) = check_outputs(["serial:/dev/ttyACM99?baud=115200"])
    assert (finding.grade, "/dev/ttyACM99 is not there" in finding.what) == ("broken", True)


def test_a_csi_camera_without_its_daemon(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(devices, "ARGUS_SOCKET", tmp_path / "argus_socket")
    assert grades(check_device("camera", "csi:0")) == {"camera device": "broken"}
    (tmp_path / "argus_socket").touch()
    assert grades(check_device("camera", "csi:0")) == {}
    assert grades(check_device("camera", "csi:0", ("our-capture",))) == {}


@pytest.mark.parametrize(
    ("source", "missing"),
    [("spi:0.0", "gpiod"), ("spi:0.0", "spidev"), ("serial:/dev/ttyS0", "serial")],
)
def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch, source: str, missing: str) -> None:
    monkeypatch.setattr(devices.importlib.util, "find_spec", lambda name: None if name == missing else object())
    (finding,) = check_tools("radar", source)
    assert (finding.grade, finding.what) == ("broken", f"{missing} is not installed")


def test_the_capture_program_is_the_one_that_will_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices.shutil, "which", lambda program: None)
    assert [one.what for one in check_tools("camera", "v4l2:0")] == ["gst-launch-1.0 is not installed"]
    assert [one.what for one in check_tools("camera", "v4l2:0", ("ours",))] == ["ours is not installed"]
    assert list(check_tools("radar", "spi:emulator")) == []


def test_a_missing_model_is_named(tmp_path: Path) -> None:
    assert [one.grade for one in check_model("camera", "/nonexistent/yolov8n.onnx")] == ["broken"]
    (tmp_path / "n.onnx").touch()
    assert list(check_model("camera", str(tmp_path / "n.onnx"))) == list(check_model("camera", "")) == []


@pytest.mark.parametrize(
    ("source", "live", "trials"),
    [
        ("", "broken", "broken"),
        ("serial:/dev/ttyTHS1", "ok", "ok"),
        ("sim:crossing", "broken", "warning"),
        ("file:x.radar", "broken", "warning"),
        ("spi:emulator", "broken", "warning"),
    ],
)
def test_a_source_has_to_be_there_and_live_in_a_live_site(source: str, live: str, trials: str) -> None:
    assert [check_source("lidar", source, site).grade for site in (LIVE, TRIALS)] == [live, trials]


def test_a_sensor_without_an_example_of_its_source() -> None:
    assert 'source = "SCHEME:DEVICE"' in check_source("sonar", "", LIVE).do


def test_a_lidar_that_turns_is_seen(plug: Plug, turning: Turning) -> None:
    found = check_look(lidar(plug(turning).path))
    assert found.grade == "ok", found
    assert "turns a second of" in found.what
    assert "nearest" in found.what


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (None, "connected but silent"),
        (lambda _: b"$GPGGA,123519,4807.038,N*47\r\n" * 3, "no LD06 packet is among them"),
    ],
    ids=["silent", "a GPS receiver"],
)
def test_a_port_that_does_not_speak_ld06_is_broken(
    plug: Plug, data: Callable[[float], bytes] | None, words: str
) -> None:
    found = check_look(lidar(plug(data).path))
    assert (found.grade, words in found.what) == ("broken", True), found


def test_a_port_that_somebody_holds_is_named(plug: Plug, turning: Turning) -> None:
    import serial

    port = plug(turning)
    with serial.Serial(port.path, exclusive=True):
        found = check_look(lidar(port.path))
    assert "in use by another process" in found.what


def test_an_emulated_chip_gives_its_id_and_noise_floor() -> None:
    radar = str(Path(sys.executable).with_name("spotter-radar"))
    found = check_look(Child("radar", [radar, "--source", "spi:emulator/noise"]))
    assert found.grade == "ok"
    assert "chip id 0x000303 (BGT60TR13C)" in found.what
    assert "noise floor" in found.what


def test_a_camera_gives_size_rate_network_and_milliseconds(tmp_path: Path) -> None:
    camera = str(Path(sys.executable).with_name("spotter-camera"))
    found = check_look(Child("camera", [camera, "--source", "sim:crossing"]))
    assert found.grade == "ok", found
    assert "640 x 480" in found.what
    assert "on CPU in" in found.what
    wrong = check_look(Child("camera", [camera, "--source", "sim:crossing", "--set", "detector.model=/no/n.onnx"]))
    assert (wrong.grade, "/no/n.onnx" in wrong.what) == ("broken", True)


def test_the_field_site_whose_paths_and_model_were_passed(tmp_path: Path, free_ports: Callable[[], int]) -> None:
    """A v4l2 source by its path, a model that is nowhere, no lidar plugged in: each was ok, or looked for elsewhere."""
    site = tmp_path / "site.toml"
    site.write_text(f"""
        [tls]
        enabled = false
        [hosts.jetson0]
        port = {free_ports()}
        local_port = {free_ports()}
        [hosts.jetson0.services.lidar]
        source = "serial:{tmp_path}/ttyUSB0"
        [hosts.jetson0.services.camera]
        source = "v4l2:{tmp_path}/video0"
        set = ["detector.model=/nonexistent/yolov8n.onnx"]
    """)
    result = CliRunner().invoke(app, ["doctor", "jetson0", "--site", str(site), "--json"])
    found = {row["check"]: row for row in map(json.loads, result.stdout.splitlines())}
    assert found["camera device"]["what"] == f"{tmp_path}/video0 is not there"
    assert found["camera model"]["what"] == "/nonexistent/yolov8n.onnx is not there"
    assert found["lidar device"]["grade"] == "broken"
    assert {"camera look", "lidar look"}.isdisjoint(found)  # what is not there is not opened


def test_a_service_with_a_wrong_key_is_named(tmp_path: Path) -> None:
    program = tmp_path / "spotter-radar"
    program.write_text("#!/bin/sh\necho 'spotter: radar.toml: [cfar] x = 1: no such key' >&2\nexit 2\n")
    program.chmod(0o755)
    (finding,) = check_services([Child("router", ["x"]), Child("radar", [str(program)])], LIVE)
    assert finding.grade == "broken"
    assert finding.what == "radar.toml: [cfar] x = 1: no such key"


def test_a_service_that_is_not_installed_is_named() -> None:
    assert grades(check_services([Child("radar", ["/nowhere/spotter-radar"])], LIVE)) == {"radar program": "broken"}


def test_a_device_is_left_to_its_service(plug: Plug, turning: Turning) -> None:
    """Two readers of one port take each other's bytes."""
    child = lidar(plug(turning).path)
    found = {one.check: one for one in check_services([child], LIVE, running={"lidar"})}
    assert found["lidar look"].what.startswith("its service runs and has the device")


def test_who_is_alive_on_a_host(zenoh_config: ZenohConfig) -> None:
    port = int(zenoh_config.connect[0].rpartition(":")[2])
    site = Site(tls=TlsConfig(enabled=False), hosts={"pi0": HostConfig(local_port=port)})
    assert alive_on(site, "pi0") == set()
    with Service("radar", ServiceConfig(host="pi0", zenoh=zenoh_config)):
        assert alive_on(site, "pi0") == {"radar"}


def test_watching_a_sensor_is_its_own_programs_look(plug: Plug, turning: Turning, tmp_path: Path) -> None:
    site = tmp_path / "site.toml"
    site.write_text(f"[hosts.jetson0.services.lidar]\nsource = 'serial:{plug(turning).path}'\n")
    command = [SPOTTER, "doctor", "--watch", "lidar", "--site", str(site)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(2)]
        process.kill()
    assert all(line.startswith("sees") and "turns a second" in line for line in lines), lines


def test_watching_what_is_not_there_names_what_is(tmp_path: Path) -> None:
    site = tmp_path / "site.toml"
    site.write_text("[hosts.jetson0.services.lidar]\n[hosts.jetson0.services.fusion]\n")
    for words in (["--watch", "radar"], ["jetson0", "--watch", "fusion"]):
        refused = CliRunner().invoke(app, ["doctor", *words, "--site", str(site)])
        assert (refused.exit_code, "known: jetson0 lidar" in refused.output) == (2, True)


def test_a_device_of_somebody_else(tmp_path: Path) -> None:
    """Root may open everything, so a child looks that has become somebody else."""
    if os.geteuid() != 0:
        pytest.skip("needs root to become somebody else")
    shared = Path(tempfile.mkdtemp())
    shared.chmod(0o755)
    (shared / "tty").touch(mode=0o600)
    child = os.fork()
    if child == 0:
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)
        os._exit(0 if grades(check_device("lidar", f"serial:{shared / 'tty'}")) == {"lidar device": "broken"} else 1)
    _, status = os.waitpid(child, 0)
    shutil.rmtree(shared)
    assert status == 0
