"""One revolution -> what stands in the three lanes ahead, and whether the sensor can see.

No Zenoh, no clock, no file: time is the scan's stamp.
"""

from __future__ import annotations

import math

import numpy as np

from common.messages import LaneLayout, LaserScan, LidarZone, LidarZones, worst
from services.jetson.lidar.config import LidarConfig, ZonesSection
from services.jetson.lidar.filters import Fate, Returns, judge, returns_of
from services.jetson.lidar.health import Evidence, HealthMonitor, could_see, covered_by_something_near, evidence
from services.jetson.lidar.persistence import LanePersistence, Silence
from services.jetson.lidar.zones import LANES, Measured, level_of, measure

RATE_SMOOTHING = 0.2  # share of the newest scan in the published rate


class LidarPipeline:
    """Keeps what persistence and health need from earlier scans.

    After ``process``, ``fate`` holds the ``Fate`` of each beam in the scan's own order.
    """

    def __init__(self, config: LidarConfig) -> None:
        self._config = config
        self._lanes = [LanePersistence(config.persistence) for _ in LANES]
        self._silence = Silence(config.persistence)
        self._health = HealthMonitor(config.health, config.filter, config.zones.fov_deg)
        self._layout = layout_of(config.zones)
        self._last_ns: int | None = None
        self._period_s = 0.0
        self.fate = np.empty(0, np.int64)

    def process(self, stamp_ns: int, scan: LaserScan) -> LidarZones:
        """Zones after the revolution that ended at ``stamp_ns``; stamps must rise."""
        config = self._config
        # After a silence nothing is known: neither the old alarm nor its absence
        if self._silence.ended(stamp_ns):
            for lane in self._lanes:
                lane.forget()

        # Order the beams and place their returns in the vehicle's frame
        returns = returns_of(scan, config.mounting)

        # Decide which returns are believed: range, vehicle's own body, confidence, neighbours
        fate = judge(returns, config.filter, config.mounting)

        # The nearest thing in each lane that enough returns vouch for
        measured = measure(returns, fate == Fate.USED, config.zones)

        # Could the last fifteen scans see, and could this one?
        seen = evidence(returns, fate, config.zones.fov_deg, config.health.sectors, _motor(scan))
        reason = self._health.update(stamp_ns, seen)
        may_clear = self._may_clear(seen, returns, degraded=bool(reason))

        reason = reason or self._silence.reason(may_clear or any(one.nearest_m is not None for one in measured))

        # Agree over several scans, in each lane and for each band
        zones = [self._agree(lane, stamp_ns, one, may_clear) for lane, one in zip(self._lanes, measured, strict=True)]

        self.fate = np.empty_like(fate)
        self.fate[returns.order] = fate
        return self._message(stamp_ns, scan, zones, measured, reason)

    def _may_clear(self, seen: Evidence, returns: Returns, degraded: bool) -> bool:
        """A scan that could not have seen an obstacle says nothing about its absence, until the sensor is called
        degraded; so covering the lens does not end an alarm, and an open field ends it after 1.5 s."""
        if could_see(seen, returns, self._config.zones.fov_deg, self._config.health):
            return True
        return degraded and not covered_by_something_near(seen, self._config.health)

    def _agree(self, lane: LanePersistence, stamp_ns: int, measured: Measured, may_clear: bool) -> LidarZone:
        """The lane after persistence."""
        raw_m = math.inf if measured.nearest_m is None else measured.nearest_m
        if measured.nearest_m is not None or may_clear:
            lane.update(stamp_ns, raw_m)
        level = level_of(lane.agreed_m, self._config.zones)
        if math.isinf(lane.agreed_m):
            return LidarZone(nearest_m=None, points=0, level=level)
        # The freshest distance that does not contradict the level
        fresh = raw_m <= self._config.zones.look_ahead_m and level_of(raw_m, self._config.zones) == level
        return LidarZone(nearest_m=raw_m if fresh else lane.agreed_m, points=measured.points, level=level)

    def _message(
        self, stamp_ns: int, scan: LaserScan, zones: list[LidarZone], measured: list[Measured], reason: str
    ) -> LidarZones:
        raw = [math.inf if one.nearest_m is None else one.nearest_m for one in measured]
        return LidarZones(
            stamp_ns=stamp_ns,
            frame_id=scan.frame_id or "lidar",
            received_ns=scan.received_ns,
            state="degraded" if reason else "online",
            reason=reason,
            left=zones[0],
            centre=zones[1],
            right=zones[2],
            level=worst(*(zone.level for zone in zones)),
            raw_level=level_of(min(raw), self._config.zones),
            scan_hz=self._scan_hz(stamp_ns),
            layout=self._layout,
        )

    def _scan_hz(self, stamp_ns: int) -> float:
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None or stamp_ns <= last_ns:
            return 1.0 / self._period_s if self._period_s else 0.0
        period_s = (stamp_ns - last_ns) * 1e-9
        self._period_s += (period_s - self._period_s) * (RATE_SMOOTHING if self._period_s else 1.0)
        return 1.0 / self._period_s


def _motor(scan: LaserScan) -> str:
    return scan.reason if scan.state == "degraded" else ""


def layout_of(zones: ZonesSection) -> LaneLayout:
    """The lanes and lines in use, for viewers."""
    return LaneLayout(
        centre_width_m=zones.centre_width_m,
        side_width_m=zones.side_width_m,
        look_ahead_m=zones.look_ahead_m,
        imminent_m=zones.imminent_m,
        caution_m=zones.caution_m,
    )
