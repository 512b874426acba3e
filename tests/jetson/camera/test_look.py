"""What `look` says of a camera: its rate is judged by all pictures that came, not by the one that the network saw."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from common.bus.look import PeriodSamples
from common.bus.status import Report
from common.messages import CameraDetections
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.frames import Frame
from services.jetson.camera.look import describe


@pytest.mark.parametrize(("rate_hz", "sees"), [(0.0, True), (1.5, False), (2.0, True), (30.0, True)])
def test_a_slow_camera_is_told(report: Report, rate_hz: float, sees: bool) -> None:
    """A rate of 0 is one picture in the first period: no rate yet."""
    newest = CameraDetections(
        stamp_ns=1, detections=[], brightness=90.0, level=None, image_size_px=(640, 480),
        provider="CPUExecutionProvider",
    )  # fmt: skip
    seen: PeriodSamples[Frame] = PeriodSamples([], rate_hz, report.snapshot())
    look = describe(CameraConfig(source="sim:crossing"), seen, newest)
    assert (look.sees, "too slow" in look.what, "more light" in look.do) == (sees, not sees, not sees)


@pytest.mark.system
@pytest.mark.whole  # on a busy machine pictures are late, and it says so
def test_looking_once_in_a_while_does_not_make_a_camera_slow() -> None:
    program = str(Path(sys.executable).with_name("spotter-camera"))
    look = ["look", "--watch", "--seconds", "0.6"]
    command = [program, "--source", "sim:crossing", "--set", "health.raise_frames=1", *look]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        said = [running.stdout.readline() for _ in range(3)]
        running.send_signal(signal.SIGINT)
    assert all(line.startswith("sees    sim:crossing") for line in said), said
