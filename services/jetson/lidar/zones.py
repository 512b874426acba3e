"""The three lanes ahead: how near is the nearest thing in each that enough returns vouch for."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from common.messages import Level
from services.jetson.lidar.config import ZonesSection
from services.jetson.lidar.filters import Returns

LANES = ("left", "centre", "right")
RESOLUTION_M = 1e-3  # the sensor's unit; without rounding, 0.8 m in single precision is beyond 0.8 m


@dataclass(frozen=True)
class Measured:
    """One lane in one scan."""

    nearest_m: float | None  # ahead of the bumper
    points: int  # returns near that distance


class LaneScanner:
    """Measures the lanes; remembers the returns of the last scans, because a thin thing shows few in each.

    A rod of 2 cm at 0.4 m gives 3 or 4 returns a turn, fewer than half of what the smallest object of interest gives.
    Over three turns it gives enough. Each of them has to hold at least ``min_points``, so that one bad turn cannot
    vouch for three.
    """

    def __init__(self, config: ZonesSection) -> None:
        self._config = config
        self._earlier: deque[np.ndarray] = deque(maxlen=config.thin_scans - 1)  # (K,) x of the returns in the lanes

    def forget(self) -> None:
        """The scans so far are too old to vouch for anything."""
        self._earlier.clear()

    def carry(self, nearer_m: float) -> None:
        """The vehicle has driven on: what stands has come nearer."""
        for x_m in self._earlier:
            x_m -= nearer_m

    def measure(self, returns: Returns, used: np.ndarray, zones: ZonesSection | None = None) -> list[Measured]:
        """One ``Measured`` per lane, from the beams that are ``used`` (N,) bool; ``zones`` are those in use now."""
        config = zones or self._config
        ahead = used & (returns.x_m > 0.0) & (np.abs(returns.y_m) <= config.centre_width_m / 2 + config.side_width_m)
        x, y = returns.x_m[ahead], returns.y_m[ahead]
        in_cone = np.abs(returns.angle_rad[ahead]) <= np.radians(config.fov_deg / 2) + 1e-6
        support = points_near(x, x, config.near_m)
        distance = np.round(x / RESOLUTION_M) * RESOLUTION_M
        counts = in_cone & (distance <= config.look_ahead_m + 1e-9)
        needed = points_needed(returns.range_m[ahead], returns.step_rad, config)
        counts &= (support >= needed) | (self._over_scans(x, support) >= needed)
        self._earlier.append(x)
        lane = lane_of(y, config)
        return [_nearest(distance, support, counts & (lane == number)) for number in range(len(LANES))]

    def _over_scans(self, x_m: np.ndarray, support: np.ndarray) -> np.ndarray:
        """(N,) returns near each distance over the last scans; 0 where one of these has too few."""
        if len(self._earlier) < (self._earlier.maxlen or 0):
            return np.zeros(len(x_m), np.int64)
        each = [support, *(points_near(x_m, earlier, self._config.near_m) for earlier in self._earlier)]
        return np.where(np.min(each, axis=0) >= self._config.min_points, np.sum(each, axis=0), 0)


def lane_of(y_m: np.ndarray, config: ZonesSection) -> np.ndarray:
    """(N,) int: 0 left, 1 centre, 2 right, -1 outside."""
    half_m = config.centre_width_m / 2
    lane = np.where(np.abs(y_m) <= half_m, 1, np.where(y_m > 0.0, 0, 2))
    return np.where(np.abs(y_m) <= half_m + config.side_width_m, lane, -1)


def points_near(x_m: np.ndarray, among_m: np.ndarray, near_m: float) -> np.ndarray:
    """(N,) how many of the returns ``among_m`` (K,) lie within ``near_m`` ahead of or behind each ``x_m``, whichever
    lane they are in: an obstacle on the line between two lanes must not lose its vote in both."""
    rising = np.sort(among_m)
    return np.searchsorted(rising, x_m + near_m, "right") - np.searchsorted(rising, x_m - near_m, "left")


def points_needed(range_m: np.ndarray, step_rad: float, config: ZonesSection) -> np.ndarray:
    """(N,) half as many as the smallest object of interest returns at that range, at least 2 and at most 6."""
    expected = config.smallest_object_m / np.maximum(range_m * step_rad, 1e-6)
    return np.clip(np.floor(expected / 2), config.min_points, config.max_points)


def level_of(distance_m: float, config: ZonesSection) -> Level:
    """The band of a distance; both limits belong to the more serious side."""
    if distance_m <= config.imminent_m + 1e-9:
        return "IMMINENT"
    return "CAUTION" if distance_m <= config.caution_m + 1e-9 else "SAFE"


def _nearest(distance_m: np.ndarray, support: np.ndarray, counts: np.ndarray) -> Measured:
    if not counts.any():
        return Measured(None, 0)
    chosen = np.flatnonzero(counts)
    nearest = chosen[np.argmin(distance_m[chosen])]
    return Measured(round(float(distance_m[nearest]), 3), int(support[nearest]))
