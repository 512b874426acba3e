"""The lanes while the vehicle drives: bent along its arc, as far as it needs to stop, and free of the scan's skew.

Standing, in reverse, or with unknown motion nothing changes: straight lanes, the configured bands.
"""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np

from common.messages import Cover, LaneLayout, Motion
from common.path import Path, carried, is_driving, stopping_m
from services.jetson.lidar.config import LidarConfig, ZonesSection
from services.jetson.lidar.filters import RejectReason, Returns

SECTOR_DEG = 2.0
LEAD_KNOWN_S = 1.0  # the lane is looked at so long before CAUTION: by then it is known who drives ahead
CURVED_PER_M = 0.05  # curves end: what lies far along one says little
_HIDING = (RejectReason.NEAR, RejectReason.ECHO_ONLY, RejectReason.WEAK, RejectReason.BODY, RejectReason.IGNORED)


def zones_for(config: LidarConfig, motion: Motion | None, lead_mps: float = 0.0) -> ZonesSection:
    """The centre lane's bands at this speed: what a stop needs is IMMINENT, ``caution_lead_s`` before it CAUTION.

    Of the way to stop, what is ahead in the lane leaves its own free when it drives at ``lead_mps`` (``lead.py``), and
    it comes nearer by the difference of the speeds only.

    Its width is that of the vehicle and the side margins. In a curve ``curve_lead_s`` counts instead. The side lanes
    are narrower than for a vehicle that may swerve anywhere: whoever drives through a gate passes close to its posts.

    No band is less than configured. While driving the lanes alone decide what is ahead: an arc leaves the cone.
    """
    zones = config.zones
    if motion is None or not is_driving(motion, config.path):
        return zones
    stop_m = max(0.0, stopping_m(motion.speed_mps, config.path) - lead_mps**2 / (2.0 * config.lead.brake_mps2))
    curved = abs(Path(config.path, motion).curvature_per_m) > CURVED_PER_M
    lead_s = zones.curve_lead_s if curved else zones.caution_lead_s
    caution_m = max(zones.caution_m, stop_m + lead_s * max(0.0, motion.speed_mps - lead_mps))
    return msgspec.structs.replace(
        zones,
        imminent_m=max(zones.imminent_m, stop_m),
        caution_m=caution_m,
        look_ahead_m=max(zones.look_ahead_m, caution_m + LEAD_KNOWN_S * motion.speed_mps),
        fov_deg=max(zones.fov_deg, 2 * zones.cover_half_deg),
        centre_width_m=max(zones.centre_width_m, config.path.width_m + 2 * config.path.side_margin_m),
        side_width_m=min(zones.side_width_m, zones.driving_side_m),
    )


def along_the_way(returns: Returns, config: LidarConfig, motion: Motion | None) -> Returns:
    """The returns with x as the way to drive until the bumper is there, and y beside that way.

    Each return was measured while the scan went on; the scan's last one is of now (``scan.sample_rate_hz``).
    """
    if motion is None or not is_driving(motion, config.path):
        return returns
    age_s = (len(returns.order) - 1 - returns.order) / config.scan.sample_rate_hz
    seen = np.column_stack([returns.x_m + config.path.front_m, returns.y_m])
    ahead_m, beside_m = Path(config.path, motion).locate(carried(seen, motion, age_s))
    came_back = returns.range_m > 0.0
    return replace(returns, x_m=np.where(came_back, ahead_m, 0.0), y_m=beside_m)


def driven_m(config: LidarConfig, motion: Motion | None, dt_s: float) -> float:
    """How much nearer a standing thing has come since the scan before."""
    return motion.speed_mps * dt_s if motion is not None and is_driving(motion, config.path) else 0.0


def cover_of(returns: Returns, reject_reason: np.ndarray, config: LidarConfig, motion: Motion | None) -> Cover:
    """How far each sector ahead was seen: to its nearest return, else as far as the sensor sees for certain.

    A sector without a measurement, or most of whose beams end at the lens or on the vehicle itself, was not seen.
    """
    zones = zones_for(config, motion)
    half_rad = math.radians(zones.fov_deg / 2)
    count = max(1, round(2 * math.degrees(half_rad) / SECTOR_DEG))
    sector = np.floor((returns.angle_rad + half_rad) / (2 * half_rad) * count).astype(np.int64)
    inside = (sector >= 0) & (sector < count)
    beams = np.bincount(sector[inside], minlength=count)
    hidden = inside & np.isin(reject_reason, _HIDING)
    blocked = np.bincount(sector[hidden], minlength=count) > 0.5 * beams
    far_m = np.full(count, zones.cover_far_m)
    used = inside & (reject_reason == RejectReason.USED)
    np.minimum.at(far_m, sector[used], returns.range_m[used])
    far_m[blocked | (beams == 0)] = 0.0
    ignored = np.bincount(sector[inside & (reject_reason == RejectReason.IGNORED)], minlength=count) > 0.5 * beams
    return Cover(
        x_m=config.path.front_m - config.mounting.front_m,
        y_m=config.mounting.left_m,
        first_rad=-half_rad,
        step_rad=2 * half_rad / count,
        far_m=[round(float(value), 2) for value in far_m],
        near_m=config.filter.min_range_m,
        only="what crosses its plane",
        why=_why_hidden(float(np.mean((far_m == 0.0) & ~ignored)), float(np.mean((far_m == 0.0) & ignored))),
    )


def _why_hidden(lens: float, ignored: float) -> str:
    """Shares of the view that are not seen, in words."""
    words = []
    if lens:
        words.append(f"{100 * lens:.0f} % of the view ends at the lens or is not measured")
    if ignored:
        words.append(f"{100 * ignored:.0f} % of the view is behind own parts (filter.ignore)")
    return ", ".join(words)


def layout_of(zones: ZonesSection, path: Path | None = None) -> LaneLayout:
    """The lanes and lines in use, for viewers."""
    return LaneLayout(
        centre_width_m=zones.centre_width_m,
        side_width_m=zones.side_width_m,
        look_ahead_m=zones.look_ahead_m,
        imminent_m=zones.imminent_m,
        caution_m=zones.caution_m,
        curvature_per_m=path.curvature_per_m if path else 0.0,
    )
