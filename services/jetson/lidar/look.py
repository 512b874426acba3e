"""What the lidar shows: turns and returns a second, and where the nearest return is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from common.bus.look import Look, PeriodSamples, collect
from common.messages import LaserScan, LidarZones
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.source import open_source


def looks(config: LidarConfig, seconds: float) -> Iterator[Look]:
    """One ``Look`` a period, over the turns that came in it.

    Raises:
        ConfigError: the source cannot be opened as it is written.
    """
    pipeline = LidarPipeline(config)
    for seen in collect(lambda report: open_source(config, report), seconds):
        zones = [(scan, pipeline.process(stamp_ns, scan)) for stamp_ns, scan in seen.items]
        yield describe(seen, zones) if zones else seen.nothing("complete turn")


def describe(seen: PeriodSamples[tuple[int, LaserScan]], zones: list[tuple[LaserScan, LidarZones]]) -> Look:
    """The figures of one period, with the newest turn's nearest return."""
    scan, newest = zones[-1]
    back = scan.ranges_m > 0
    nearest = "no return at all"
    if back.any():
        at = int(np.argmin(np.where(back, scan.ranges_m, np.inf)))
        nearest = f"nearest {scan.ranges_m[at]:.2f} m at {np.degrees(scan.angles_rad[at]):+.0f} deg"
    packets = seen.status.counters.get("packets", 0)
    bad = f", {seen.status.bad_input} of {packets} packets bad" if seen.status.bad_input else ""
    turns = f"{seen.rate_hz:.1f} turns a second of {len(scan.ranges_m)} returns, {nearest}, {newest.level}{bad}"
    if newest.state == "online":
        return Look(sees=True, what=turns)
    return Look(
        sees=False, what=f"{turns}; {newest.reason}", do="see the reason: what covers it, or what is its motor doing?"
    )
