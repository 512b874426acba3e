"""Recordings and the simulated camera through the same door as live ones."""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from common import pacing
from common.bus.status import Report
from common.config import ConfigError
from services.jetson.camera.config import CameraConfig, CaptureConfig
from services.jetson.camera.frames import Frame
from services.jetson.camera.source import fitted, open_source
from spotter_sim.world import SCENARIOS


def frames_of(url: str, report: Report, count: int = 1000) -> list[Frame]:
    source, _ = open_source(CameraConfig(source=url), report)
    stop = threading.Event()
    found = []
    for frame in source(stop):
        found.append(frame)
        if len(found) == count:
            stop.set()
            break
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three pictures of growing brightness, written out of order, and a file that is none."""
    for number in (2, 0, 1):
        cv2.imwrite(str(tmp_path / f"{number:03}.png"), np.full((48, 64, 3), 50 * number, np.uint8))
    (tmp_path / "notes.txt").write_text("no picture")
    return tmp_path


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    for number in range(6):
        writer.write(np.full((48, 64, 3), 40 * number, np.uint8))
    writer.release()
    return path


def test_a_folder_is_read_in_order_of_name_and_ends(folder: Path, report: Report) -> None:
    frames = frames_of(f"file:{folder}?rate=0", report)
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [0, 50, 100]
    assert all(frame.stamp_ns > 1_600_000_000 * 10**9 for frame in frames)


def test_a_folder_starts_again_with_loop(folder: Path, report: Report) -> None:
    frames = frames_of(f"file:{folder}?rate=0&loop=1", report, count=7)
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [0, 50, 100, 0, 50, 100, 0]


def test_one_picture_is_a_recording_too(folder: Path, report: Report) -> None:
    assert len(frames_of(f"file:{folder / '001.png'}", report)) == 1


class FakeTime:
    """Stands for the monotonic clock and for the event that is waited on: waiting is what moves the time."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.waited_s: list[float] = []

    def __call__(self) -> float:
        return self.now_s

    def wait(self, seconds: float) -> bool:
        self.waited_s.append(round(seconds, 6))
        self.now_s += seconds
        return False

    def is_set(self) -> bool:
        return False


@pytest.mark.parametrize(("rate", "period_s"), [("", 0.04), ("?rate=4", 0.01), ("?rate=0.5", 0.08), ("?rate=0", 0.0)])
def test_a_video_is_read_to_its_end_at_its_own_pace(
    video: Path, report: Report, monkeypatch: pytest.MonkeyPatch, rate: str, period_s: float
) -> None:
    time = FakeTime()
    monkeypatch.setattr(pacing, "monotonic_s", time)
    source, _ = open_source(CameraConfig(source=f"file:{video}{rate}"), report)
    assert len(list(source(time))) == 6  # type: ignore[arg-type]
    assert time.waited_s[:6] == [0.0, *[period_s] * 5]  # 25 Hz


@pytest.mark.parametrize(("rate", "lossless"), [("?rate=0", True), ("", False), ("?rate=2", False)])
def test_only_the_fastest_replay_waits_for_the_reader(folder: Path, report: Report, rate: str, lossless: bool) -> None:
    assert open_source(CameraConfig(source=f"file:{folder}{rate}"), report)[1] is lossless


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("usb:0", "expected one of csi:, file:, mcap:, ros2:, sim:, v4l2:"),
        ("sim:nowhere", "no scenario 'nowhere'"),
        ("sim:crossing?rate=2", "no parameter 'rate' for sim:"),
        ("file:/nonexistent/video.mp4", "no such file or folder"),
        ("file:{folder}/notes.txt", "not a video or picture"),
        ("file:{folder}?rate=fast", "is not a number"),
    ],
)
def test_a_wrong_source_is_refused_before_the_first_frame(folder: Path, report: Report, url: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message.replace("?", r"\?")):
        open_source(CameraConfig(source=url.format(folder=folder)), report)


def test_a_folder_without_pictures_is_refused(tmp_path: Path, report: Report) -> None:
    with pytest.raises(ConfigError, match="no pictures"):
        open_source(CameraConfig(source=f"file:{tmp_path}"), report)


def test_a_torn_picture_is_an_error_not_a_black_frame(folder: Path, report: Report) -> None:
    (folder / "001.png").write_bytes(b"\x89PNG but no more")
    with pytest.raises(ConfigError, match=r"001\.png: not a picture that can be read"):
        frames_of(f"file:{folder}?rate=0", report)


@pytest.mark.parametrize("loop", ["", "&loop=1"])
def test_a_video_without_one_whole_picture_is_an_error_and_not_read_for_ever(
    video: Path, report: Report, loop: str
) -> None:
    video.write_bytes(video.read_bytes()[:5700])  # the head is whole, its first picture is not
    source, _ = open_source(CameraConfig(source=f"file:{video}?rate=0{loop}"), report)
    with pytest.raises(ConfigError, match=r"not one picture of this video can be read; is the file cut or damaged\?"):
        list(source(threading.Event()))


def test_the_simulated_camera_shows_the_scenario_from_t0(report: Report) -> None:
    frames = frames_of("sim:crossing?t0=3", report, count=2)
    assert frames[0].image.shape == (480, 640, 3)
    assert not np.array_equal(frames[0].image, frames[1].image)


def test_the_unplugged_simulated_camera_is_lost_and_says_what_to_do(report: Report) -> None:
    unplugged = next(fault for fault in SCENARIOS["faults"].faults if fault.name == "camera_unplugged")
    source, _ = open_source(CameraConfig(source=f"sim:faults?t0={unplugged.start_s + 0.1}"), report)
    stop = threading.Event()
    found: list[Frame] = []
    reader = threading.Thread(target=lambda: found.extend(source(stop)))
    reader.start()
    while report.snapshot().state != "disconnected":
        report.changed.wait(0.05)
    stop.set()
    reader.join(5)
    assert "plug the camera in" in report.snapshot().reason
    assert not found


def test_the_simulated_camera_knows_its_place_and_a_real_one_is_left_alone() -> None:
    known = fitted(CameraConfig(source="sim:crossing"))
    assert (known.lens.f_y_px, known.mount.height_m) == (397.0, 0.24)
    assert CameraConfig().lens == known.lens  # the shipped default is the lens that is simulated
    half = fitted(CameraConfig(source="sim:crossing", capture=CaptureConfig(width_px=320, height_px=480)))
    assert (half.lens.f_x_px, half.lens.f_y_px) == (198.5, 397.0)
    real = CameraConfig(source="csi:0")
    assert fitted(real) is real


def test_a_photograph_is_still_and_not_frozen_but_a_video_may_freeze() -> None:
    assert fitted(CameraConfig(source="file:bus.jpg?loop=1")).health.frozen_after_s == 0.0
    video = CameraConfig(source="file:drive.mp4?loop=1")
    assert fitted(video).health.frozen_after_s == 1.0
