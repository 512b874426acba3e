"""Which returns of a scan are believed, and why the others are not."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from common.geometry import wrap_angle
from common.messages import LaserScan
from services.jetson.lidar.config import FilterSection, IgnoredSector, MountingSection

NEIGHBOURS = 3  # how many beams to either side may vouch for a return
ENOUGH_NEIGHBOURS = 2


class RejectReason(IntEnum):
    """What became of a beam."""

    USED = 0
    NO_ECHO = 1  # no distance and hardly any light: open, or covered by something black
    ECHO_ONLY = 2  # no distance although light came back: something right at the lens
    NEAR = 3  # nearer than the floor
    FAR = 4
    BODY = 5  # on the vehicle itself
    WEAK = 6  # confidence too low
    ISOLATED = 7  # no neighbour agrees
    IGNORED = 8  # a part of the vehicle that the configuration names
    GRAZING = 9  # alone by its range, but on a straight line with its neighbours: a surface seen at a flat angle


@dataclass(frozen=True)
class Returns:
    """The beams of a scan in counter-clockwise order, (N,) each."""

    angle_rad: np.ndarray  # [-pi, pi), rising
    range_m: np.ndarray  # 0 = no return
    confidence: np.ndarray
    x_m: np.ndarray  # ahead of the bumper
    y_m: np.ndarray  # left of the vehicle's middle
    order: np.ndarray  # their places in the scan
    step_rad: float  # between neighbouring beams


def returns_of(scan: LaserScan, mounting: MountingSection) -> Returns:
    """Sort by angle and place each return in the vehicle's frame. A range that is no number counts as no return."""
    angles = wrap_angle(scan.angles_rad.astype(np.float64))
    order = np.argsort(angles, kind="stable")
    angles = angles[order]
    ranges = scan.ranges_m[order].astype(np.float64)
    ranges = np.where(np.isfinite(ranges) & (ranges > 0.0), ranges, 0.0)
    step = float(np.median(np.diff(angles))) if len(angles) > 1 else 0.0
    return Returns(
        angle_rad=angles,
        range_m=ranges,
        confidence=scan.confidence[order].astype(np.float64),
        x_m=ranges * np.cos(angles) - mounting.front_m,
        y_m=ranges * np.sin(angles) + mounting.left_m,
        order=order,
        step_rad=max(step, 1e-4),
    )


def judge(
    returns: Returns, config: FilterSection, mounting: MountingSection, before: Returns | None = None
) -> np.ndarray:
    """(N,) int64 ``RejectReason`` of each beam. Later reasons do not overwrite earlier ones.

    ``before`` is the scan before: a pair of returns of a thin thing is believed when it was there already.
    """
    reject_reason = np.full(len(returns.range_m), int(RejectReason.USED))
    nothing = returns.range_m == 0.0
    strong = returns.confidence >= config.strong_echo
    _mark(reject_reason, nothing & ~strong, RejectReason.NO_ECHO)
    _mark(reject_reason, nothing, RejectReason.ECHO_ONLY)
    _mark(reject_reason, in_ignored(returns, config.ignore), RejectReason.IGNORED)
    _mark(reject_reason, returns.range_m < config.min_range_m, RejectReason.NEAR)
    _mark(reject_reason, returns.range_m > config.max_range_m, RejectReason.FAR)
    _mark(reject_reason, on_body(returns, mounting, config.body_clearance_m), RejectReason.BODY)
    _mark(reject_reason, returns.confidence < config.min_confidence, RejectReason.WEAK)
    candidates = np.flatnonzero(reject_reason == RejectReason.USED)
    alone = isolated(returns, candidates, config)
    if before is not None and alone.any():
        alone[alone] = ~pair_seen_again(returns, candidates[alone], before, config)
    reject_reason[candidates[alone]] = RejectReason.ISOLATED
    reject_reason[candidates[alone & in_line(returns, candidates, config)]] = RejectReason.GRAZING
    return reject_reason


def in_ignored(returns: Returns, sectors: tuple[IgnoredSector, ...]) -> np.ndarray:
    """(N,) bool: returns from the vehicle's own parts, by angle and range. What is behind such a part is hidden."""
    found = np.zeros(len(returns.range_m), bool)
    for sector in sectors:
        width_rad = np.radians(sector.to_deg - sector.from_deg)
        beyond_rad = (returns.angle_rad - np.radians(sector.from_deg)) % (2 * np.pi)
        found |= (beyond_rad <= width_rad) & (returns.range_m > 0.0) & (returns.range_m <= sector.within_m)
    return found


def on_body(returns: Returns, mounting: MountingSection, clearance_m: float) -> np.ndarray:
    """(N,) bool: the geometric distance check. The floor looks at the range alone; this one knows the vehicle's
    outline and finds the wheel or mast that stands 0.25 m from the sensor."""
    along = (returns.x_m < clearance_m) & (returns.x_m > -mounting.vehicle_length_m - clearance_m)
    across = np.abs(returns.y_m) < mounting.vehicle_width_m / 2 + clearance_m
    return np.asarray(along & across)


def isolated(returns: Returns, candidates: np.ndarray, config: FilterSection) -> np.ndarray:
    """(K,) bool per candidate: hardly a neighbour at a similar range, and not bright enough to do without.

    After the vendor SDK's near filter (ldlidar_stl_sdk), which cuts the scan into groups by gaps in angle and range.
    Here each return asks the beams beside it instead, so that a ghost in the middle of a wall does not split the wall.
    Within ``isolated_within_m`` a return alone is never believed, and one with a single neighbour needs
    ``lone_confidence``. Farther returns may stand alone.
    """
    reach = returns.range_m[candidates]
    support = neighbours(returns, candidates, config)
    bright = returns.confidence[candidates] >= config.lone_confidence
    believed = (support >= ENOUGH_NEIGHBOURS) | ((support == 1) & bright)
    return np.asarray(~believed & (reach <= config.isolated_within_m))


def neighbours(returns: Returns, candidates: np.ndarray, config: FilterSection) -> np.ndarray:
    """(K,) how many of the beams beside each candidate end at a similar range."""
    angle, reach = returns.angle_rad[candidates], returns.range_m[candidates]
    support = np.zeros(len(candidates), dtype=np.int64)
    tolerance = np.maximum(config.neighbour_m, config.neighbour_share * reach)
    for k in range(1, NEIGHBOURS + 1):
        beside = angle[k:] - angle[:-k] < (NEIGHBOURS + 0.5) * returns.step_rad
        agree = beside & (np.abs(reach[k:] - reach[:-k]) <= k * np.minimum(tolerance[k:], tolerance[:-k]))
        support[k:] += agree
        support[:-k] += agree
    return support


def in_line(returns: Returns, candidates: np.ndarray, config: FilterSection) -> np.ndarray:
    """(K,) bool per candidate: on a straight line with two others beside it.

    The flank of a parked car ahead comes back from every metre: no two neighbours agree in range. But along a straight
    line the inverse range is a sinusoid of the angle, so between three beams that lie close together it changes evenly.
    Drops of rain do that by chance only.
    """
    angle, reach = returns.angle_rad[candidates], returns.range_m[candidates]
    lies = np.zeros(len(candidates), bool)
    if len(candidates) < 3:
        return lies
    step = np.diff(angle)
    close = (np.maximum(step[1:], step[:-1]) < (NEIGHBOURS + 0.5) * returns.step_rad) & (step[1:] + step[:-1] > 0.0)
    share = step[:-1] / np.maximum(step[1:] + step[:-1], 1e-9)
    between_m = 1.0 / ((1.0 - share) / reach[:-2] + share / reach[2:])
    even = close & (np.abs(reach[1:-1] - between_m) <= config.neighbour_m)
    for first in range(3):
        lies[first : first + len(even)] |= even
    return lies


def pair_seen_again(returns: Returns, alone: np.ndarray, before: Returns, config: FilterSection) -> np.ndarray:
    """(K,) bool per lone candidate: it has a neighbour among the others, and the scan before had a return there."""
    paired = neighbours(returns, alone, config) > 0
    angle, reach = returns.angle_rad[alone], returns.range_m[alone]
    within_rad = (NEIGHBOURS + 0.5) * returns.step_rad
    near = np.abs(angle[:, None] - before.angle_rad) < within_rad
    near &= (
        np.abs(reach[:, None] - before.range_m)
        <= np.maximum(config.neighbour_m, config.neighbour_share * reach)[:, None]
    )
    return np.asarray(paired & near.any(axis=1))


def _mark(reject_reason: np.ndarray, rejected: np.ndarray, why: RejectReason) -> None:
    reject_reason[rejected & (reject_reason == RejectReason.USED)] = why
