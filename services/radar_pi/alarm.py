"""What a track means by the article's rules: one exhaustive classification, inclusive in range.

They hold while the vehicle stands, reverses, or nobody knows how it moves (``way.py`` decides while it drives).
Relative closing counts. A track that does not approach never alarms, except that very close at near-zero velocity is
flagged regardless of how it came there.
"""

from __future__ import annotations

import math

from common.messages import Level, worst
from services.radar_pi.config import AlarmConfig, TrackingConfig
from services.radar_pi.tracking import Track


def time_to_collision_s(track: Track, tracking: TrackingConfig) -> float | None:
    """Range over closing speed; None while the approach gate is shut or nothing closes."""
    if not track.approaching or track.velocity_mps > -tracking.moving_mps:
        return None
    return track.range_m / -track.velocity_mps


def approached_s_ago(track: Track, stamp_ns: int) -> float | None:
    """Seconds since the track last closed in with the gate passed; None = never."""
    return None if track.last_approach_ns is None else max(0.0, (stamp_ns - track.last_approach_ns) * 1e-9)


def alarm_level(track: Track, ttc_s: float | None, alarm: AlarmConfig, slow_mps: float) -> Level:
    """The level of one confirmed track."""
    if track.approaching:
        if (ttc_s is not None and ttc_s < alarm.imminent_ttc_s) or track.range_m <= alarm.imminent_range_m:
            return "IMMINENT"
        if (ttc_s is not None and ttc_s < alarm.caution_ttc_s) or track.range_m <= alarm.caution_range_m:
            return "CAUTION"
        return "SAFE"
    very_close = abs(track.velocity_mps) < slow_mps and track.range_m <= alarm.imminent_range_m
    return "CAUTION" if very_close and alarm.flag_very_close else "SAFE"


def is_moving(track: Track, ego_speed_mps: float | None, tracking: TrackingConfig) -> bool:
    """Whether the track moves over ground; with unknown ego speed, relative to the radar."""
    over_ground_mps = track.velocity_mps
    if ego_speed_mps is not None:
        over_ground_mps += ego_speed_mps * math.cos(track.azimuth_rad or 0.0)
    return abs(over_ground_mps) >= tracking.moving_mps


def static_level(standing: list[Track], alarm: AlarmConfig) -> Level | None:
    """What standing tracks would say by distance alone, for fusion when the lidar cannot see. None = nothing stands."""
    if not standing:
        return None
    return worst(*(_by_range(track.range_m, alarm) for track in standing))


def _by_range(range_m: float, alarm: AlarmConfig) -> Level:
    if range_m <= alarm.imminent_range_m:
        return "IMMINENT"
    return "CAUTION" if range_m <= alarm.caution_range_m else "SAFE"
