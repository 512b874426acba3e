"""``drive``: a loop through a yard in which nothing is ever in the way. Whatever alarms here is false.

The vehicle leaves the middle of the west side and goes counter-clockwise: along a walled passage, between parked cars,
past pillars, through a narrow gate and over a ramp, with a bend between them.

Nobody but the driver knows that a bend begins or ends. So nothing stands straight ahead of a vehicle that turns off,
nor on the circle that it leaves, as near as it would have to be warned of: the walls are ``_ROOM_M`` beyond the lanes,
three seconds at 3 m/s from where the bend begins, and a quarter of a circle behind each bend is free.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Path, Standing
from spotter_sim.ramp import Ramp, RampedGround
from spotter_sim.scene import Mount, Scene, post, wall
from spotter_sim.solids import Solids, join
from spotter_sim.tour import Tour, rounded
from spotter_sim.vehicle import MODEL_CAR, Chassis

YARDS = 3
_LOOP_M = (22.0, 16.0)  # of the middle line, along x and y
_FIRST_CAR = 100  # actor id
_CAR_WIDTH_M, _CAR_PITCH_M = 1.8, 4.8
_PERIOD_S = 0.8  # scenario lengths are multiples of it: all sensors' periods fit
_ROOM_M = 7.0  # from the lanes to the yard's walls
_PAUSE_S = 1.5  # standing at the start


@dataclass(frozen=True)
class Plan:
    """What differs from yard to yard, in metres beside the vehicle's own outline."""

    car_room_m: float
    pillar_room_m: float
    gate_room_m: float
    passage_m: float  # whole width
    bend_m: float  # a bend begins so far before the corner
    rise_m: float  # of the ramp, over 2.75 m


def plan_of(yard: int) -> Plan:
    """The plan of yard 0, 1, 2: the first as issue and demo tell it, the others drawn around it."""
    if yard == 0:
        return Plan(0.9, 0.6, 0.30, 2.4, 3.0, 0.14)
    rng = np.random.default_rng([27, yard])
    return Plan(
        rng.uniform(0.7, 1.0),
        rng.uniform(0.45, 0.7),
        rng.uniform(0.25, 0.35),
        rng.uniform(2.0, 2.6),
        rng.uniform(2.6, 3.2),
        rng.uniform(0.11, 0.16),
    )


def drive(speed_mps: float = 2.0, yard: int = 0, chassis: Chassis = MODEL_CAR) -> Scenario:
    """One lap of a yard, again and again.

    Args:
        speed_mps: on the straights; bends are taken with at most 3 m/s^2 sideways.
        yard: 0 to ``YARDS`` - 1.

    Raises:
        ValueError: no such yard.
    """
    if not 0 <= yard < YARDS:
        raise ValueError(f"no yard {yard}; there are {YARDS}, from 0")
    plan, half_m = plan_of(yard), 0.5 * chassis.size_m[1]
    tour = Tour(loop(plan), speed_mps, start_s=_PAUSE_S)
    length_s = _PERIOD_S * math.ceil((tour.end_s + 0.5) / _PERIOD_S)
    name = "drive" if (speed_mps, yard, chassis) == (2.0, 0, MODEL_CAR) else f"drive-{yard}-{speed_mps:g}"
    return Scenario(name, length_s, _place(plan, half_m), tuple(_cars(plan, half_m)), vehicle=tour, chassis=chassis)


def loop(plan: Plan) -> Path:
    """The middle line of the lane."""
    x, y = _LOOP_M
    return rounded([(0.0, y / 2), (0.0, 0.0), (x, 0.0), (x, y), (0.0, y), (0.0, y / 2)], plan.bend_m)


def _cars(plan: Plan, half_m: float) -> list[Player]:
    """Two parked cars on each side of the south lane."""
    aside_m = half_m + plan.car_room_m + 0.5 * _CAR_WIDTH_M
    places = [(10.2 + _CAR_PITCH_M * k, side * aside_m) for k in range(2) for side in (-1.0, 1.0)]
    return [Player(_FIRST_CAR + i, "car", Standing(x, y)) for i, (x, y) in enumerate(places)]


def _place(plan: Plan, half_m: float) -> Scene:
    y = _LOOP_M[1]
    ramp = Ramp(3.5, 2.75, 1.5, plan.rise_m, (y - 0.8 - half_m, y + 0.8 + half_m))
    ground = RampedGround(ramp=ramp)
    fixtures = [ground.solids, *_outer_walls(), *_gate(plan, half_m), *_pillars(plan, half_m)]
    inner_m = 0.5 * plan.passage_m
    fixtures += [wall((side * inner_m - 0.05, side * inner_m + 0.05), (3.4, y - 7.6), 1.2) for side in (-1.0, 1.0)]
    return Scene(ground, join(fixtures), Mount(x_m=-6.0, y_m=-6.0, yaw_rad=np.pi / 4))


def _outer_walls() -> list[Solids]:
    x, y = _LOOP_M
    west, east, south, north = -_ROOM_M, x + _ROOM_M, -_ROOM_M, y + _ROOM_M
    return [
        wall((west - 0.2, west), (south, north), 2.0),
        wall((east, east + 0.2), (south, north), 2.0),
        wall((west, east), (south - 0.2, south), 2.0),
        wall((west, east), (north, north + 0.2), 2.0),
    ]


def _pillars(plan: Plan, half_m: float) -> list[Solids]:
    x, radius_m = _LOOP_M[0], 0.15
    aside_m = half_m + plan.pillar_room_m + radius_m
    return [post(x + side * aside_m, y, 0.0, 2.5, radius_m) for y in (8.0, 9.8, 11.6) for side in (-1.0, 1.0)]


def _gate(plan: Plan, half_m: float) -> list[Solids]:
    """Two pieces of wall across the north lane with an opening little wider than the vehicle."""
    x, y = _LOOP_M[0] - 8.0, _LOOP_M[1]
    open_m = half_m + plan.gate_room_m
    return [
        wall((x - 0.06, x + 0.06), (y + open_m, y + 2.5), 1.6),
        wall((x - 0.06, x + 0.06), (y - 2.5, y - open_m), 1.6),
    ]
