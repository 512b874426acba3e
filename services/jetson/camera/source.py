"""Where pictures come from. The only part of the service that opens devices and files and reads the clock.

sim:crossing?t0=0        the simulated camera
file:PATH?rate=1&loop=1  a video, a picture, or a folder of pictures (fps=..); rate=0 = as fast as it is read
mcap:PATH?rate=1&loop=1  the pictures of ``spotter record --raw camera``; rate=0 as above
v4l2:0  v4l2:/dev/video0 a USB camera          } through a child process
csi:0                    a camera on the CSI port }
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import cv2
import msgspec
import numpy as np

from common.clock import monotonic_s, utc_at, utc_ns
from common.config import ConfigError
from common.recording.raw import MCAP_PARAMETERS, fitted_as_recorded, replayed
from common.sim import camera as simulated
from common.sim.scenario_clock import ScenarioClock
from common.sim.world import DeviceUnplugged, T_vehicle_camera
from common.source_url import SourceUrl, parse_source
from common.status import Report
from common.topics import CAMERA_RAW
from services.jetson.camera.child import CaptureChild, CaptureLost
from services.jetson.camera.config import CameraConfig, CaptureConfig, LensConfig
from services.jetson.camera.distance import scaled
from services.jetson.camera.frames import Frame
from services.jetson.camera.gstreamer import advice, command, device_path

log = logging.getLogger("source")

SCHEMES = {"sim": ("t0",), "file": ("rate", "loop", "fps"), "csi": (), "v4l2": (), "mcap": MCAP_PARAMETERS}
PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".webp"}
RESTATE_S = 0.2  # how often a lost camera is said to be lost while nothing else happens

Source = Callable[[threading.Event], Iterator[Frame]]


def open_source(config: CameraConfig, report: Report) -> tuple[Source, bool]:
    """The source of the configuration, to be run by ``NewestFrames``, and whether no frame of it may be skipped.

    Raises:
        ConfigError: unknown scheme or parameter, no such file or scenario.
    """
    url = parse_source(config.source, SCHEMES)
    if url.scheme == "sim":
        return partial(_simulated, ScenarioClock(url), config.capture, report), False
    if url.scheme == "file":
        return partial(_replayed, url, *_recording(url, config.capture)), url.number("rate", 1.0) == 0
    if url.scheme == "mcap":
        return partial(_recorded_on_the_bus, url), url.number("rate", 1.0) == 0
    command(url, config.capture)  # a wrong placeholder is told now, not in the capture thread
    return partial(_captured, url, config.capture, report), False


def fitted(config: CameraConfig) -> CameraConfig:
    """The configuration with what the source knows of itself.

    The simulated camera knows its own lens and place; a single photograph is still by nature, not frozen. A real camera
    has everything from the configuration.
    """
    scheme, _, target = config.source.partition(":")
    if scheme == "file" and Path(target.partition("?")[0]).suffix.lower() in PICTURES:
        return msgspec.structs.replace(config, health=msgspec.structs.replace(config.health, frozen_after_s=0.0))
    if scheme == "mcap":
        return fitted_as_recorded(config, parse_source(config.source, SCHEMES), CAMERA_RAW)
    if scheme != "sim":
        return config
    width_px, height_px = config.capture.width_px, config.capture.height_px
    native = LensConfig(f_x_px=simulated.F_Y_PX, f_y_px=simulated.F_Y_PX)
    mount = msgspec.structs.replace(config.mount, height_m=float(T_vehicle_camera[2, 3]), pitch_rad=0.0)
    return msgspec.structs.replace(config, lens=scaled(native, width_px, height_px), mount=mount)


def _recorded_on_the_bus(url: SourceUrl, stop: threading.Event) -> Iterator[Frame]:
    for piece in replayed(url, CAMERA_RAW, stop.wait):
        yield Frame(piece.stamp_ns, piece.received_ns, piece.data)


def _simulated(clock: ScenarioClock, config: CaptureConfig, report: Report, stop: threading.Event) -> Iterator[Frame]:
    """Pictures of the simulated world at the capture rate."""
    pace = Pace(1.0 / config.rate_hz, stop)
    while pace.wait():
        now_s = monotonic_s()
        stamp_ns, t_s = utc_at(now_s), clock.at(now_s)
        try:
            image = simulated.image(clock.scenario, t_s, config.width_px, config.height_px)
        except DeviceUnplugged as error:
            report.state("disconnected", f"{error}; plug the camera in")
            continue
        yield Frame(stamp_ns, utc_ns(), image)


def _recording(url: SourceUrl, config: CaptureConfig) -> tuple[Path, list[Path], float]:
    """The path, the pictures of a folder in order of name (none for a video) and the period between two."""
    path = Path(url.target).expanduser()
    period_s = 1.0 / max(url.number("fps", config.rate_hz), 1e-3)
    if path.is_dir():
        pictures = sorted(entry for entry in path.iterdir() if entry.suffix.lower() in PICTURES)
        if not pictures:
            raise ConfigError(f"source {url}: no pictures ({', '.join(sorted(PICTURES))}) in this folder")
        return path, pictures, period_s
    if not path.is_file():
        raise ConfigError(f"source {url}: no such file or folder")
    if path.suffix.lower() in PICTURES:
        return path, [path], period_s
    video = cv2.VideoCapture(str(path))
    fps = video.get(cv2.CAP_PROP_FPS)
    readable = video.isOpened()
    video.release()
    if not readable:
        raise ConfigError(f"source {url}: not a video or picture that can be read")
    return path, [], 1.0 / fps if fps > 0 and "fps" not in url.params else period_s


def _replayed(
    url: SourceUrl, path: Path, pictures: list[Path], period_s: float, stop: threading.Event
) -> Iterator[Frame]:
    """A recording at its own pace times ``rate``; once, or over and over with ``loop=1``."""
    rate = url.number("rate", 1.0)
    pace = Pace(period_s / rate if rate > 0 else 0.0, stop)
    while True:
        for image in _pictures(pictures) if pictures else _video(path):
            if not pace.wait():
                return
            stamp_ns = utc_ns()
            yield Frame(stamp_ns, stamp_ns, image)
        if not url.flag("loop"):
            log.info("%s has ended", url)
            return


def _pictures(paths: list[Path]) -> Iterator[np.ndarray]:
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise ConfigError(f"{path}: not a picture that can be read")
        yield image


def _video(path: Path) -> Iterator[np.ndarray]:
    video = cv2.VideoCapture(str(path))
    try:
        while True:
            there, image = video.read()
            if not there:
                return
            yield image
    finally:
        video.release()


def _captured(url: SourceUrl, config: CaptureConfig, report: Report, stop: threading.Event) -> Iterator[Frame]:
    """Frames of a child process; a child that ends or hangs is replaced, with a growing pause between attempts."""
    pause_s = config.retry_min_s
    while not stop.is_set():
        trouble = _obstacle(url, config)
        if trouble is None:
            try:
                for frame in _one_child(url, config, report, stop):
                    pause_s = config.retry_min_s
                    yield frame
                return
            except CaptureLost as error:
                trouble = f"{error}; {advice(url)}"
        log.warning("%s: %s; next attempt in %.1f s", url, trouble, pause_s)
        _wait_lost(f"{url}: {trouble}", pause_s, report, stop)
        pause_s = min(2 * pause_s, config.retry_max_s)


def _one_child(url: SourceUrl, config: CaptureConfig, report: Report, stop: threading.Event) -> Iterator[Frame]:
    """Frames of one child until it is lost, which is told before the child is cleared away."""
    timeout_s = config.start_timeout_s
    with CaptureChild(command(url, config), config.width_px, config.height_px) as child:
        while not stop.is_set():
            try:
                frame = child.read(timeout_s)
            except CaptureLost as error:
                report.state("disconnected", f"{url}: {error}; {advice(url)}")
                raise
            yield frame
            timeout_s = config.frame_timeout_s


def _wait_lost(reason: str, pause_s: float, report: Report, stop: threading.Event) -> None:
    """Say it again and again: a frame that was still being processed may have said "online" in between."""
    until_s = monotonic_s() + pause_s
    while True:
        report.state("disconnected", reason)
        left_s = until_s - monotonic_s()
        if left_s <= 0 or stop.wait(min(left_s, RESTATE_S)):
            return


def _obstacle(url: SourceUrl, config: CaptureConfig) -> str | None:
    """Why an attempt is not worth it, told apart: no device, or no permission."""
    path = Path(device_path(url))
    if url.scheme != "v4l2" or config.v4l2_command:
        return None
    if not path.exists():
        return f"{path} is not there; plug the camera in"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"{path} may not be read by this user; add the user to the group video"
    return None


class Pace:
    """Gives a loop a steady period; time lost is not caught up."""

    def __init__(self, period_s: float, stop: threading.Event) -> None:
        self._period_s = period_s
        self._stop = stop
        self._next_s = monotonic_s()

    def wait(self) -> bool:
        """Wait for the next turn; False when it is time to stop."""
        now_s = monotonic_s()
        if self._stop.wait(max(self._next_s - now_s, 0.0)):
            return False
        self._next_s = max(self._next_s, now_s) + self._period_s
        return True
