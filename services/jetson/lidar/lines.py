"""Lines across the way whose CAUTION can wait: ground before a nose that dips, and a wall that leads off.

To a lidar that looks in one plane both are a wall ahead:

- **Ground.** Driving down from a ramp, the plane meets the level ground beyond its foot: the lidar's height over the
  slope away, 4.3 m for 0.22 m and 5 %. When the vehicle is level again it is gone. It gives itself away by how it
  comes: within two scans, across more than any vehicle's width, and bright enough that it would have shown a good piece
  farther off, where the scans before saw nothing. Nothing that stands or drives comes like that. A gate that closes
  does.
- **A wall that leads off.** Before every bend the vehicle drives at its outer wall. It lies aslant, crosses the way
  from one side to the other, and stands: it comes nearer by what the vehicle drives.

Their CAUTION waits until ``zones.curve_lead_s`` before the stopping distance, as all CAUTION in a curve does. IMMINENT,
which is what a stop needs, never waits, and other sensors are not asked. Only while the vehicle is known to drive.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from services.jetson.lidar.config import FilterSection, ZonesSection
from services.jetson.lidar.filters import Returns

WIDE_M = 3.0  # wider than what drives on a road or a yard
ASIDE_M = 0.45  # so far beyond the lane on either side a wall that leads off has to be seen
FREE_SCANS = 4  # before ground; the scan in which the nose dips is between them and it
JUMP_M = 2.0  # nothing comes nearer by that much in two scans
LEVEL = 0.35  # greatest lean of the ground's line: the vehicle rolls as well
ASLANT = 0.6  # least lean of a wall that leads off: 59 degrees to the way
STANDS_SCANS, STANDS_M = 6, 0.15  # so far apart the wall's place is in the earlier and the later half of these scans
STRAIGHT_M, STRAIGHT_SHARE = 0.10, 0.02  # how far, and of its distance, a return may lie off its line
GAP_M, END_M = 0.45, 0.25  # across the way: between neighbours on a line, and from its ends to that width's
LEAST, SHARE = 6, 0.9  # returns, and the share of all in that width, that have to be on it


class Line(NamedTuple):
    """A straight line across the way."""

    at_m: float  # ahead, where it crosses the middle of the way
    lean: float  # metres ahead per metre to the left
    on: np.ndarray  # (N,) bool, the returns that make it


class Lines:
    """Call ``carry`` and ``late`` once per scan, ``forget`` when the scans before say nothing about this one."""

    def __init__(self, zones: ZonesSection, filters: FilterSection) -> None:
        self._zones, self._filters = zones, filters
        self._half_m = 0.5 * zones.centre_width_m + ASIDE_M
        self._free_m: deque[float] = deque(maxlen=FREE_SCANS + 1)  # ahead across ``WIDE_M``; 0 = that scan did not look
        self._crossings_m: deque[float] = deque(maxlen=STANDS_SCANS)  # of the wall that leads off
        self._dipped = False

    def forget(self) -> None:
        """Nothing is known."""
        self._free_m.clear()
        self._crossings_m.clear()
        self._dipped = False

    def carry(self, nearer_m: float) -> None:
        """The vehicle has driven on."""
        for places_m in (self._free_m, self._crossings_m):
            carried_m = [place_m - nearer_m for place_m in places_m]
            places_m.clear()
            places_m.extend(carried_m)

    def late(self, ahead: Returns, used: np.ndarray, free_m: float) -> np.ndarray:
        """(N,) bool: returns whose CAUTION waits.

        Args:
            ahead: the returns along a straight way.
            used: (N,) bool, which of them are believed.
            free_m: what the scans so far have agreed on as free ahead: no alarm of theirs is taken back. 0 = this scan
                did not look.
        """
        return self._ground(ahead, used, free_m) | self._leads_off(ahead, used)

    def _ground(self, ahead: Returns, used: np.ndarray, free_m: float) -> np.ndarray:
        line = line_across(ahead, used, 0.5 * WIDE_M)
        level = line is not None and abs(line.lean) <= LEVEL
        self._dipped = level and line is not None and (self._dipped or self._came_at_once(line, ahead))
        wide = used & (ahead.x_m > 0.0) & (np.abs(ahead.y_m) <= 0.5 * WIDE_M)
        self._free_m.append(min(float(ahead.x_m[wide].min(initial=np.inf)), free_m))
        return line.on if self._dipped and line is not None else np.zeros(len(used), bool)

    def _came_at_once(self, line: Line, ahead: Returns) -> bool:
        """Where it is, the scans before saw nothing for ``JUMP_M`` beyond, and would have seen it there."""
        beyond_m = line.at_m + JUMP_M
        there = np.median(ahead.confidence[line.on]) * (line.at_m / beyond_m) ** 2
        free = len(self._free_m) > FREE_SCANS and min(list(self._free_m)[:-1]) >= beyond_m
        return bool(free and there >= 2 * self._filters.min_confidence)

    def _leads_off(self, ahead: Returns, used: np.ndarray) -> np.ndarray:
        line = line_across(ahead, used, self._half_m)
        if line is None or abs(line.lean) < ASLANT:
            self._crossings_m.clear()
            return np.zeros(len(used), bool)
        self._crossings_m.append(line.at_m)
        earlier, later = np.split(np.array(self._crossings_m), [STANDS_SCANS // 2])
        stands = len(earlier) == len(later) and abs(earlier.mean() - later.mean()) <= STANDS_M
        return line.on if stands else np.zeros(len(used), bool)


def line_across(ahead: Returns, used: np.ndarray, half_m: float) -> Line | None:
    """The line on which nearly all returns within ``half_m`` of the middle of the way lie; None = there is none.

    Source of the fit: Theil's incomplete method (1950), the median slope of pairs half of the points apart.
    """
    inside = np.flatnonzero(used & (ahead.x_m > 0.0) & (np.abs(ahead.y_m) <= half_m))
    if len(inside) < LEAST:
        return None
    inside = inside[np.argsort(ahead.y_m[inside], kind="stable")]
    x, y = ahead.x_m[inside], ahead.y_m[inside]
    if max(half_m + y[0], half_m - y[-1]) > END_M or np.diff(y).max() > GAP_M:
        return None
    apart = len(y) // 2
    lean = float(np.median((x[apart:] - x[:-apart]) / np.maximum(y[apart:] - y[:-apart], 1e-3)))
    at_m = float(np.median(x - lean * y))
    off_m = np.abs(x - at_m - lean * y)
    close = off_m <= (STRAIGHT_M + STRAIGHT_SHARE * abs(at_m)) * np.hypot(1.0, lean)
    if close.mean() < SHARE:
        return None
    on = np.zeros(len(used), bool)
    on[inside[close]] = True
    return Line(at_m, lean, on)
