"""Where frames come from. The only file of this service that opens files and sockets, waits, or reads the clock.

========================================  ==========================================================
``sim:crossing?t0=3``                     the simulated world, 10 revolutions a second
``file:FOLDER?rate=1&loop=1``             frames ``.npz``, ``.pcd`` or ``.bin``, in the order of names
``file:RECORDING.pcap`` / ``.db3``        Ouster or Velodyne packets as captured, ROS 2 bag of Velodyne packets
``velodyne://:2368`` / ``ouster://HOST``  live UDP packets
========================================  ==========================================================
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from common.clock import monotonic_s, utc_ns
from common.config import ConfigError
from common.source_url import SourceUrl, parse_source
from common.status import Report
from services.infra_lidar.blindness import FrameQuality
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.parser import FileFrame, FrameError, parse_frame

SCHEMES = {
    "sim": ("t0", "columns", "rate_hz"),
    "file": ("rate", "loop"),
    "velodyne": (),
    "ouster": (),
}
NOMINAL_PERIOD_S = 0.1
LONGEST_GAP_S = 0.5  # frames farther apart are single pictures of one place: shown at the nominal rate
FRAME_SUFFIXES = (".npz", ".pcd", ".bin")


@dataclass(frozen=True)
class Frame:
    """points: (N, 3..5) float32 metres, sensor frame (x, y, z, intensity, ring). received_ns: UTC when it was whole."""

    points: np.ndarray
    received_ns: int
    quality: FrameQuality = field(default_factory=FrameQuality)


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
    raise ConfigError(f"source {config.source!r}: live packets are not available")


def _simulated(url: SourceUrl) -> Iterator[tuple[int, Frame]]:
    """The pole's sensor in a scenario, computed as fast as this machine can, at most at the nominal rate."""
    from common.sim import lidar128, world  # the world is built only for those who look at it

    scenario, columns = url.target or "crossing", int(url.number("columns", 1800))
    period_ns = round(1e9 / url.number("rate_hz", 10.0))
    t0_s = url.number("t0", 0.0) if "t0" in url.params else None
    started_ns = utc_ns()
    due_ns = started_ns - started_ns % period_ns + period_ns
    while True:
        _wait_until(due_ns)
        scan = lidar128.scan(scenario, world.scenario_time(scenario, due_ns, t0_s, started_ns=started_ns), columns)
        points = np.column_stack([scan.xyz, scan.intensity, scan.ring]).astype(np.float32)
        yield due_ns, Frame(points, utc_ns())
        now_ns = utc_ns()
        due_ns = max(due_ns + period_ns, now_ns - now_ns % period_ns)


def _file(url: SourceUrl, report: Report) -> Iterator[tuple[int, Frame]]:
    path = Path(url.target)
    if not path.exists():
        raise ConfigError(f"source {url}: {path} does not exist")
    if path.is_dir():
        return _folder(url, path, report)
    raise ConfigError(f"source {url}: {path.name} is no folder of frames")


def _folder(url: SourceUrl, folder: Path, report: Report) -> Iterator[tuple[int, Frame]]:
    """A folder's frames at recorded pace times ``rate`` (0: as fast as they are taken), again and again with loop=1."""
    names = _frame_names(folder)
    if not names:
        raise ConfigError(f"source {url}: no {', '.join(FRAME_SUFFIXES)} frames in {folder}")
    rate, clock = url.number("rate", 1.0), _Playback()
    cache: dict[Path, FileFrame] = {}
    while True:
        previous_s: float | None = None
        for path in names:
            try:
                frame = cache.get(path) or parse_frame(path.name, path.read_bytes())
            except FrameError as error:
                report.bad_input(f"frame: {str(error)[:60]}")
                continue
            if url.flag("loop") and len(names) <= 20:
                cache[path] = frame
            stamp_ns = clock.next(_gap_s(previous_s, frame.stamp_s), rate)
            previous_s = frame.stamp_s
            yield stamp_ns, Frame(frame.points, utc_ns() if rate else stamp_ns)
        if not url.flag("loop"):
            return
        if not cache and not previous_s:
            raise ConfigError(f"source {url}: no frame in {folder} can be read")


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
        self._stamp_ns = max(self._stamp_ns + 1, utc_ns() - round(max(late_s, 0.0) * 1e9))
        return self._stamp_ns


def _wait_until(due_ns: int) -> None:
    left_s = (due_ns - utc_ns()) / 1e9
    if left_s > 0:
        time.sleep(min(left_s, 1.0))
