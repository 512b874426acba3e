"""Cases in which nothing is ever in the way: every alarm and every braking is false."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from common.geometry import rotation_z
from spotter_sim.model import Player
from spotter_sim.motion import Motion, Pose, Standing, Straight
from spotter_sim.scene import Scene, post, wall
from spotter_sim.solids import BOX, Solids, solid
from spotter_sim.yard import drive
from spotter_tools.prove.case import BEGINS_S, PRESETS, Case
from spotter_tools.prove.places import MEETS_S, IntoBend, case, rear_at, square, straight_on, street, walk

_BESIDE_M = 0.8  # free room beside the vehicle where nothing else is said


def _case(name: str, vehicle: Motion, scene: Scene, cast: list[Player], preset: str) -> Case:
    return case(name, vehicle, scene, cast, dangerous=False, preset=preset)


def _beside(preset: str, room_m: float, half_m: float) -> float:
    """The y of something of that half width with that free room to the vehicle."""
    return 0.5 * PRESETS[preset].chassis.size_m[1] + room_m + half_m


def parked_rows(speed_mps: float, room_m: float = 0.9, preset: str = "model") -> Case:
    """Between two rows of parked cars."""
    y = _beside(preset, room_m, 0.9)
    places = [(-12.0 + 4.9 * k, side * y) for k in range(5) for side in (-1.0, 1.0)]
    cast = [Player(i + 1, "car", Standing(*place)) for i, place in enumerate(places)]
    name = f"parked rows, {speed_mps:g} m/s, {room_m:g} m"
    return _case(name, straight_on(speed_mps, preset), street(21), cast, preset)


def gate(speed_mps: float, room_m: float = 0.3, preset: str = "model") -> Case:
    """Through an opening in a wall."""
    y = _beside(preset, room_m, 0.0)
    pieces = [wall((-1.0, -0.88), _sorted(side * y, side * (y + 2.5)), 1.6) for side in (-1.0, 1.0)]
    scene = street(22, *pieces)
    name = f"gate, {speed_mps:g} m/s, {room_m:g} m"
    return _case(name, straight_on(speed_mps, preset), scene, [], preset)


def _sorted(a: float, b: float) -> tuple[float, float]:
    """The two in rising order."""
    return min(a, b), max(a, b)


def pillars(speed_mps: float, room_m: float = 0.5, preset: str = "model") -> Case:
    """Between pillars."""
    y = _beside(preset, room_m, 0.15)
    posts = [post(-8.0 + 2.0 * k, side * y, 0.0, 2.5, 0.15) for k in range(6) for side in (-1.0, 1.0)]
    name = f"pillars, {speed_mps:g} m/s, {room_m:g} m"
    return _case(name, straight_on(speed_mps, preset), street(23, *posts), [], preset)


def passage(speed_mps: float, preset: str = "model") -> Case:
    """Along a passage with 1.1 m of room to each wall."""
    y = _beside(preset, 1.1, 0.0)
    walls: list[Solids] = [wall((-25.0, 8.0), _sorted(side * y, side * (y + 0.2)), 1.5) for side in (-1.0, 1.0)]
    name = f"passage, {speed_mps:g} m/s"
    return _case(name, straight_on(speed_mps, preset), street(24, *walls), [], preset)


def oncoming(speed_mps: float, kind: str, preset: str = "model") -> Case:
    """A pedestrian comes from ahead and passes beside."""
    half_m, comes_mps = (0.9, 2.0) if kind == "car" else (0.3, 2.5)
    y = _beside(preset, _BESIDE_M, half_m)
    cast = [Player(1, kind, Straight((comes_mps * MEETS_S, y), math.pi, comes_mps))]
    name = f"oncoming {kind}, {speed_mps:g} m/s"
    return _case(name, straight_on(speed_mps, preset), street(25), cast, preset)


def overtaken(speed_mps: float, preset: str = "model") -> Case:
    """Two pedestrians walk along beside, one on each side, and are overtaken."""
    walks = 0.4 * speed_mps
    y = _beside(preset, _BESIDE_M, 0.3)
    cast = [
        Player(i, "pedestrian", Straight((-i - walks * MEETS_S, s * y), 0.0, walks)) for i, s in ((1, -1.0), (2, 1.0))
    ]
    name = f"overtaken pedestrians, {speed_mps:g} m/s"
    return _case(name, straight_on(speed_mps, preset), street(26), cast, preset)


def waiting(speed_mps: float, preset: str = "model") -> Case:
    """A pedestrian waits at the kerb."""
    cast = [Player(1, "pedestrian", Standing(-1.0, -_beside(preset, _BESIDE_M, 0.3), 1.57))]
    name = f"waiting at the kerb, {speed_mps:g} m/s"
    return _case(name, straight_on(speed_mps, preset), street(27), cast, preset)


def crossing_far(speed_mps: float, preset: str = "model") -> Case:
    """A pedestrian crosses far ahead and has left the path at least 3 s before the vehicle arrives."""
    begins_s = BEGINS_S + 0.2
    cast = [Player(1, "pedestrian", walk((4.0, -2.6), (4.0, 0.0), 1.5, begins_s))]
    name = f"crossing far ahead, {speed_mps:g} m/s"
    return _case(name, straight_on(speed_mps, preset), street(28), cast, preset)


def following(speed_mps: float, preset: str = "model") -> Case:
    """Behind a car at its speed, two seconds and two metres away."""
    x = rear_at("car", -speed_mps * MEETS_S + 2.0 * speed_mps + 2.0)
    cast = [Player(1, "car", Straight((x, 0.0), 0.0, speed_mps))]
    return _case(f"following, {speed_mps:g} m/s", straight_on(speed_mps, preset), street(29), cast, preset)


def bend_along_wall(speed_mps: float, preset: str = "model") -> Case:
    """A left-hand bend of 5 m radius, a wall 1.2 m outside of it."""
    radius_m, first, step = 5.0, -0.3, 0.2
    outside_m = radius_m + _beside(preset, 1.2, 0.1)
    pieces = [_chord(radius_m, outside_m, first + k * step, step) for k in range(22)]
    vehicle = IntoBend(radius_m, speed_mps, 1.4 * radius_m - speed_mps * (MEETS_S + 1.0))
    return _case(f"bend along a wall, {speed_mps:g} m/s", vehicle, square(*pieces), [], preset)


def _chord(radius_m: float, outside_m: float, turn: float, step: float) -> Solids:
    """A straight piece of the wall that follows the bend."""
    middle = turn + 0.5 * step
    centre = (outside_m * math.sin(middle), radius_m - outside_m * math.cos(middle), 0.75)
    return solid(BOX, centre, (0.52 * step * outside_m, 0.1, 0.75), "wall", "concrete", rotation_z(middle))


@dataclass(frozen=True, eq=False)
class Laps:
    """The same lap again and again."""

    lap: Motion
    length_s: float

    def at(self, t_s: float) -> Pose:
        """On the lap of that time."""
        return self.lap.at(t_s % self.length_s)


def yard(speed_mps: float, number: int, laps: int = 1) -> Case:
    """Laps of ``drive``."""
    scenario = drive(speed_mps, number)
    assert scenario.vehicle is not None
    scenario = replace(scenario, vehicle=Laps(scenario.vehicle, scenario.length_s))
    return Case(
        f"yard {number}, {speed_mps:g} m/s", "yard", scenario, dangerous=False, ends_s=1.5 + laps * scenario.length_s
    )
