"""Where the cases take place: a street with walls and posts beside it, and how bodies are put on it.

The vehicle drives along x; without brakes its front is at x = 0 at ``MEETS_S``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spotter_sim.bodies import DEFAULT_SIZE_M
from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Motion, Pose, Straight, line
from spotter_sim.scene import Ground, Mount, Scene, post, wall
from spotter_sim.solids import Solids, join
from spotter_sim.tour import Tour
from spotter_tools.prove.case import BEGINS_S, PRESETS, Case

MEETS_S = BEGINS_S + 4.5
END_M = 60.0  # the house across the street's end is out of the way of all cases
CHILD_M = (0.40, 0.42, 1.15)
_LENGTH_S = 100.0
_HURRY_MPS2 = 2.5


def street(seed: int, *more: Solids) -> Scene:
    """Walls 3.5 to 4.5 m to both sides, five posts nearer by, a house across its end; drawn from the seed."""
    rng = np.random.default_rng([270, seed])
    left, right = rng.uniform(3.5, 4.5, 2)
    fixtures = [
        wall((-45.0, END_M), (left, left + 0.2), 2.0),
        wall((-45.0, END_M), (-right - 0.2, -right), 2.0),
        wall((END_M, END_M + 0.3), (-8.0, 8.0), 3.0),
    ]
    for x in rng.uniform(-20.0, 8.0, 5):
        side = rng.choice([-1.0, 1.0])
        fixtures.append(post(float(x), float(side * rng.uniform(2.2, 3.2)), 0.0, 1.2, 0.05))
    return _place(fixtures, more)


def square(*more: Solids) -> Scene:
    """A wide place with walls 16 m away, for bends."""
    near, far = 16.0, 16.3
    sides = [wall((-45.0, near), (y, y + 0.3), 2.0) for y in (-near, near)]
    return _place([*sides, wall((near, far), (-near, near), 2.0)], more)


def _place(fixtures: list[Solids], more: tuple[Solids, ...]) -> Scene:
    return Scene(Ground(), join([*fixtures, *more]), Mount(x_m=0.0, y_m=-20.0, yaw_rad=np.pi / 2))


def straight_on(speed_mps: float, preset: str = "model") -> Straight:
    """Our vehicle at constant speed."""
    half_m = 0.5 * PRESETS[preset].chassis.size_m[0]
    return Straight((-half_m - speed_mps * MEETS_S, 0.0), 0.0, speed_mps, math.inf)


def case(name: str, vehicle: Motion, scene: Scene, cast: list[Player], *, dangerous: bool, preset: str) -> Case:
    """A case whose family is the first words of its name, up to the comma."""
    chassis = PRESETS[preset].chassis
    name = name if preset == "model" else f"{name}, {preset}"
    scenario = Scenario(name, _LENGTH_S, scene, tuple(cast), vehicle=vehicle, chassis=chassis)
    return Case(name, name.split(",")[0], scenario, dangerous, preset=preset, ends_s=MEETS_S + 4.0)


def rear_at(kind: str, x_m: float) -> float:
    """The x of the middle of a body that heads along x and whose rear is at ``x_m``."""
    return x_m + 0.5 * DEFAULT_SIZE_M[kind][0]


def walk(start_m: tuple[float, float], end_m: tuple[float, float], speed_mps: float, passes_s: float) -> Tour:
    """From rest at ``start_m``; it would be at the end at ``passes_s`` did it not slow down there."""
    way_m = math.dist(start_m, end_m)
    ahead = (end_m[0] - start_m[0]) / way_m, (end_m[1] - start_m[1]) / way_m
    beyond = (end_m[0] + 3.0 * ahead[0], end_m[1] + 3.0 * ahead[1])
    takes_s = way_m / speed_mps + 0.5 * speed_mps / _HURRY_MPS2
    path = line(start_m, beyond)
    return Tour(path, speed_mps, passes_s - takes_s, accel_mps2=_HURRY_MPS2, brake_mps2=_HURRY_MPS2)


@dataclass(frozen=True)
class Backwards:
    """In reverse gear: the same way and speed, heading against it."""

    forwards: Motion

    def at(self, t_s: float) -> Pose:
        """The pose turned round."""
        pose = self.forwards.at(t_s)
        return Pose(pose.x_m, pose.y_m, pose.yaw_rad + math.pi, pose.vx_mps, pose.vy_mps, pose.travelled_m)


@dataclass(frozen=True)
class IntoBend:
    """Along x until x = 0, then a circle to the left; at ``first_m`` along that way at t = 0, at one speed."""

    radius_m: float
    speed_mps: float
    first_m: float

    def at(self, t_s: float) -> Pose:
        """So far along the way."""
        s_m, v = self.first_m + self.speed_mps * t_s, self.speed_mps
        turn = max(s_m, 0.0) / self.radius_m
        x = s_m if s_m < 0.0 else self.radius_m * math.sin(turn)
        return Pose(x, self.radius_m * (1.0 - math.cos(turn)), turn, v * math.cos(turn), v * math.sin(turn))
