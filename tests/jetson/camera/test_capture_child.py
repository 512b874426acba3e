"""The capture child: a real process that is killed, stopped, hangs in the middle of a picture, or never comes.

The child is a small script with the contract of the real one (raw BGR rows on stdout); where GStreamer is installed the
same is done with ``gst-launch-1.0`` and its test picture.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest

from common.bus.status import Report
from common.messages import ServiceStatus
from common.source_url import SourceUrl
from services.jetson.camera.child import CaptureChild, CaptureLost
from services.jetson.camera.config import CameraConfig, CaptureConfig
from services.jetson.camera.frames import Frame, NewestFrames
from services.jetson.camera.gstreamer import command
from services.jetson.camera.source import open_source

WIDTH, HEIGHT = 64, 48
BUDGET_S = 60.0
pytestmark = pytest.mark.system

REPOSITORY = Path(__file__).parents[3]

# Says its process id, then one picture every 20 ms whose pixels count up; in its first life it may misbehave.
CHILD = """
import os, pathlib, sys, time
place, misbehaviour, size = pathlib.Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]) * int(sys.argv[4]) * 3
lives = place / "lives"
first = not lives.exists()
with lives.open("a") as book:
    book.write(f"{os.getpid()}\\n")
out = sys.stdout.buffer
for number in range(1_000_000):
    picture = bytes([number % 256]) * size
    if first and number == 5 and misbehaviour == "hang":
        out.write(picture[: size // 2]); out.flush()
        time.sleep(1000)
    if first and number == 5 and misbehaviour == "end":
        sys.exit("ERROR: no cameras available")
    out.write(picture); out.flush()
    time.sleep(0.02)
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "child.py").write_text(CHILD)
    return tmp_path


def child_command(place: Path, misbehaviour: str = "none") -> list[str]:
    return [sys.executable, str(place / "child.py"), str(place), misbehaviour, str(WIDTH), str(HEIGHT)]


def lives(place: Path) -> list[int]:
    book = place / "lives"
    return [int(line) for line in book.read_text().split()] if book.exists() else []


def gone(pid: int) -> bool:
    """No such process, or one that is dead and only not yet collected by its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


@pytest.fixture
def until(until: Callable[..., None]) -> Callable[..., None]:
    """With time for processes to start."""
    return partial(until, budget_s=BUDGET_S)


class Watched:
    """The service's own capture loop with a reader that keeps the newest frame and a copy of every status change."""

    def __init__(self, config: CameraConfig) -> None:
        self.report = Report("test")
        self.frames: list[Frame] = []
        self.statuses: list[ServiceStatus] = []
        source, lossless = open_source(config, self.report)
        self._newest = NewestFrames(source, self.report, lossless)

    def look(self) -> None:
        status = self.report.snapshot()
        if not self.statuses or self.statuses[-1].state != status.state:
            self.statuses.append(status)

    def lost(self) -> bool:
        self.look()
        return self.statuses[-1].state == "disconnected"

    def more_frames(self, count: int = 3) -> Callable[[], bool]:
        """A condition: so many frames have come since this call."""
        wanted = len(self.frames) + count
        return lambda: len(self.frames) >= wanted

    @contextmanager
    def running(self) -> Iterator[Watched]:
        def read() -> None:
            for frame in self._newest:
                self.frames.append(frame)
                self.report.state("online")

        with self._newest:
            reader = threading.Thread(target=read)
            reader.start()
            yield self
        reader.join(5)
        assert not reader.is_alive()


def config_with(child: list[str], **capture: object) -> CameraConfig:
    settings = {"frame_timeout_s": 0.4, "retry_min_s": 0.3, "width_px": WIDTH, "height_px": HEIGHT, **capture}
    return CameraConfig(source="csi:0", capture=CaptureConfig(csi_command=tuple(child), **settings))


def gstreamer_command() -> list[str]:
    """The built-in command for a USB camera, with GStreamer's test picture in the place of the device."""
    if shutil.which("gst-launch-1.0") is None:
        pytest.skip("gst-launch-1.0 is not installed; the script in Python covers the same contract")
    capture = msgspec.structs.replace(CaptureConfig(), width_px=WIDTH, height_px=HEIGHT)
    built_in = command(SourceUrl("v4l2", "0"), capture)
    device = built_in.index("device=/dev/video0")
    live = ["videotestsrc", "is-live=true", "!", "video/x-raw,width=160,height=120,framerate=30/1"]
    crop = built_in.index("aspectratiocrop")  # of the good plug-ins, which bring v4l2src too
    return [*built_in[: device - 1], *live, *built_in[device + 1 : crop - 1], *built_in[crop + 2 :]]


def test_frames_are_whole_in_order_and_stamped(place: Path) -> None:
    with CaptureChild(child_command(place), WIDTH, HEIGHT) as child:
        frames = [child.read(BUDGET_S) for _ in range(4)]
    for number, frame in enumerate(frames):
        assert frame.image.shape == (HEIGHT, WIDTH, 3)
        assert np.all(frame.image == number)
        assert frame.stamp_ns <= frame.received_ns
    assert gone(child.pid)


def test_gstreamer_delivers_its_test_picture() -> None:
    with CaptureChild(gstreamer_command(), WIDTH, HEIGHT) as child:
        image = child.read(BUDGET_S).image
        second = child.read(BUDGET_S).image
    # SMPTE colour bars: white, yellow, cyan, green, magenta, red, blue from the left, in BGR
    top = image[5, [4, 14, 23, 32, 41, 50, 59]].astype(int)
    assert (top > 128).tolist() == [
        [True, True, True], [False, True, True], [True, True, False], [False, True, False],
        [True, False, True], [False, False, True], [True, False, False],
    ]  # fmt: skip
    assert second.shape == image.shape


@pytest.mark.parametrize("make", ["python", "gstreamer"])
@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGSTOP])
def test_a_child_that_is_killed_or_frozen_is_noticed_ended_and_replaced(
    place: Path, make: str, blow: signal.Signals, until: Callable[..., None]
) -> None:
    if make == "gstreamer":
        launch = " ".join(f"'{part}'" for part in gstreamer_command())
        shell = f"echo $$ >> '{place}/lives'; exec {launch}"
        child = ["/bin/sh", "-c", shell.replace("{", "{{").replace("}", "}}")]
    else:
        child = child_command(place)
    with Watched(config_with(child)).running() as watched:
        until(watched.more_frames(), "more frames")
        victim = lives(place)[0]
        os.kill(victim, blow)
        until(watched.lost, "the loss")
        until(lambda: gone(victim), "the end of the old child")
        until(watched.more_frames(), "more frames")
        assert len(lives(place)) == 2
        assert "nvargus-daemon" in watched.statuses[-1].reason
    assert gone(lives(place)[-1])


@pytest.mark.parametrize(
    ("misbehaviour", "reason"),
    [("hang", "no whole picture for 0.4 s"), ("end", "ended with code 1: ERROR: no cameras available")],
)
def test_a_child_that_hangs_in_a_picture_or_ends_is_replaced(
    place: Path, misbehaviour: str, reason: str, until: Callable[..., None]
) -> None:
    with Watched(config_with(child_command(place, misbehaviour))).running() as watched:
        until(watched.lost, "the loss")
        assert reason in watched.statuses[-1].reason
        before = len(watched.frames)
        until(watched.more_frames(), "more frames")
        assert np.all(watched.frames[before].image == watched.frames[before].image[0, 0, 0])  # no torn picture
        assert len(lives(place)) == 2


def test_a_program_that_is_not_installed_is_said_so(until: Callable[..., None]) -> None:
    with Watched(config_with(["no-such-program-here"])).running() as watched:
        until(watched.lost, "the loss")
        assert "no-such-program-here is not installed" in watched.statuses[-1].reason


def test_the_pause_between_attempts_grows_to_its_limit(place: Path, until: Callable[..., None]) -> None:
    failing = [sys.executable, "-c", f"open({str(place / 'lives')!r}, 'a').write('1 '); raise SystemExit(3)"]
    with Watched(config_with(failing, retry_min_s=0.01, retry_max_s=0.02)).running() as watched:
        until(lambda: len(lives(place)) >= 4, "four attempts")
        until(watched.lost, "the loss")
        assert "ended with code 3" in watched.statuses[-1].reason


def test_a_silent_child_is_given_up_after_the_start_timeout(place: Path) -> None:
    silent = [sys.executable, "-c", "import time; time.sleep(1000)"]
    with (
        CaptureChild(silent, WIDTH, HEIGHT) as child,
        pytest.raises(CaptureLost, match=r"no whole picture for 0\.2 s"),
    ):
        child.read(0.2)
    assert gone(child.pid)


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv (util-linux) is not installed")
def test_a_hung_child_dies_with_a_service_that_is_killed(place: Path, until: Callable[..., None]) -> None:
    """kill -9 leaves no time to clean up, and a child that writes nothing never meets the closed pipe."""
    silent = [sys.executable, "-c", "import time; time.sleep(1000)"]
    parent = (
        "import os, signal\n"
        "from services.jetson.camera.child import CaptureChild\n"
        f"with CaptureChild({silent!r}, 8, 8) as child:\n"
        "    print(child.pid, flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", parent], capture_output=True, cwd=REPOSITORY, check=False)
    assert done.returncode == -signal.SIGKILL
    until(lambda: gone(int(done.stdout)), "the end of the orphan")


def test_a_v4l2_device_that_is_not_there_is_told_without_starting_a_child(until: Callable[..., None]) -> None:
    config = CameraConfig(source="v4l2:99")
    with Watched(config).running() as watched:
        until(watched.lost, "the loss")
        assert watched.statuses[-1].reason.endswith("/dev/video99 is not there; plug the camera in")


def test_built_in_commands_name_the_device_the_mode_and_the_size() -> None:
    capture = msgspec.structs.replace(CaptureConfig(), width_px=640, height_px=480)
    csi = " ".join(command(SourceUrl("csi", "1"), capture))
    assert "nvarguscamerasrc sensor-id=1" in csi
    assert "width=1920,height=1080,framerate=30/1" in csi
    assert csi.endswith("video/x-raw,format=BGR,width=640,height=360 ! fdsink fd=1 sync=false")  # 16:9 stays 16:9
    assert "v4l2src device=/dev/video0" in " ".join(command(SourceUrl("v4l2", "0"), capture))


def test_a_slow_camera_is_called_slow(tmp_path: Path, report: Report, until: Callable[..., None]) -> None:
    """A picture every 1.5 s against a limit of 0.1 s: light and limit are named before the cable."""
    script = tmp_path / "slow.py"
    script.write_text(
        "import sys, time\nwhile True:\n"
        f"    sys.stdout.buffer.write(bytes({WIDTH * HEIGHT * 3})); sys.stdout.buffer.flush(); time.sleep(1.5)\n"
    )
    config = config_with([sys.executable, str(script)], width_px=WIDTH, height_px=HEIGHT, frame_timeout_s=0.1)
    source, _ = open_source(config, report)
    stop = threading.Event()
    frames = source(stop)
    next(frames)
    second = threading.Thread(target=lambda: next(frames, None))
    second.start()
    try:
        until(lambda: report.snapshot().state == "disconnected", "the loss")
        assert "too slow: more light, a smaller picture" in report.snapshot().reason
    finally:
        stop.set()
        second.join(30.0)


def test_a_slow_camera_is_waited_for_and_not_restarted_for_ever(tmp_path: Path, until: Callable[..., None]) -> None:
    """A picture every 0.3 s against a limit of 0.1 s: some children are ended, then one stays."""
    script = tmp_path / "slow.py"
    script.write_text(
        f"import os, sys, time\nopen({str(tmp_path / 'lives')!r}, 'a').write(f'{{os.getpid()}}\\n')\nwhile True:\n"
        f"    sys.stdout.buffer.write(bytes({WIDTH * HEIGHT * 3})); sys.stdout.buffer.flush(); time.sleep(0.3)\n"
    )
    limits = {"frame_timeout_s": 0.1, "retry_min_s": 0.01, "retry_max_s": 0.02}
    with Watched(config_with([sys.executable, str(script)], **limits)).running() as watched:
        until(watched.lost, "the first is ended")
        until(lambda: len(watched.frames) >= len(lives(tmp_path)) + 6, "pictures, six of them from one child")
    assert len(lives(tmp_path)) >= 2
