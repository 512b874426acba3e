"""A disk that takes no more: every process goes on with its work, and says what it could not keep.

The limit on the size of files stands for the full disk; a log is /dev/full.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import zenoh

from common import topics
from common.bus.session import open_session
from common.codec import decode
from common.config import ZenohConfig
from common.messages import ServiceStatus
from common.recording.reader import read_metadata
from services.infra_lidar.calibration.plane_fit import Calibration
from services.infra_lidar.calibration.store import Store
from services.infra_lidar.segmentation.background import BackgroundModel
from services.jetson.fusion.evidence import FusionMemory
from services.jetson.fusion.store import Saved, this_boot
from services.jetson.fusion.store import Store as FusionStore

ARRAYS = {"intervals": np.zeros((1, 4, 128), np.uint16), "is_road": np.zeros(128, bool)}
BACKGROUND = BackgroundModel(
    columns=1, rows=128, background_ratio=0.5, surface=np.zeros((1, 1, 3), np.float32), **ARRAYS
)
LEVEL = Calibration(np.eye(4), height_m=4.0, tilt_deg=0.0, error_deg=0.1, frames=1)

pytestmark = [pytest.mark.system, pytest.mark.whole]
BIN = Path(sys.executable).parent
Until = Callable[..., None]


def file_size_limit(pid: int, size: int) -> None:
    """From now on no file of the process grows beyond ``size`` bytes; a negative size lifts the limit."""
    _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size if size >= 0 else hard, hard))


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """``start(*command, log=...)``: processes that end with the test."""
    with ExitStack() as stack:

        def launch(*command: str, log: Path) -> subprocess.Popen[bytes]:
            with log.open("ab") as stderr:
                process = subprocess.Popen([str(BIN / command[0]), *command[1:]], stderr=stderr)
            stack.callback(process.wait, 15)
            stack.callback(process.terminate)
            return process

        yield launch


def test_a_blackbox_loses_the_incident_says_so_and_keeps_the_next(
    zenoh_config: ZenohConfig, tmp_path: Path, start: Callable[..., subprocess.Popen[bytes]], until: Until
) -> None:
    folder, log = tmp_path / "incidents", tmp_path / "log"
    settings = (f'zenoh.connect=["{zenoh_config.connect[0]}"]', f"folder={folder}", "before_s=0.5", "after_s=0.5")
    process = start("spotter-blackbox", *(word for one in settings for word in ("--set", one)), log=log)
    with open_session(zenoh_config) as laptop:

        def status() -> ServiceStatus | None:
            replies = [reply.ok for reply in laptop.get("jetson0/blackbox/status", timeout=1.0) if reply.ok is not None]
            return decode(replies[0].payload.to_bytes(), ServiceStatus) if replies else None

        def save() -> str:
            selector = zenoh.Selector("jetson0/blackbox/save", zenoh.Parameters({"why": "a test"}))
            (reply,) = [reply.ok for reply in laptop.get(selector, timeout=5.0) if reply.ok is not None]
            return str(json.loads(reply.payload.to_bytes())["incident"])

        def state_and_reason() -> tuple[str, str]:
            now = status()
            return (now.state, now.reason) if now else ("", "")

        until(lambda: state_and_reason() == ("online", ""))
        file_size_limit(process.pid, 100)
        lost = save()
        until(lambda: state_and_reason() == ("degraded", f"{lost} was not kept: {folder}: File too large"))
        assert list(folder.glob("*/*")) == []  # nor half of it
        file_size_limit(process.pid, -1)
        kept = save()
        until(lambda: state_and_reason() == ("online", ""))
        assert process.poll() is None
        now = status()
        assert now is not None
        assert (now.counters["incidents"], now.counters["incidents lost"]) == (1, 1)
    assert read_metadata(folder / kept / "jetson0.mcap")["incident"]["why"] == "a test"
    assert f"{lost} was not kept" in log.read_text()


def test_a_full_disk_below_the_state_folder_is_in_the_log_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = Store(str(tmp_path))
    file_size_limit(os.getpid(), 10)
    try:
        for _ in range(3):
            store.keep(LEVEL, BACKGROUND)
    finally:
        file_size_limit(os.getpid(), -1)
    assert caplog.messages == [f"{tmp_path}: File too large; not kept, the next start learns anew"]
    assert list(tmp_path.iterdir()) == []
    assert Store(str(tmp_path)).load() == (None, None)


def test_alarms_that_cannot_be_kept_are_in_the_log_once_and_kept_again_afterwards(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = FusionStore(str(tmp_path), "spotter", "jetson0")
    saved = Saved(1, 1.0, 0.0, FusionMemory(), boot=this_boot())
    file_size_limit(os.getpid(), 10)
    try:
        for _ in range(3):
            store.write(saved)
    finally:
        file_size_limit(os.getpid(), -1)
    assert caplog.messages == [f"{tmp_path}: File too large; alarms would not survive a restart"]
    assert list(tmp_path.iterdir()) == []  # nor half of them
    store.write(saved)
    assert store.load() == saved


@pytest.mark.parametrize(
    "command",
    [
        ("spotter-lidar", "--source", "sim:empty", "--set", 'zenoh.connect=["{endpoint}"]'),
        ("spotter", "up", "pi0", "--sim", "empty", "--listen", "{own}", "--link", "{endpoint}"),
    ],
    ids=["service", "up"],
)
def test_a_log_that_takes_no_more_stops_nothing(
    zenoh_config: ZenohConfig,
    free_ports: Callable[[], int],
    start: Callable[..., subprocess.Popen[bytes]],
    command: tuple[str, ...],
) -> None:
    names = {"endpoint": zenoh_config.connect[0], "own": f"tcp/127.0.0.1:{free_ports()}"}
    process = start(*(word.format(**names) for word in command), log=Path("/dev/full"))
    arrivals = threading.Semaphore(0)
    with open_session(zenoh_config) as laptop:
        for topic in (topics.LIDAR_ZONES, topics.RADAR_TRACKS):
            laptop.declare_subscriber(topic.any_host, lambda _: arrivals.release())
        for _ in range(10):
            assert arrivals.acquire(timeout=40.0)
    assert process.poll() is None
