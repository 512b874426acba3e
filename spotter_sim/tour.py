"""A drive along a path with bounded acceleration: slower in bends, at rest at the ends and where it is told to stop."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from spotter_sim.motion import Path, Pose

_STEP_M = 0.02


@dataclass(frozen=True)
class Stop:
    """Come to rest at ``at_m`` along the path and stay for ``wait_s``."""

    at_m: float
    wait_s: float


@dataclass(frozen=True, eq=False)
class Tour:
    """From rest to rest along ``path``, then standing at its end; before ``start_s`` standing at its beginning.

    The speed at every place is the least of ``speed_mps``, what the bend allows at ``sideways_mps2``, and what can
    still be reached from the places before and after it at ``accel_mps2`` and ``brake_mps2``.
    """

    path: Path
    speed_mps: float
    start_s: float = 0.0
    stops: tuple[Stop, ...] = ()
    accel_mps2: float = 1.5
    brake_mps2: float = 2.0
    sideways_mps2: float = 3.0
    first_mps: float = field(default=0.0)  # already that fast at the start

    @property
    def end_s(self) -> float:
        """When it has come to rest at the end."""
        return float(self._table[0][-1])

    def when(self, at_m: float) -> float:
        """The time at which it first is ``at_m`` along the path, to the table's step."""
        times, places, _ = self._table
        return times[min(bisect_left(places, at_m - 0.5 * _STEP_M), len(times) - 1)]

    def at(self, t_s: float) -> Pose:
        """The pose at ``t_s``; constant acceleration between the knots of the table."""
        times, places, speeds = self._table
        i = bisect_right(times, t_s) - 1
        if i < 0 or i + 1 >= len(times):
            end = 0 if i < 0 else -1
            return self._pose(places[end], 0.0)
        span, into = times[i + 1] - times[i], t_s - times[i]
        accel = (speeds[i + 1] - speeds[i]) / span
        return self._pose(places[i] + speeds[i] * into + 0.5 * accel * into * into, speeds[i] + accel * into)

    def _pose(self, s_m: float, speed_mps: float) -> Pose:
        x, y, heading = self.path.point(s_m)
        return Pose(x, y, heading, speed_mps * math.cos(heading), speed_mps * math.sin(heading), s_m)

    @cached_property
    def _table(self) -> tuple[list[float], list[float], list[float]]:
        """Times, places along the path and speeds of the knots."""
        s_m = np.linspace(0.0, self.path.length_m, max(3, round(self.path.length_m / _STEP_M) + 1))
        stops = {int(np.argmin(np.abs(s_m - stop.at_m))): stop.wait_s for stop in self.stops}
        speed = self._speeds(s_m, list(stops))
        times, places, speeds = [self.start_s], [0.0], [float(speed[0])]
        for i, ((s, v), (s_next, v_next)) in enumerate(pairwise(zip(s_m.tolist(), speed.tolist(), strict=True)), 1):
            times.append(times[-1] + 2.0 * (s_next - s) / max(v + v_next, 1e-9))
            places.append(s_next)
            speeds.append(v_next)
            if i in stops:
                times.append(times[-1] + stops[i])
                places.append(places[-1])
                speeds.append(0.0)
        return times, places, speeds

    def _speeds(self, s_m: np.ndarray, stops: list[int]) -> np.ndarray:
        bend = np.abs(np.gradient(self.path.headings(s_m), s_m))
        speed = np.minimum(self.speed_mps, np.sqrt(self.sideways_mps2 / np.maximum(bend, 1e-6)))
        speed[0], speed[-1] = min(self.first_mps, speed[0]), 0.0
        speed[stops] = 0.0
        step_m, squared = float(s_m[1] - s_m[0]), (speed**2).tolist()  # v^2 grows by 2 a s
        for i in range(len(squared) - 1):
            squared[i + 1] = min(squared[i + 1], squared[i] + 2 * self.accel_mps2 * step_m)
        for i in reversed(range(len(squared) - 1)):
            squared[i] = min(squared[i], squared[i + 1] + 2 * self.brake_mps2 * step_m)
        return np.sqrt(squared)


def rounded(corners_m: list[tuple[float, float]], cut_m: float) -> Path:
    """A chain of straight lines whose corners are cut by smooth bends that begin ``cut_m`` before and after them.

    Each bend is a Bezier curve of fifth degree whose first and last three control points lie on the lines, so that
    the curvature begins and ends at zero: the wheels turn, they do not jump.
    """
    points = np.array(corners_m, float)
    pieces = [points[:1]]
    u = np.linspace(0.0, 1.0, 80)[:, None]
    for before, corner, after in zip(points[:-2], points[1:-1], points[2:], strict=True):
        start = corner + cut_m * (before - corner) / np.linalg.norm(before - corner)
        end = corner + cut_m * (after - corner) / np.linalg.norm(after - corner)
        control = [start, *(start + k * (corner - start) for k in (0.35, 0.7))]
        control += [*(end + k * (corner - end) for k in (0.7, 0.35)), end]
        bend = sum(math.comb(5, k) * u**k * (1 - u) ** (5 - k) * p for k, p in enumerate(control))
        pieces += [_straight(pieces[-1][-1], start), np.asarray(bend)[1:]]
    pieces.append(_straight(pieces[-1][-1], points[-1]))
    return Path(np.vstack(pieces))


def _straight(start_m: np.ndarray, end_m: np.ndarray) -> np.ndarray:
    """Points on a line every 5 cm, without its first."""
    count = max(2, int(np.linalg.norm(end_m - start_m) / 0.05))
    return np.linspace(start_m, end_m, count)[1:]
