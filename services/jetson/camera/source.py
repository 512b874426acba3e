"""Where pictures come from. With ``capture.py`` and ``child.py`` the part that opens devices and reads the clock.

sim:crossing?t0=0        the simulated camera
file:PATH?rate=1&loop=1  a video, a picture, or a folder of pictures (fps=..); rate=0 = as fast as it is read
mcap:PATH?rate=1&loop=1  the pictures of ``spotter record --raw camera``; rate=0 as above
v4l2:0  v4l2:/dev/video0 a USB camera          } through a child process
csi:0                    a camera on the CSI port }
ros2:/image?type=TYPE    the pictures of a ROS 2 driver, see docs/ros2.md
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import cv2
import msgspec
import numpy as np

from common.bus.status import Report
from common.clock import monotonic_s, utc_at, utc_ns
from common.config import ConfigError
from common.pacing import steady
from common.recording.raw import MCAP_PARAMETERS, first_piece, fitted_as_recorded, recorded_motion, replayed
from common.ros2.source import ROS2_PARAMETERS, require_rosbags
from common.source_url import SourceUrl, parse_source
from common.topics import CAMERA_RAW
from services.jetson.camera.capture import captured
from services.jetson.camera.config import CameraConfig, CaptureConfig, LensConfig, no_network
from services.jetson.camera.frames import Frame, Source
from services.jetson.camera.gstreamer import command
from services.jetson.camera.upright import turned
from spotter_sim import camera as simulated
from spotter_sim.scenario_clock import ScenarioClock
from spotter_sim.world import DeviceUnplugged, T_vehicle_camera

log = logging.getLogger("source")

SCHEMES = {
    "sim": ("t0",),
    "file": ("rate", "loop", "fps"),
    "csi": (),
    "v4l2": (),
    "mcap": MCAP_PARAMETERS,
    "ros2": ROS2_PARAMETERS,
}
PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".webp"}


def open_source(config: CameraConfig, report: Report) -> tuple[Source, bool]:
    """The source of the configuration, to be run by ``NewestFrames``, and whether no frame of it may be skipped.

    Its pictures are upright: those of cameras and files are turned as configured, the others are upright already.

    Raises:
        ConfigError: unknown scheme or parameter, no such file or scenario.
    """
    url = parse_source(config.source, SCHEMES)
    if url.scheme == "sim":
        return partial(_simulated, ScenarioClock(url), config.capture, report), False
    if url.scheme == "file":
        source: Source = partial(_replayed, url, *_recording(url, config.capture))
        return turned(source, config.capture), url.number("rate", 1.0) == 0
    if url.scheme == "mcap":
        return partial(_recorded_on_the_bus, url), url.number("rate", 1.0) == 0
    if url.scheme == "ros2":
        require_rosbags(url)
        from services.jetson.camera.ros2 import ros_pictures

        return turned(ros_pictures(url, config.zenoh, report), config.capture), False
    command(url, config.capture)  # a wrong placeholder is told now, not in the capture thread
    return turned(partial(captured, url, config.capture, report), config.capture), False


def fitted(config: CameraConfig) -> CameraConfig:
    """The configuration with what the source knows of itself.

    The simulated camera knows its own lens and place; a single photograph is still by nature, not frozen, and
    a compressed video keeps parts that do not move. A real camera
    has everything from the configuration.

    Raises:
        ConfigError: a recording of a real camera, and no network is configured for it.
    """
    scheme, _, target = config.source.partition(":")
    if scheme == "file":
        still = Path(target.partition("?")[0]).suffix.lower() in PICTURES
        after_s = 0.0 if still else config.health.frozen_after_s
        health = msgspec.structs.replace(config.health, frozen_after_s=after_s, part_frozen_after_s=0.0)
        return msgspec.structs.replace(config, health=health)
    if scheme == "mcap":
        url = parse_source(config.source, SCHEMES)
        if not config.detector.model and first_piece(url, CAMERA_RAW).source_kind not in ("simulated", "unknown"):
            raise ConfigError(no_network(config.source))
        return fitted_as_recorded(config, url, CAMERA_RAW)
    if scheme != "sim":
        return config
    width_px, height_px = config.capture.width_px, config.capture.height_px
    native = LensConfig()
    lens = LensConfig(  # the simulated picture of another shape is squeezed
        width_px=width_px,
        height_px=height_px,
        f_x_px=simulated.F_Y_PX * width_px / native.width_px,
        f_y_px=simulated.F_Y_PX * height_px / native.height_px,
        c_x_px=width_px / 2,
        c_y_px=height_px / 2,
    )
    mount = msgspec.structs.replace(config.mount, height_m=float(T_vehicle_camera[2, 3]), pitch_rad=0.0)
    return msgspec.structs.replace(config, lens=lens, mount=mount)


def _recorded_on_the_bus(url: SourceUrl, stop: threading.Event) -> Iterator[Frame]:
    for piece in replayed(url, CAMERA_RAW, stop.wait):
        yield Frame(piece.stamp_ns, piece.received_ns, piece.data, recorded_motion(piece))


def _simulated(clock: ScenarioClock, config: CaptureConfig, report: Report, stop: threading.Event) -> Iterator[Frame]:
    """Pictures of the simulated world at the capture rate."""
    for _ in steady(1.0 / config.rate_hz, stop):
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
    """A recording at its own pace times ``rate``; once, or over and over with ``loop=1``.

    Raises:
        ConfigError: a picture that cannot be read, or a video of which none can.
    """
    rate = url.number("rate", 1.0)
    turns = steady(period_s / rate if rate > 0 else 0.0, stop)
    while True:
        came = False
        for image in _pictures(pictures) if pictures else _video(path):
            if next(turns, None) is None:
                return
            stamp_ns, came = utc_ns(), True
            yield Frame(stamp_ns, stamp_ns, image)
        if not came:
            raise ConfigError(f"source {url}: not one picture of this video can be read; is the file cut or damaged?")
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
