"""Which returns of a scan are believed, and why the others are not."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from common.geometry import wrap_angle
from common.messages import LaserScan
from services.jetson.lidar.config import FilterSection, MountingSection

NEIGHBOURS = 3  # how many beams to either side may vouch for a return
ENOUGH_NEIGHBOURS = 2


class Fate(IntEnum):
    """What became of a beam."""

    USED = 0
    NO_ECHO = 1  # no distance and hardly any light: open, or covered by something black
    ECHO_ONLY = 2  # no distance although light came back: something right at the lens
    NEAR = 3  # nearer than the floor
    FAR = 4
    BODY = 5  # on the vehicle itself
    WEAK = 6  # confidence too low
    ISOLATED = 7  # no neighbour agrees


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


def judge(returns: Returns, config: FilterSection, mounting: MountingSection) -> np.ndarray:
    """(N,) int64 ``Fate`` of each beam. Later reasons do not overwrite earlier ones."""
    fate = np.full(len(returns.range_m), int(Fate.USED))
    nothing = returns.range_m == 0.0
    strong = returns.confidence >= config.strong_echo
    _mark(fate, nothing & ~strong, Fate.NO_ECHO)
    _mark(fate, nothing, Fate.ECHO_ONLY)
    _mark(fate, returns.range_m < config.min_range_m, Fate.NEAR)
    _mark(fate, returns.range_m > config.max_range_m, Fate.FAR)
    _mark(fate, on_body(returns, mounting, config.body_clearance_m), Fate.BODY)
    _mark(fate, returns.confidence < config.min_confidence, Fate.WEAK)
    candidates = np.flatnonzero(fate == Fate.USED)
    fate[candidates[isolated(returns, candidates, config)]] = Fate.ISOLATED
    return fate


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
    One return alone is never believed; one with a single neighbour needs ``lone_confidence``.
    """
    angle, reach = returns.angle_rad[candidates], returns.range_m[candidates]
    support = np.zeros(len(candidates), dtype=np.int64)
    tolerance = np.maximum(config.neighbour_m, config.neighbour_share * reach)
    for k in range(1, NEIGHBOURS + 1):
        beside = angle[k:] - angle[:-k] < (NEIGHBOURS + 0.5) * returns.step_rad
        agree = beside & (np.abs(reach[k:] - reach[:-k]) <= k * np.minimum(tolerance[k:], tolerance[:-k]))
        support[k:] += agree
        support[:-k] += agree
    bright = returns.confidence[candidates] >= config.lone_confidence
    believed = (support >= ENOUGH_NEIGHBOURS) | ((support == 1) & bright)
    return np.asarray(~believed & (reach <= config.isolated_within_m))


def _mark(fate: np.ndarray, rejected: np.ndarray, why: Fate) -> None:
    fate[rejected & (fate == Fate.USED)] = why
