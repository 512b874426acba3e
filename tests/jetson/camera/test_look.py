"""What `look` says of a camera: its rate is judged by all pictures that came, not by the one that the network saw."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from common.bus.look import Seen
from common.bus.status import Report
from common.messages import CameraDetections
from services.jetson.camera import look
from services.jetson.camera.config import CameraConfig, HealthConfig
from services.jetson.camera.frames import Frame
from services.jetson.camera.look import describe
from spotter_sim import camera


@pytest.mark.parametrize(("rate_hz", "sees"), [(0.0, True), (1.5, False), (2.0, True), (30.0, True)])
def test_a_slow_camera_is_told(report: Report, rate_hz: float, sees: bool) -> None:
    """A rate of 0 is one picture in the first period: no rate yet."""
    newest = CameraDetections(
        stamp_ns=1, detections=[], brightness=90.0, level=None, image_size_px=(640, 480),
        provider="CPUExecutionProvider",
    )  # fmt: skip
    seen: Seen[Frame] = Seen([], rate_hz, report.snapshot())
    told = describe(CameraConfig(source="sim:crossing"), seen, newest)
    assert (told.sees, "too slow" in told.what, "more light" in told.do) == (sees, not sees, not sees)


def test_looking_once_in_a_while_does_not_make_a_camera_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """15 pictures a second, of which the network sees one in a second and a half, which is too slow."""
    pictures = [Frame(1_500_000_000 * k, 0, camera.image("crossing", 1.5 * k, 640, 480)) for k in range(1, 4)]
    seen = [Seen([picture], 15.0, Report("look").snapshot()) for picture in pictures]
    monkeypatch.setattr(look, "collect", lambda frames, seconds: seen)
    config = CameraConfig(source="sim:crossing", health=HealthConfig(raise_frames=1))
    assert [one.sees for one in look.looks(config, 1.5)] == [True, True, True]


@pytest.mark.system
def test_the_command_goes_on_until_it_is_interrupted() -> None:
    program = str(Path(sys.executable).with_name("spotter-camera"))
    command = [program, "--source", "sim:crossing", "look", "--watch", "--seconds", "0.6"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        told = (line for line in running.stdout if "pictures a second" in line)  # on a busy machine not in each period
        assert all(" sim:crossing [SIMULATED]: 640 x 480, " in next(told) for _ in range(2))
        running.send_signal(signal.SIGINT)
        assert running.wait() in (0, 1)  # by its last line
