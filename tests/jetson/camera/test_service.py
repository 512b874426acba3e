"""The service as a process of its own over real Zenoh, as a laptop sees it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.bus.session import open_session
from common.codec import decode
from common.config import ZenohConfig
from common.messages import CameraDetections, CompressedImage, Message, ServiceStatus
from common.topics import CAMERA_DETECTIONS, CAMERA_IMAGE, status_topic
from services.jetson.camera.detector import DEMO_MODEL

BUDGET_S = 60.0
HOST = "jetson0"
REAL = ("--source", "csi:0", "--set", f"detector.model={DEMO_MODEL}")
pytestmark = pytest.mark.system


class Laptop:
    """Keeps what arrives under a key, by message type."""

    def __init__(self, config: ZenohConfig) -> None:
        self.session = open_session(config)
        self.news = threading.Condition()
        self._subscribers: list[object] = []

    def follow(self, key: str, message_type: type[Message]) -> list[Message]:
        found: list[Message] = []

        def take(sample: object) -> None:
            with self.news:
                found.append(decode(sample.payload.to_bytes(), message_type))
                self.news.notify_all()

        self._subscribers.append(self.session.declare_subscriber(key, take))
        return found

    def until(self, condition: Callable[[], object], what: str) -> None:
        with self.news:
            assert self.news.wait_for(condition, BUDGET_S), f"not in time: {what}"


@pytest.fixture
def laptop(zenoh_config: ZenohConfig) -> Iterator[Laptop]:
    one = Laptop(zenoh_config)
    yield one
    one.session.close()


@contextmanager
def service(endpoint: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", "services.jetson.camera", "--set", f'zenoh.connect=["{endpoint}"]', *arguments]
    process = subprocess.Popen(command, cwd=Path(__file__).parents[3], env={**os.environ, "SPOTTER_LOG": "warning"})
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        process.wait(BUDGET_S)


def test_it_publishes_what_the_simulated_camera_sees_and_ends_cleanly(router_endpoint: str, laptop: Laptop) -> None:
    seen = laptop.follow(CAMERA_DETECTIONS.key(HOST), CameraDetections)
    with service(router_endpoint, "--source", "sim:crossing?t0=4.0") as process:
        laptop.until(lambda: any(m.level == "IMMINENT" for m in seen), "an alarm")
        process.terminate()
        assert process.wait(BUDGET_S) == 0
    assert [m.seq for m in seen] == list(range(len(seen)))
    assert all(m.stamp_ns <= m.received_ns <= m.sent_ns for m in seen)
    assert {m.provider for m in seen} == {"CPUExecutionProvider"}


def test_the_picture_is_made_only_while_somebody_listens(router_endpoint: str, laptop: Laptop) -> None:
    seen = laptop.follow(CAMERA_DETECTIONS.key(HOST), CameraDetections)
    with service(router_endpoint, "--source", "sim:crossing?t0=4.5"):
        laptop.until(lambda: len(seen) >= 5, "detections")
        pictures = laptop.follow(CAMERA_IMAGE.key(HOST), CompressedImage)
        laptop.until(lambda: len(pictures) >= 4, "pictures")
    assert pictures[0].seq == 0  # none was made before
    assert min(np.diff([p.stamp_ns for p in pictures])) >= 0.2e9  # 5 Hz at most
    assert cv2.imdecode(np.frombuffer(pictures[0].data, np.uint8), cv2.IMREAD_COLOR).shape == (480, 640, 3)


def test_a_recording_of_pictures_is_published_in_full_and_then_it_ends(
    router_endpoint: str, laptop: Laptop, texture: np.ndarray, tmp_path: Path
) -> None:
    for number in range(5):
        cv2.imwrite(str(tmp_path / f"{number}.png"), texture)
    seen = laptop.follow(CAMERA_DETECTIONS.key(HOST), CameraDetections)
    with service(
        router_endpoint, "--set", f"detector.model={DEMO_MODEL}", "--source", f"file:{tmp_path}?rate=0"
    ) as process:
        assert process.wait(BUDGET_S) == 0
        laptop.until(lambda: len(seen) == 5, "all five")


def test_a_killed_capture_is_in_health_and_heals(router_endpoint: str, laptop: Laptop, tmp_path: Path) -> None:
    script = tmp_path / "child.py"
    script.write_text(
        "import os, pathlib, sys, time\n"
        "pathlib.Path(sys.argv[1]).write_text(str(os.getpid()))\n"
        "while True:\n"
        "    sys.stdout.buffer.write(os.urandom(96 * 64 * 3)); sys.stdout.buffer.flush(); time.sleep(0.03)\n"
    )
    book = tmp_path / "pid"
    statuses = laptop.follow(status_topic("camera").key(HOST), ServiceStatus)
    seen = laptop.follow(CAMERA_DETECTIONS.key(HOST), CameraDetections)
    child = f'["{sys.executable}", "{script}", "{book}"]'
    settings = (
        "--set",
        f"capture.csi_command={child}",
        "--set",
        "capture.width_px=96",
        "--set",
        "capture.height_px=64",
        "--set",
        f"detector.model={DEMO_MODEL}",
    )
    with service(router_endpoint, "--source", "csi:0", *settings):
        laptop.until(lambda: len(seen) >= 5, "detections")
        os.kill(int(book.read_text()), signal.SIGKILL)
        laptop.until(lambda: any(s.state == "disconnected" for s in statuses), "the loss")
        lost = next(s for s in statuses if s.state == "disconnected")
        assert "killed by signal 9" in lost.reason
        assert "nvargus-daemon" in lost.reason
        count = len(seen)
        laptop.until(lambda: len(seen) >= count + 5 and statuses[-1].state == "online", "its return")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "detector.model=none.onnx"], "no such file; expected an ONNX file"),
        (["--source", "v4l2:0"], "the demo network knows the simulated world alone"),
        (["--source", "usb:1"], "expected one of csi:"),
        (["--set", "capture.csi_command=['x', '{lens}']", *REAL], "'lens' is no placeholder"),
    ],
)
def test_a_wrong_configuration_ends_it_with_one_line(router_endpoint: str, arguments: list[str], message: str) -> None:
    command = [sys.executable, "-m", "services.jetson.camera", "--set", f'zenoh.connect=["{router_endpoint}"]']
    done = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=BUDGET_S, check=False)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
