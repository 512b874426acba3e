"""`spotter setup`: from devices that are plugged in to a site file that runs, without an editor."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest
from typer.testing import CliRunner

from common import topics
from common.bus.session import open_session
from common.codec import decode
from common.config import ZenohConfig
from common.host.site import ServicePlace, load_site
from common.messages import SystemHealth, Verdict
from services.jetson.camera.detector import DEMO_MODEL
from spotter_sim import camera
from spotter_tools.cli.__main__ import app
from spotter_tools.setup import candidates
from spotter_tools.setup.candidates import CANDIDATES
from tests.infra_lidar.made_packets import vls_packet

SPOTTER = str(Path(sys.executable).with_name("spotter"))
runner = CliRunner()
Plug, Turning = Callable[..., Any], Callable[[float], bytes]


@pytest.fixture
def machine(tmp_path: Path, plug: Plug, turning: Turning) -> Path:
    """A folder like /dev: an LD06 behind a named adapter, a GPS receiver, and a video where the camera would be."""
    dev = tmp_path / "dev"
    (dev / "serial/by-id").mkdir(parents=True)
    (dev / "serial/by-id/usb-Silicon_Labs_CP2102N-if00-port0").symlink_to(plug(turning).path)
    (dev / "ttyUSB1").symlink_to(plug(lambda _: b"$GPGGA,123519,4807.038,N*47\r\n").path)
    video = cv2.VideoWriter(str(tmp_path / "street.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 15, (640, 480))
    for i in range(45):
        video.write(camera.image("crossing", i / 15, 640, 480))
    video.release()
    (dev / "video0").symlink_to(tmp_path / "street.mp4")
    return dev


def test_ports_by_name_come_first_and_only_once(machine: Path) -> None:
    by_id = machine / "serial/by-id/usb-Silicon_Labs_CP2102N-if00-port0"
    (machine / "ttyUSB0").symlink_to(by_id.resolve())  # the same device again, by its number
    (machine / "ttyACM0").write_text("no terminal")
    assert CANDIDATES["lidar"](machine) == [f"serial:{by_id}", f"serial:{machine / 'ttyUSB1'}"]


def test_a_video_file_is_called_a_recording(machine: Path, tmp_path: Path) -> None:
    assert CANDIDATES["camera"](machine) == [f"file:{tmp_path / 'street.mp4'}?loop=1"]


def test_spi_devices(tmp_path: Path) -> None:
    for name in ("spidev0.1", "spidev0.0", "spi"):
        (tmp_path / name).touch()
    assert CANDIDATES["radar"](tmp_path) == ["spi:0.0", "spi:0.1"]


@pytest.mark.parametrize(
    ("payload", "source"),
    [
        (vls_packet(0.0), "velodyne://:{port}?from=127.0.0.1"),
        (vls_packet(0.0, product=0x22), None),  # a VLP-16: named by `spotter-infra-lidar look`, not supported
        (b"somebody else", None),
        (b"", None),
    ],
    ids=["VLS-128", "VLP-16", "another program", "nobody"],
)
def test_a_lidar_that_sends_is_found(
    free_ports: Callable[[], int], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, payload: bytes, source: str | None
) -> None:
    port, ended = free_ports(), threading.Event()
    monkeypatch.setattr(candidates, "LIDAR_PORTS", (port,))
    monkeypatch.setattr(candidates, "LISTEN_S", 0.3)

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while payload and not ended.wait(0.01):
                sender.sendto(payload, ("127.0.0.1", port))

    thread = threading.Thread(target=send)
    thread.start()
    assert candidates.infra_lidar(tmp_path) == ([source.format(port=port)] if source else [])
    ended.set()
    thread.join()


def test_a_port_whose_service_runs_is_left_alone(
    free_ports: Callable[[], int], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    port = free_ports()
    monkeypatch.setattr(candidates, "LIDAR_PORTS", (port,))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("", port))
        assert candidates.infra_lidar(tmp_path) == []


def test_setup_without_a_sensor_says_so_and_writes_the_rest(tmp_path: Path) -> None:
    file, dev = tmp_path / "site.toml", tmp_path / "dev"
    dev.mkdir()
    result = runner.invoke(app, ["setup", "pi0", "--yes", "--dev", str(dev), "--site", str(file), "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout.splitlines()[-1]) == {
        "file": str(file),
        "sources": {"radar": ""},
        "missing": ["radar"],
    }
    assert load_site(file).hosts["pi0"].services == {"radar": ServicePlace()}
    refused = runner.invoke(app, ["up", "pi0", "--site", str(file)])
    assert (refused.exit_code, "pi0: no source for radar" in refused.output) == (2, True)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["mars"], "no services on host 'mars'"),
        (["pi0", "--source", "lidar=serial:/dev/x"], "services with a sensor here: radar"),
        (["jetson0", "--model", "/no/n.onnx"], "--model /no/n.onnx: no such file"),
    ],
)
def test_what_setup_refuses(tmp_path: Path, words: list[str], said: str) -> None:
    refused = runner.invoke(app, ["setup", *words, "--yes", "--dev", str(tmp_path), "--site", str(tmp_path / "s.toml")])
    assert (refused.exit_code, said in refused.output) == (2, True), refused.output
    assert not (tmp_path / "s.toml").exists()


def test_a_file_that_no_service_could_read_is_left_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "site.toml"
    file.write_text('[hosts.pi0]\nadress = "1.2.3.4"\n')
    refused = runner.invoke(app, ["setup", "pi0", "--yes", "--dev", str(tmp_path), "--site", str(file)])
    assert refused.exit_code == 2
    assert "did you mean 'address'" in refused.output
    assert file.read_text() == '[hosts.pi0]\nadress = "1.2.3.4"\n'
    assert [path.name for path in tmp_path.iterdir()] == ["site.toml"]


class Terminal:
    """A command at a terminal whose keyboard is ours."""

    def __init__(self, command: list[str], folder: Path) -> None:
        self.pid, self._master = pty.fork()
        if self.pid == 0:
            os.chdir(folder)
            os.execv(command[0], command)
        self.text = ""

    def until(self, words: str) -> str:
        while words not in self.text:
            got = os.read(self._master, 4096)
            assert got, self.text
            self.text += got.decode()
        return self.text

    def enter(self, text: str) -> None:
        os.write(self._master, f"{text}\n".encode())

    def end(self) -> int:
        """Read to the end; the exit code."""
        try:
            while got := os.read(self._master, 4096):
                self.text += got.decode()
        except OSError:
            pass  # the terminal is gone with its last user
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.parametrize(("camera_answer", "kind"), [("", "recorded"), ("none", "live")])
def test_from_nothing_to_a_verdict_without_an_editor(
    machine: Path,
    tmp_path: Path,
    free_ports: Callable[[], int],
    until: Callable[..., None],
    camera_answer: str,
    kind: str,
) -> None:
    """Two commands and Enter. The verdict is live as far as its sensors are: with the video in it, it is not.

    Only the ports are given before, because other tests run beside this one.
    """
    local, file = free_ports(), tmp_path / "site.toml"
    ports = f"local_port = {local}\nport = {free_ports()}\n"
    page = f'[hosts.jetson0.services.dashboard]\nset = ["server.port={free_ports()}"]\n'
    file.write_text(f"[hosts.jetson0]\n{ports}{page}")
    command = [SPOTTER, "setup", "jetson0", "--dev", str(machine), "--open", "--model", str(DEMO_MODEL)]
    terminal = Terminal([*command, "--address", "127.0.0.1"], tmp_path)
    assert "turns a second" in terminal.until("source of lidar")
    assert "no LD06 packet is among them" in terminal.text  # the GPS receiver is looked at and not offered
    terminal.enter("")
    assert "pictures a second" in terminal.until("source of camera")
    terminal.enter(camera_answer)
    assert terminal.end() == 0, terminal.text
    assert re.search(r"spotter up jetson0 --site site.toml", terminal.text)

    with subprocess.Popen(
        [SPOTTER, "up", "jetson0", "--site", str(file)], stderr=subprocess.PIPE, text=True
    ) as running:
        try:
            config = ZenohConfig(connect=(f"tcp/127.0.0.1:{local}",))
            with open_session(config, give_up_after_s=30.0) as session:
                verdicts: list[Verdict] = []
                healths: list[SystemHealth] = []
                kept = [
                    session.declare_subscriber(
                        topics.FUSION_VERDICT.any_host,
                        lambda sample: verdicts.append(decode(sample.payload.to_bytes(), Verdict)),
                    ),
                    session.declare_subscriber(
                        topics.FUSION_HEALTH.any_host,
                        lambda sample: healths.append(decode(sample.payload.to_bytes(), SystemHealth)),
                    ),
                ]
                until(lambda: healths and healths[-1].sensors["lidar"].state == "online", budget_s=40.0)
                if kind == "recorded":
                    until(lambda: healths[-1].sensors["camera"].state == "online", budget_s=40.0)
                    assert healths[-1].sensors["camera"].source_kind == "recorded"  # the video is what it is
                assert healths[-1].sensors["lidar"].source_kind == "live"  # the port speaks now
                until(lambda: verdicts[-1].inputs["lidar"].used and verdicts[-1].source_kind == kind, budget_s=20.0)
                del kept
        finally:
            running.send_signal(signal.SIGINT)
            assert running.wait(20) == 0
