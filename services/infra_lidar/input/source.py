"""Where frames come from. Opens files, waits and reads the clock, as ``packets.py`` and ``live_packets.py`` do.

========================================  ==========================================================
``sim:crossing?t0=3``                     the simulated world, 10 revolutions a second
``file:FOLDER?rate=1&loop=1``             frames ``.npz .bin .npy .pcd .ply .las .laz``, in the order of names; of
                                          ``.bin`` and ``.npy`` ``columns=x,y,z,...``
``file:RECORDING.pcap``                   packets of a sensor as captured
``file:BAG?topic=/points``                ROS bag (``.db3``, ``.mcap``, ``.bag`` or a folder): clouds or packets
``file:CAPTURE?from=ADDRESS&port=2368``   one of several sensors in a capture (pcap or pcapng, gzipped or not)
``mcap:RECORDING?rate=1``                 what ``spotter record --raw infra_lidar`` has recorded
``velodyne://:2368``                      live UDP packets
``ouster://HOST`` / ``hesai://HOST``      the same; the sensor is asked for its metadata or calibration
``robosense://HOST``                      the same; the beam angles are waited for on its DIFOP port
``ros2:/TOPIC?type=TYPE&domain=0``        clouds or packets of a ROS 2 driver, see docs/ros2.md
========================================  ==========================================================
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.bus.status import Report
from common.clock import monotonic_s, utc_at, utc_ns
from common.config import ConfigError
from common.pacing import Playback, ticks
from common.recording.raw import MCAP_PARAMETERS, fitted_as_recorded
from common.ros2.source import ROS2_PARAMETERS, require_rosbags
from common.source_url import SourceUrl, parse_source
from common.topics import INFRA_RAW
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.bag_frames import bag_frames
from services.infra_lidar.input.bags import is_bag
from services.infra_lidar.input.live_packets import live_packets
from services.infra_lidar.input.packets import Frame, Recorded, recorded_revolutions
from services.infra_lidar.input.point_files import (
    FRAME_SUFFIXES,
    WITHOUT_NAMES,
    FrameError,
    frame_files,
    others_beside,
    parse_frame,
)
from services.infra_lidar.input.raw import recorded_frames

if TYPE_CHECKING:
    from spotter_sim.scenario_clock import ScenarioClock

log = logging.getLogger(__name__)

SCHEMES = {
    "sim": ("t0", "columns", "rate_hz"),
    "file": ("rate", "loop", "cut", "metadata", "calibration", "firetimes", "columns", "from", "port", "topic"),
    "mcap": MCAP_PARAMETERS,
    "velodyne": ("cut", "from"),
    "ouster": ("metadata", "port", "from", "group"),
    "hesai": ("calibration", "firetimes", "cut", "port", "from", "group"),
    "robosense": ("calibration", "difop", "cut", "port", "from", "group"),
    "ros2": (*ROS2_PARAMETERS, "cut", "metadata", "calibration", "firetimes", "sensor"),
}
NOMINAL_PERIOD_S = 0.1
MAX_NAMED = 5  # files of a folder without frames
LONGEST_GAP_S = 0.5  # frames farther apart are single shots, which are played at the nominal rate


def open_source(config: InfraLidarConfig, report: Report) -> Iterator[tuple[int, Frame]]:
    """Frames with the UTC nanoseconds of their measurement, as they come.

    Raises:
        ConfigError: the source does not exist or is not of a known kind.
    """
    url = parse_source(config.source, SCHEMES)
    if url.scheme == "sim":
        return _simulated(url)
    if url.scheme == "file":
        return _file(url, report)
    if url.scheme == "mcap":
        return recorded_frames(url)
    if url.scheme == "ros2":
        return _ros(url, config, report)
    return live_packets(url, report)


def _ros(url: SourceUrl, config: InfraLidarConfig, report: Report) -> Iterator[tuple[int, Frame]]:
    require_rosbags(url)
    from services.infra_lidar.input.ros2 import ros_frames

    return ros_frames(url, config.zenoh, report)


def surveyed_pose(config: InfraLidarConfig) -> tuple[float, ...]:
    """T_map_sensor as configured; the simulator, and a recording of it, know where its own pole stands."""
    url = parse_source(config.source, SCHEMES)
    if url.scheme == "mcap":
        return fitted_as_recorded(config, url, INFRA_RAW).T_map_sensor
    if config.T_map_sensor or url.scheme != "sim":
        return config.T_map_sensor
    from spotter_sim import world

    pole = world.scenario_named(url.target or "crossing").scene.T_map_pole
    return tuple(float(value) for value in pole.ravel())


def _simulated(url: SourceUrl) -> Iterator[tuple[int, Frame]]:
    """The pole's sensor in a scenario, computed as fast as this machine can, at most at the nominal rate."""
    from spotter_sim.scenario_clock import ScenarioClock  # the world is built only where it is needed

    columns, rate_hz = url.number("columns", 1800), url.number("rate_hz", 10.0)
    if columns < 1.0:
        raise ConfigError(f"source {url}: columns={columns:g}: expected 1 or more")
    if rate_hz <= 0.0:
        raise ConfigError(f"source {url}: rate_hz={rate_hz:g}: expected more than 0")
    return _revolutions(ScenarioClock(url, "crossing"), int(columns), 1.0 / rate_hz)


def _revolutions(clock: ScenarioClock, columns: int, period_s: float) -> Iterator[tuple[int, Frame]]:
    from spotter_sim import lidar128

    first_s = monotonic_s() + period_s - utc_ns() * 1e-9 % period_s  # all poles turn together
    for due_s in ticks(period_s, first_s):
        scan = lidar128.scan(clock.scenario, clock.at(due_s), columns)
        points = np.column_stack([scan.xyz, scan.intensity, scan.ring]).astype(np.float32)
        yield utc_at(due_s), Frame(points, utc_ns())


def _file(url: SourceUrl, report: Report) -> Iterator[tuple[int, Frame]]:
    path = Path(url.target).expanduser()
    if not path.exists():
        raise ConfigError(f"source {url}: {path} does not exist")
    names = [] if is_bag(path) or not path.is_dir() else frame_files(path)
    suffix = (names[0] if names else path).suffix.lower()
    if "columns" in url.params and suffix not in WITHOUT_NAMES:
        what = suffix or path.name
        raise ConfigError(f"source {url}: columns= is for {' and '.join(WITHOUT_NAMES)}, not for {what}")
    if is_bag(path):
        return _play(url, bag_frames(path, url, report))
    if path.is_dir():
        if not names:
            there = ", ".join(sorted(p.name for p in path.iterdir())[:MAX_NAMED]) or "nothing"
            raise ConfigError(f"source {url}: no {', '.join(FRAME_SUFFIXES)} frames in {path}; it holds {there}")
        others = others_beside(path, suffix)
        if others:
            log.warning("%s: %d frames %s are read, not %s", path, len(names), suffix, others)
        return _play(url, _frames(names, url, report, keep=url.flag("loop") and len(names) <= 20))
    if suffix in FRAME_SUFFIXES:
        return _play(url, _frames([path], url, report, keep=True))
    return _play(url, recorded_revolutions(path, url, report))


def _play(url: SourceUrl, recording: Callable[[], Iterator[Recorded]]) -> Iterator[tuple[int, Frame]]:
    """A recording at its own pace times ``rate`` (0: as fast as frames are taken), repeated with loop=1."""
    rate, playback, stamp_ns = url.number("rate", 1.0), Playback(), utc_ns()
    while True:
        previous_s: float | None = None
        anything = False
        for stamp_s, frame in recording():
            gap_s = _gap_s(previous_s, stamp_s)
            stamp_ns = utc_at(playback.next_s(gap_s / rate)) if rate > 0.0 else stamp_ns + round(gap_s * 1e9)
            previous_s, anything = stamp_s, True
            yield stamp_ns, replace(frame, received_ns=utc_ns() if rate else stamp_ns)
        if not anything:
            raise ConfigError(f"source {url}: no frame in it can be read")
        if not url.flag("loop"):
            return


def _frames(names: list[Path], url: SourceUrl, report: Report, keep: bool) -> Callable[[], Iterator[Recorded]]:
    """Files as recorded frames; unreadable ones are counted and left out. ``keep``: hold them in memory."""
    kept: dict[Path, Recorded] = {}
    columns = tuple(name.strip() for name in url.params.get("columns", "").split(",") if name.strip())

    def read() -> Iterator[Recorded]:
        """The frames in order; one that cannot be read is named, counted and left out."""
        for path in names:
            recorded = kept.get(path)
            if recorded is None:
                try:
                    parsed = parse_frame(path.name, path.read_bytes(), columns)
                except FrameError as error:
                    log.warning("%s", error)
                    report.bad_input("unreadable frame")
                    continue
                recorded = parsed.stamp_s, Frame(parsed.points, 0)
            if keep:
                kept[path] = recorded
            yield recorded

    return read


def _gap_s(previous_s: float | None, stamp_s: float | None) -> float:
    if previous_s is None or stamp_s is None or not 0.0 < stamp_s - previous_s <= LONGEST_GAP_S:
        return NOMINAL_PERIOD_S
    return stamp_s - previous_s
