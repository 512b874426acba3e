"""How bodies move: smooth closed-form motions, each a pure function of the scenario's time.

Speeds follow trapezoids, paths have bounded curvature, so that acceleration is bounded as it is for people and cars.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import Protocol

import numpy as np

_SAMPLES = 400


@dataclass(frozen=True)
class Pose:
    """Where something is in the plane and how it moves."""

    x_m: float
    y_m: float
    yaw_rad: float
    vx_mps: float = 0.0
    vy_mps: float = 0.0
    travelled_m: float = 0.0  # along its way: drives the stride of a walker and the cranks of a cyclist


class Motion(Protocol):
    """Any way to move."""

    def at(self, t_s: float) -> Pose:
        """The pose at scenario time ``t_s``."""


class Path:
    """A curve in the plane, sampled by arc length."""

    def __init__(self, points_m: np.ndarray) -> None:
        """Args: points_m: (N, 2) dense samples of the curve in map metres, N >= 2."""
        step = np.hypot(*np.diff(points_m, axis=0).T)
        s_m = np.concatenate([[0.0], np.cumsum(step)])
        heading = np.unwrap(np.arctan2(*np.gradient(points_m, s_m, axis=0).T[::-1]))
        # plain numbers: a single place is looked up faster in a list than in an array
        self._s_m: list[float] = s_m.tolist()
        self._places: list[list[float]] = np.column_stack([points_m, heading]).tolist()
        self.length_m = self._s_m[-1]

    def point(self, s_m: float) -> tuple[float, float, float]:
        """(x, y, heading) at arc length ``s_m``, linear between the samples; the ends beyond them."""
        i = min(max(bisect_right(self._s_m, s_m) - 1, 0), len(self._s_m) - 2)
        share = min(max((s_m - self._s_m[i]) / (self._s_m[i + 1] - self._s_m[i]), 0.0), 1.0)
        x, y, heading = (a + share * (b - a) for a, b in zip(self._places[i], self._places[i + 1], strict=True))
        return x, y, heading

    def headings(self, s_m: np.ndarray) -> np.ndarray:
        """(N,) headings at arc lengths (N,), as ``point`` gives them."""
        return np.interp(s_m, self._s_m, [place[2] for place in self._places])


def bezier(*control_m: tuple[float, float]) -> Path:
    """Cubic Bezier curve through the first and last of four control points."""
    u = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    p = np.asarray(control_m, float)
    return Path((1 - u) ** 3 * p[0] + 3 * u * (1 - u) ** 2 * p[1] + 3 * u**2 * (1 - u) * p[2] + u**3 * p[3])


def line(start_m: tuple[float, float], end_m: tuple[float, float]) -> Path:
    """A straight path."""
    return Path(np.linspace(start_m, end_m, 2))


def ellipse(centre_m: tuple[float, float], half_m: tuple[float, float], turn: float = 1.0) -> Path:
    """A closed ellipse, counter-clockwise for ``turn`` = 1, clockwise for -1."""
    angle = np.linspace(0.0, turn * 2 * np.pi, _SAMPLES)
    return Path(np.column_stack([centre_m[0] + half_m[0] * np.cos(angle), centre_m[1] + half_m[1] * np.sin(angle)]))


@dataclass(frozen=True)
class Ride:
    """From rest to rest along a path; ``backwards`` drives in reverse gear (heading against the motion)."""

    path: Path
    start_s: float
    speed_mps: float
    accel_mps2: float = 1.5
    backwards: bool = False

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.path.length_m / self.speed_mps + self.speed_mps / self.accel_mps2

    def pose(self, elapsed_s: float) -> Pose:
        """The pose ``elapsed_s`` after the start; before and after it stands at the ends."""
        s_m, speed_mps = self._progress(min(max(elapsed_s, 0.0), self.duration_s))
        x, y, heading = self.path.point(s_m)
        yaw = heading + math.pi if self.backwards else heading
        return Pose(x, y, yaw, speed_mps * math.cos(heading), speed_mps * math.sin(heading), s_m)

    def _progress(self, t: float) -> tuple[float, float]:
        v, a, total = self.speed_mps, self.accel_mps2, self.duration_s
        ramp = v / a
        if t < ramp:
            return 0.5 * a * t * t, a * t
        if t > total - ramp:
            left = total - t
            return self.path.length_m - 0.5 * a * left * left, a * left
        return v * (t - 0.5 * ramp), v


@dataclass(frozen=True)
class Errand:
    """Rides in a loop of ``length_s``; between two rides it waits and turns smoothly to the next heading."""

    rides: tuple[Ride, ...]
    length_s: float

    def at(self, t_s: float) -> Pose:
        """On the ride that has begun last, or turning after it."""
        t = (t_s - self.rides[0].start_s) % self.length_s + self.rides[0].start_s
        index = max(i for i, ride in enumerate(self.rides) if t >= ride.start_s)
        ride = self.rides[index]
        end_s = ride.start_s + ride.duration_s
        if t <= end_s:
            return ride.pose(t - ride.start_s)
        last = index + 1 == len(self.rides)
        following = self.rides[0 if last else index + 1]
        next_s = following.start_s + (self.length_s if last else 0.0)
        return _turning(ride.pose(ride.duration_s), following.pose(0.0).yaw_rad, (t - end_s) / (next_s - end_s))


def _turning(rest: Pose, goal_yaw_rad: float, fraction: float) -> Pose:
    """``rest`` turned the shorter way towards the goal, smoothly from fraction 0 to 1."""
    turn = (goal_yaw_rad - rest.yaw_rad + math.pi) % (2 * math.pi) - math.pi
    eased = fraction * fraction * (3.0 - 2.0 * fraction)
    return Pose(rest.x_m, rest.y_m, rest.yaw_rad + turn * eased, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Circuit:
    """Round a closed path at a constant speed, ``laps`` times per ``length_s``."""

    path: Path
    length_s: float
    laps: int = 1
    phase: float = 0.0

    def at(self, t_s: float) -> Pose:
        """``laps`` times round by ``length_s``."""
        s_m = self.path.length_m * ((self.laps * t_s / self.length_s + self.phase) % 1.0)
        x, y, heading = self.path.point(s_m)
        speed = self.path.length_m * self.laps / self.length_s
        return Pose(x, y, heading, speed * math.cos(heading), speed * math.sin(heading), s_m)


@dataclass(frozen=True)
class Straight:
    """Past ``start_m`` at t = 0 with a constant velocity, for as long as the scenario's loop lasts."""

    start_m: tuple[float, float]
    yaw_rad: float
    speed_mps: float
    length_s: float = math.inf

    def at(self, t_s: float) -> Pose:
        """So far along the line."""
        way_m = self.speed_mps * (t_s % self.length_s)
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x, y = self.start_m[0] + way_m * c, self.start_m[1] + way_m * s
        return Pose(x, y, self.yaw_rad, self.speed_mps * c, self.speed_mps * s, way_m)


@dataclass(frozen=True)
class Standing:
    """Never moves."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0

    def at(self, t_s: float) -> Pose:
        """Always the same pose."""
        return Pose(self.x_m, self.y_m, self.yaw_rad)
