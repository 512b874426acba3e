"""One revolution -> what stands in the three lanes ahead, and whether the sensor can see.

No Zenoh, no clock, no file: time is the scan's stamp.
"""

from __future__ import annotations

import math

import numpy as np

from common.messages import LaserScan, Level, LidarZone, LidarZones, Motion, worst
from common.path import Path, is_driving
from services.jetson.lidar.config import LidarConfig, ZonesSection
from services.jetson.lidar.filters import RejectReason, Returns, judge, returns_of
from services.jetson.lidar.health import Evidence, HealthMonitor, could_see, covered_by_something_near, evidence, looked
from services.jetson.lidar.lead import Lead
from services.jetson.lidar.lines import Lines
from services.jetson.lidar.movers import Movers
from services.jetson.lidar.persistence import LanePersistence, Silence
from services.jetson.lidar.way import CURVED_PER_M, along_the_way, cover_of, driven_m, layout_of, zones_for
from services.jetson.lidar.zones import LANES, LaneScanner, Measured, level_of

RATE_SMOOTHING = 0.2  # share of the newest scan in the published rate


class LidarPipeline:
    """Keeps what persistence and health need from earlier scans.

    After ``process``, ``reject_reason`` holds the ``RejectReason`` of each beam in the scan's own order.
    """

    def __init__(self, config: LidarConfig) -> None:
        self._config = config
        self._lanes = [LanePersistence(config.persistence) for _ in LANES]
        self._shown_per_m = [0.0 for _ in LANES]  # curvature of the way when a lane last showed something
        self._levels: list[Level] = ["SAFE" for _ in LANES]
        self._scanner = LaneScanner(config.zones)
        self._lines = Lines(config.zones, config.filter)
        self._movers = Movers(config)
        self._lead = Lead(config)
        self._lead_mps = 0.0
        self._silence = Silence(config.persistence)
        self._health = HealthMonitor(config.health, config.filter, config.zones.fov_deg)
        self._zones = config.zones  # in use: the bands grow with the vehicle's speed
        self._carried_ns: int | None = None
        self._before: Returns | None = None  # the scan before, for what is too thin for one
        self._last_ns: int | None = None
        self._period_s = 0.0
        self.reject_reason = np.empty(0, np.int64)

    def process(self, stamp_ns: int, scan: LaserScan, motion: Motion | None = None) -> LidarZones:
        """Zones after the revolution that ended at ``stamp_ns``; stamps must rise. ``motion`` None = unknown."""
        config = self._config
        self._zones = zones_for(config, motion)
        # After a silence nothing is known: neither the old alarm nor its absence
        if self._silence.ended(stamp_ns):
            self._scanner.forget()
            self._lines.forget()
            self._before = None
            for lane in self._lanes:
                lane.forget()

        # Order the beams and place their returns in the vehicle's frame
        returns = returns_of(scan, config.mounting)

        # Decide which returns are believed: range, vehicle's own body, confidence, neighbours
        reject_reason = judge(returns, config.filter, config.mounting, self._before)
        self._before = returns

        # Along the vehicle's way, and what was seen before has come nearer by as much as it has driven
        ahead = along_the_way(returns, config, motion)
        path = Path(config.path, motion) if is_driving(motion, config.path) else None
        self._carry(stamp_ns, motion)

        # The nearest thing in each lane that enough returns vouch for, in this scan or over the last ones
        seen = evidence(returns, reject_reason, config.zones.fov_deg, config.health.sectors, _motor(scan))
        measured = self._measure(ahead, reject_reason, seen, path)

        # Who drives ahead of us needs less room than what stands
        self._lead_mps = self._lead.update(stamp_ns, measured[LANES.index("centre")].nearest_m, motion)
        self._zones = zones_for(config, motion, self._lead_mps)

        # Could the last fifteen scans see, and could this one?
        reason = self._health.update(stamp_ns, seen)
        may_clear = self._may_clear(seen, returns, degraded=bool(reason))

        reason = reason or self._silence.reason(may_clear or any(one.nearest_m is not None for one in measured))

        # Agree over several scans, in each lane and for each band
        zones = [
            self._agree(number, stamp_ns, one, may_clear, path.curvature_per_m if path else 0.0)
            for number, one in enumerate(measured)
        ]

        # Who moves beside the way and will be in it
        used = reject_reason == RejectReason.USED
        zones[LANES.index("centre")] = self._with_movers(zones, *self._movers.update(stamp_ns, returns, used, motion))

        self.reject_reason = np.empty_like(reject_reason)
        self.reject_reason[returns.order] = reject_reason
        message = self._message(stamp_ns, scan, zones, measured, reason)
        message.motion, message.cover = motion, cover_of(returns, reject_reason, config, motion)
        message.layout = layout_of(self._zones, path)
        return message

    def _bands(self) -> tuple[ZonesSection, ZonesSection, ZonesSection]:
        """Of the left, centre and right lane: what a stop needs is asked of the vehicle's own way alone."""
        return self._config.zones, self._zones, self._config.zones

    def _with_movers(self, zones: list[LidarZone], level: Level, ahead_m: float) -> LidarZone:
        """The centre lane, with what will be in it if that is worse than all that is in a lane already."""
        centre = zones[LANES.index("centre")]
        before = worst(*(zone.level for zone in zones))
        if worst(before, level) == before:
            return centre
        return LidarZone(nearest_m=ahead_m, points=centre.points, level=level)

    def _measure(self, ahead: Returns, reject_reason: np.ndarray, seen: Evidence, path: Path | None) -> list[Measured]:
        """The lanes of this scan. On a straight way a line whose CAUTION waits counts only once it is near enough."""
        used = reject_reason == RejectReason.USED
        if path is None or abs(path.curvature_per_m) > CURVED_PER_M or not self._config.zones.lines_wait:
            self._lines.forget()
        else:
            free_m = self._lanes[LANES.index("centre")].agreed_m
            if not looked(seen, ahead, self._config.zones.fov_deg, self._config.health):
                free_m = 0.0
            late = self._lines.late(ahead, used, free_m)
            waits_m = self._zones.imminent_m + self._zones.curve_lead_s * path.motion.speed_mps
            used = used & ~(late & (ahead.x_m > waits_m))
        return self._scanner.measure(ahead, used, self._zones)

    def _carry(self, stamp_ns: int, motion: Motion | None) -> None:
        """What stands has come nearer by what was driven; what drives ahead in the lane, by so much less."""
        last_ns, self._carried_ns = self._carried_ns, stamp_ns
        dt_s = 0.0 if last_ns is None else (stamp_ns - last_ns) * 1e-9
        nearer_m = driven_m(self._config, motion, dt_s)
        if nearer_m > 0.0:
            self._scanner.carry(nearer_m)
            self._lines.carry(nearer_m)
            for name, lane in zip(LANES, self._lanes, strict=True):
                left_m = self._lead_mps * dt_s if name == "centre" else 0.0
                lane.carry(max(0.0, nearer_m - left_m))

    def _may_clear(self, seen: Evidence, returns: Returns, degraded: bool) -> bool:
        """A scan that could not have seen an obstacle says nothing about its absence, until the sensor is called
        degraded; so covering the lens does not end an alarm, and an open field ends it after 1.5 s."""
        if could_see(seen, returns, self._config.zones.fov_deg, self._config.health):
            return True
        return (degraded or self._health.open_ahead) and not covered_by_something_near(seen, self._config.health)

    def _agree(
        self, number: int, stamp_ns: int, measured: Measured, may_clear: bool, curvature_per_m: float
    ) -> LidarZone:
        """The lane after persistence."""
        lane, band = self._lanes[number], self._bands()[number]
        raw_m = math.inf if measured.nearest_m is None else measured.nearest_m
        if measured.nearest_m is not None or may_clear:
            lane.update(stamp_ns, raw_m)
        level = level_of(lane.agreed_m, band)
        # Once the way has swung away from what was agreed on, its distance is no longer one along the way: the alarm
        # lasts until scans clear it, but does not grow
        if measured.nearest_m is not None:
            self._shown_per_m[number] = curvature_per_m
        swung_m = 0.5 * abs(curvature_per_m - self._shown_per_m[number]) * min(lane.agreed_m, band.look_ahead_m) ** 2
        if swung_m > band.centre_width_m and worst(level, self._levels[number]) == level:
            level = self._levels[number]
        self._levels[number] = level
        if math.isinf(lane.agreed_m):
            return LidarZone(nearest_m=None, points=0, level=level)
        # The freshest distance that does not contradict the level
        fresh = raw_m <= band.look_ahead_m and level_of(raw_m, band) == level
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
            raw_level=worst(*(level_of(raw_m, band) for raw_m, band in zip(raw, self._bands(), strict=True))),
            scan_hz=self._scan_hz(stamp_ns),
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
