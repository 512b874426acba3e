"""Random roadside scenes, seeded: what the classifier of the infrastructure lidar is trained and judged on.

Map: the pole stands at (0, 0) on the kerb. The street runs along y; across it, in x: the near pavement behind the
pole, parked cars, a cycle lane, two lanes, a cycle lane, parked cars, and a square with people at the far side; two
crossings lead over it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from spotter_sim.bodies import DEFAULT_SIZE_M
from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Straight
from spotter_sim.scene import Ground, Mount, Scene, bush, facade, post, tree, wall
from spotter_sim.solids import Solids, box, join

RoadsideKind = Literal["open", "level", "facade", "trees", "slope", "bus", "crowd"]
LENGTH_S = 10.0
REACH_M = 70.0  # objects stand or pass within this distance along the street
_NORTH, _SOUTH = np.pi / 2, -np.pi / 2
_LANES = ((6.2, _SOUTH), (9.5, _NORTH))  # x, direction
_CYCLE_LANES = ((4.2, _SOUTH), (11.6, _NORTH))
_PARKING_X_M = (2.1, 13.7)
_SQUARE_X_M = (17.0, 36.0)
_NEAR_PAVEMENT_X_M = (-3.9, -1.0)
_CROSSINGS_Y_M = (-9.0, 11.0)
_SLOPE = {"slope": (0.05, 0.09)}
_BUS_STOP_X_M, _CROWD_X_M, _CROWD_Y_M, _CROWD = 2.5, (-3.9, 5.0), (-6.0, 6.0), 50
# Shares of the objects asked for.
_MIX = {"group": 0.24, "pedestrian": 0.22, "cyclist": 0.14, "parked": 0.18, "car": 0.16, "bus": 0.03, "truck": 0.03}
_SIZE_SPREAD = {
    "pedestrian": (0.10, 0.14, 0.11),
    "cyclist": (0.06, 0.08, 0.06),
    "car": (0.13, 0.06, 0.12),
    "bus": (0.15, 0.02, 0.06),
    "truck": (0.25, 0.04, 0.12),
}


def roadside(seed: int, objects: int = 60, kind: RoadsideKind = "open") -> Scenario:
    """A street scene with about ``objects`` people and vehicles.

    Args:
        seed: everything follows from it; scenes of different seeds share only the plan of the street.
        kind: ``open`` slopes by about 2 % and bends; ``level`` does not; ``facade`` has a house 5 m behind the pole;
            ``trees`` has trees beside it; ``slope`` falls by 5 to 9 %; with ``bus`` one stands at the kerb beside
            the pole, with ``crowd`` fifty people stand around it.

    Raises:
        ValueError: unknown kind.
    """
    if kind not in get_args(RoadsideKind):
        raise ValueError(f"no roadside kind {kind!r}; known: {', '.join(get_args(RoadsideKind))}")
    rng = np.random.default_rng([seed, get_args(RoadsideKind).index(kind)])
    scene = _place(rng, kind)
    cast = tuple(_Crowd(rng, objects).players(kind))
    return Scenario(f"roadside-{kind}-{seed}-{objects}", LENGTH_S, scene, cast)


def _place(rng: np.random.Generator, kind: str) -> Scene:
    ground = Ground()
    if kind != "level":
        slope, turn = rng.uniform(*_SLOPE.get(kind, (0.012, 0.028))), rng.uniform(-np.pi, np.pi)
        bend = rng.uniform(-3e-4, 3e-4, 2)
        ground = Ground(slope * np.cos(turn), slope * np.sin(turn), bend[0], bend[1])
    mount = Mount(
        x_m=0.0,
        y_m=0.0,
        height_m=rng.uniform(5.2, 5.8),
        yaw_rad=rng.uniform(-1.3, 1.3),
        pitch_rad=np.radians(rng.uniform(12.0, 15.0)),
        roll_rad=np.radians(rng.uniform(-2.0, 2.0)),
    )
    return Scene(ground, join(list(_fixtures(rng, kind, ground))), mount)


def _fixtures(rng: np.random.Generator, kind: str, ground: Ground) -> Iterator[Solids]:
    """Everything that a classifier must not take for a person or a vehicle."""

    def z(x: float, y: float) -> float:
        return float(ground.height(x, y))

    yield facade((39.0, -75.0), (39.0, 75.0), rng.uniform(7, 13), rng)
    if kind == "facade":
        yield facade((-5.4, -60.0), (-5.4, 60.0), rng.uniform(9, 15), rng)
    if kind == "trees":
        for side in (-1.0, 1.0):
            x, y = rng.uniform(-3.0, 0.0), side * rng.uniform(2.5, 4.0)
            yield tree(x, y, z(x, y), rng.uniform(5.5, 8.0), rng)
    for x in (0.3, 15.7):  # the two strips of street furniture
        for y in np.arange(-66.0, 70.0, rng.uniform(9.0, 13.0)) + rng.uniform(2.0, 4.0):
            yield _furniture(rng, x, float(y), z(x, float(y)))
    for _ in range(14 if kind == "trees" else 8):
        x, y = rng.uniform(-9.0, -6.5) if kind != "facade" else 15.7, rng.uniform(-REACH_M, REACH_M)
        yield tree(x, y, z(x, y), rng.uniform(4.5, 9.0), rng)
    for _ in range(10):
        x, y = rng.uniform(-8.0, -4.8) if kind != "facade" else 37.0, rng.uniform(-REACH_M, REACH_M)
        yield bush(x, y, z(x, y), rng.uniform(0.4, 1.2), rng)
    for _ in range(6):
        x, y = rng.choice([-4.6, 16.4, 37.5]), rng.uniform(-REACH_M, REACH_M)
        length, height = rng.uniform(2.0, 12.0), rng.uniform(0.8, 1.8)
        yield wall((x - 0.08, x + 0.08), (y - length / 2, y + length / 2), z(x, y) + height)


def _furniture(rng: np.random.Generator, x: float, y: float, z: float) -> Solids:
    """One piece: a lamp post, a sign post, bollards, a cabinet, a bench, a tree or a bush."""
    choice = rng.integers(7)
    if choice == 0:
        return post(x, y, z, rng.uniform(5, 8), rng.uniform(0.07, 0.12))
    if choice == 1:
        sign_z = (z + 2.6 - rng.uniform(0.5, 0.9), z + 2.6)
        sign = box((x - 0.03, x + 0.03), (y - 0.3, y + 0.3), sign_z, "pole", "metal")
        return join([post(x, y, z, 2.6, 0.04), sign])
    if choice == 2:
        return join([post(x, y + 1.5 * k, z, rng.uniform(0.8, 1.1), 0.08) for k in range(3)])
    if choice == 3:
        deep, wide, high = rng.uniform(0.15, 0.35), rng.uniform(0.3, 0.8), rng.uniform(0.8, 1.6)
        return wall((x - deep, x + deep), (y - wide, y + wide), z + high)
    if choice == 4:
        return join([wall((x - 0.25, x + 0.25), (y - 0.9, y + 0.9), z + 0.45), post(x - 0.2, y, z, 0.85, 0.05)])
    if choice == 5:
        return tree(x, y, z, rng.uniform(4, 7), rng)
    return bush(x, y, z, rng.uniform(0.35, 0.8), rng)


@dataclass
class _Crowd:
    """Draws people and vehicles that do not stand in each other; ids count from 1."""

    rng: np.random.Generator
    objects: int

    def players(self, kind: str) -> list[Player]:
        """As many of each kind as the mix says, as far as there is room."""
        self._taken: list[tuple[float, float, float]] = []  # x, y, radius at the middle of the scenario
        self._cast: list[Player] = []
        self._beside_the_pole(kind)
        speeds = [self.rng.uniform(6.0, 13.0) for _ in _LANES]  # one speed per lane: nobody runs into another
        for name, share in _MIX.items():
            goal = len(self._cast) + round(share * self.objects)
            for _ in range(20 * self.objects):
                if len(self._cast) >= goal:
                    break
                self._draw(name, speeds, goal - len(self._cast))
        return self._cast

    def _beside_the_pole(self, kind: str) -> None:
        """What may fool a calibration: a roof for a road, or hardly any road between the people."""
        if kind == "bus":
            self._add("bus", _BUS_STOP_X_M, self.rng.uniform(-5.0, 5.0), _NORTH, 0.0)
        for _ in range(_CROWD if kind == "crowd" else 0):
            x, y = self.rng.uniform(*_CROWD_X_M), self.rng.uniform(*_CROWD_Y_M)
            if np.hypot(x, y) > 0.8:
                self._add("pedestrian", x, y, self.rng.uniform(-np.pi, np.pi), 0.0)

    def _draw(self, name: str, speeds: list[float], room: int) -> None:
        rng = self.rng
        y = rng.uniform(-REACH_M, REACH_M)
        if name in ("group", "pedestrian"):
            self._people(y, min(room, int(rng.integers(2, 6))) if name == "group" else 1)
        elif name == "cyclist":
            x, yaw = _CYCLE_LANES[rng.integers(len(_CYCLE_LANES))]
            self._add("cyclist", x + rng.uniform(-0.3, 0.3), y, yaw, 4.5)
        elif name == "parked":
            x = _PARKING_X_M[rng.integers(len(_PARKING_X_M))] + rng.uniform(-0.1, 0.1)
            self._add("car", x, y, (_NORTH if rng.random() < 0.5 else _SOUTH) + rng.normal(0, 0.03), 0.0)
        else:
            lane = int(rng.integers(len(_LANES)))
            x, yaw = _LANES[lane]
            self._add(name, x + rng.uniform(-0.2, 0.2), y, yaw, speeds[lane])

    def _people(self, y: float, count: int) -> None:
        """One person, or a group that walks together."""
        rng = self.rng
        place = rng.choice(["pavement", "crossing", "square"], p=[0.35, 0.2, 0.45])
        near = place != "square"
        x = rng.uniform(*(_NEAR_PAVEMENT_X_M if place == "pavement" else _SQUARE_X_M))
        yaw = rng.choice([_NORTH, _SOUTH]) if near else rng.uniform(-np.pi, np.pi)
        if place == "crossing":
            x, y = rng.uniform(-1.0, 16.0), rng.choice(_CROSSINGS_Y_M) + rng.uniform(-1.8, 1.8)
            yaw = rng.choice([0.0, np.pi])
        speed = 0.0 if rng.random() < 0.25 else rng.uniform(0.9, 1.7)
        for _ in range(count):
            dx, dy = rng.normal(0.0, 0.25 if near else 0.6, 2) * (count > 1)
            turn = rng.uniform(-np.pi, np.pi) if speed == 0.0 else rng.normal(0, 0.03)
            self._add("pedestrian", x + dx, y + dy, yaw + turn, speed)

    def _add(self, kind: str, x: float, y: float, yaw: float, speed: float) -> None:
        """Put it there at the middle of the scenario, unless something stands there already."""
        spread = np.array(_SIZE_SPREAD[kind])
        size = np.array(DEFAULT_SIZE_M[kind]) * (1 + spread * self.rng.uniform(-1, 1, 3))
        length, width, height = (float(side) for side in size)
        if kind == "pedestrian" and self.rng.random() < 0.08:
            height *= 0.72  # a child
        radius = 0.32 if kind == "pedestrian" else 0.5 * length + 0.4
        if any(np.hypot(x - a, y - b) < radius + r and (abs(x - a) < 1.9 or r < 0.5) for a, b, r in self._taken):
            return
        self._taken.append((x, y, radius))
        way = 0.5 * LENGTH_S * speed
        start = (x - way * np.cos(yaw), y - way * np.sin(yaw))
        motion = Straight(start, yaw, speed, LENGTH_S)
        self._cast.append(Player(len(self._cast) + 1, kind, motion, (length, width, height)))
