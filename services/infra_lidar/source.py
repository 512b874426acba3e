"""Where frames come from. The only file of this service that opens files and sockets, waits, or reads the clock.

========================================  ==========================================================
``sim:crossing?t0=3``                     the simulated world, 10 revolutions a second
``file:FOLDER?rate=1&loop=1``             frames ``.npz``, ``.pcd`` or ``.bin``, in the order of names
``file:RECORDING.pcap`` / ``.db3``        Ouster or Velodyne packets as captured, ROS 2 bag of Velodyne packets
``mcap:RECORDING?rate=1``                 what ``spotter record --raw infra_lidar`` has recorded
``velodyne://:2368`` / ``ouster://HOST``  live UDP packets
========================================  ==========================================================
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.clock import monotonic_s, utc_at, utc_ns
from common.config import ConfigError
from common.recording.raw import MCAP_PARAMETERS, fitted_as_recorded
from common.source_url import SourceUrl, parse_source
from common.status import Report
from common.topics import INFRA_RAW
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.packet_source import Frame, Recorded, live_packets, recorded_revolutions
from services.infra_lidar.parser import FrameError, parse_frame
from services.infra_lidar.raw import recorded_frames

if TYPE_CHECKING:
    from common.sim.scenario_clock import ScenarioClock

log = logging.getLogger(__name__)

SCHEMES = {
    "sim": ("t0", "columns", "rate_hz"),
    "file": ("rate", "loop", "cut", "metadata"),
    "mcap": MCAP_PARAMETERS,
    "velodyne": ("cut",),
    "ouster": ("metadata", "port"),
}
NOMINAL_PERIOD_S = 0.1
LONGEST_GAP_S = 0.5  # frames farther apart are single pictures of one place: shown at the nominal rate
FRAME_SUFFIXES = (".npz", ".pcd", ".bin")


def open_source(config: InfraLidarConfig, report: Report) -> Iterator[tuple[int, Frame]]:
    """Frames with the UTC nanoseconds of their measurement, as they come.

    Raises:
        ConfigError: the source does not exist or is not of a kind we know.
    """
    url = parse_source(config.source, SCHEMES)
    if url.scheme == "sim":
        return _simulated(url)
    if url.scheme == "file":
        return _file(url, report)
    if url.scheme == "mcap":
        return recorded_frames(url)
    return live_packets(url, report)


def surveyed_pose(config: InfraLidarConfig) -> tuple[float, ...]:
    """T_map_sensor as configured; the simulator, and a recording of it, know where its own pole stands."""
    url = parse_source(config.source, SCHEMES)
    if url.scheme == "mcap":
        return fitted_as_recorded(config, url, INFRA_RAW).T_map_sensor
    if config.T_map_sensor or url.scheme != "sim":
        return config.T_map_sensor
    from common.sim import world

    pole = world.scenario_named(url.target or "crossing").scene.T_map_pole
    return tuple(float(value) for value in pole.ravel())


def _simulated(url: SourceUrl) -> Iterator[tuple[int, Frame]]:
    """The pole's sensor in a scenario, computed as fast as this machine can, at most at the nominal rate."""
    from common.sim.scenario_clock import ScenarioClock  # the world is built only for those who look at it

    return _turns(ScenarioClock(url, "crossing"), int(url.number("columns", 1800)), 1.0 / url.number("rate_hz", 10.0))


def _turns(clock: ScenarioClock, columns: int, period_s: float) -> Iterator[tuple[int, Frame]]:
    from common.sim import lidar128

    due_s = monotonic_s() + period_s - utc_ns() * 1e-9 % period_s  # all poles turn together
    while True:
        time.sleep(max(0.0, due_s - monotonic_s()))
        scan = lidar128.scan(clock.scenario, clock.at(due_s), columns)
        points = np.column_stack([scan.xyz, scan.intensity, scan.ring]).astype(np.float32)
        yield utc_at(due_s), Frame(points, utc_ns())
        missed = int((monotonic_s() - due_s) / period_s)
        due_s += max(1, missed) * period_s


def _file(url: SourceUrl, report: Report) -> Iterator[tuple[int, Frame]]:
    path = Path(url.target).expanduser()
    if not path.exists():
        raise ConfigError(f"source {url}: {path} does not exist")
    if path.is_dir():
        names = _frame_names(path)
        if not names:
            raise ConfigError(f"source {url}: no {', '.join(FRAME_SUFFIXES)} frames in {path}")
        return _play(url, _frames(names, report, keep=url.flag("loop") and len(names) <= 20))
    if path.suffix in FRAME_SUFFIXES:
        return _play(url, _frames([path], report, keep=True))
    return _play(url, recorded_revolutions(path, url, report))


def _play(url: SourceUrl, recording: Callable[[], Iterator[Recorded]]) -> Iterator[tuple[int, Frame]]:
    """A recording at its own pace times ``rate`` (0: as fast as frames are taken), again and again with loop=1."""
    rate, clock = url.number("rate", 1.0), _Playback()
    while True:
        previous_s: float | None = None
        anything = False
        for frame in recording():
            stamp_ns = clock.next(_gap_s(previous_s, frame.stamp_s), rate)
            previous_s, anything = frame.stamp_s, True
            received_ns = utc_ns() if rate else stamp_ns
            yield stamp_ns, Frame(frame.returns, received_ns, frame.quality, frame.packets, frame.metadata)
        if not anything:
            raise ConfigError(f"source {url}: no frame in it can be read")
        if not url.flag("loop"):
            return


def _frames(names: list[Path], report: Report, keep: bool) -> Callable[[], Iterator[Recorded]]:
    """Files as recorded frames; those that cannot be read are counted and left out. ``keep``: in memory."""
    kept: dict[Path, Recorded] = {}

    def read() -> Iterator[Recorded]:
        for path in names:
            frame = kept.get(path)
            if frame is None:
                try:
                    parsed = parse_frame(path.name, path.read_bytes())
                except FrameError as error:
                    log.warning("%s", error)
                    report.bad_input("unreadable frame")
                    continue
                frame = Recorded(parsed.points, parsed.stamp_s)
            if keep:
                kept[path] = frame
            yield frame

    return read


def _frame_names(folder: Path) -> list[Path]:
    """The frames of the first suffix that the folder holds; ``background.npz`` is a model, not a frame."""
    for suffix in FRAME_SUFFIXES:
        names = sorted(p for p in folder.iterdir() if p.suffix == suffix and not p.name.startswith("background"))
        if names:
            return names
    return []


def _gap_s(previous_s: float | None, stamp_s: float | None) -> float:
    if previous_s is None or stamp_s is None or not 0.0 < stamp_s - previous_s <= LONGEST_GAP_S:
        return NOMINAL_PERIOD_S
    return stamp_s - previous_s


class _Playback:
    """Hands out stamps: now plus what was recorded. Late frames are not skipped; the schedule moves instead."""

    def __init__(self) -> None:
        self._stamp_ns = utc_ns()
        self._due_s = monotonic_s()

    def next(self, gap_s: float, rate: float) -> int:
        """Wait until the frame is due and return its stamp, UTC nanoseconds."""
        if rate <= 0.0:
            self._stamp_ns += round(gap_s * 1e9)
            return self._stamp_ns
        self._due_s += gap_s / rate
        late_s = monotonic_s() - self._due_s
        if late_s > gap_s:
            self._due_s += late_s
        elif late_s < 0.0:
            time.sleep(-late_s)
        self._stamp_ns = utc_at(self._due_s)
        return self._stamp_ns
