"""Straight drives for tests and measurements: between parked cars, along a passage, towards a box.

The vehicle stands for ``WAIT_S`` (the radar learns its background), then drives along x from the map's origin.
"""

from __future__ import annotations

from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Motion, Standing, line
from spotter_sim.scene import Ground, Mount, Scene, wall
from spotter_sim.solids import Solids, box, join
from spotter_sim.tour import Tour
from spotter_sim.vehicle import MODEL_CAR

WAIT_S = 3.0
LENGTH_S = 60.0
HALF_WIDTH_M = MODEL_CAR.size_m[1] / 2
_CAR_WIDTH_M, _CAR_PITCH_M = 1.8, 5.0
_FIRST_CAR = 10


def parked_lane(speed_mps: float, room_m: float = 0.9) -> Scenario:
    """14 m between three parked cars on each side, abreast, with so much room to each."""
    aside_m = HALF_WIDTH_M + room_m + _CAR_WIDTH_M / 2
    places = [(4.0 + _CAR_PITCH_M * k, side * aside_m) for k in range(3) for side in (1.0, -1.0)]
    cars = tuple(Player(_FIRST_CAR + i, "car", Standing(x, y)) for i, (x, y) in enumerate(places))
    return _drive(f"parked_lane {speed_mps} {room_m}", [], 14.0, speed_mps, cars)


def passage(speed_mps: float, width_m: float = 2.4) -> Scenario:
    """12 m along a passage between two walls; an obstacle far ahead of its end."""
    half_m = width_m / 2
    walls = [wall((-1.0, 14.0), y, 2.1) for y in ((half_m, half_m + 0.2), (-half_m - 0.2, -half_m))]
    return _drive(f"passage {speed_mps} {width_m}", [*walls, _box(22.0, 0.4)], 12.0, speed_mps)


def box_ahead(speed_mps: float, at_m: float = 10.0, size_m: float = 0.4, beside_m: float = 0.0) -> Scenario:
    """Straight at a box, and through it: nobody brakes."""
    name = f"box_ahead {speed_mps} {at_m} {size_m} {beside_m}"
    return _drive(name, [_box(at_m, size_m, beside_m)], at_m + 1.0, speed_mps)


def person_ahead(speed_mps: float, motion: Motion) -> Scenario:
    """Straight on in an open yard in which one person moves."""
    return _drive(
        f"person_ahead {speed_mps} {motion}", [], 14.0, speed_mps, (Player(_FIRST_CAR, "pedestrian", motion),)
    )


def _drive(
    name: str, fixtures: list[Solids], length_m: float, speed_mps: float, cast: tuple[Player, ...] = ()
) -> Scenario:
    yard = [
        wall((30.0, 30.2), (-6.2, 6.2), 2.1),
        wall((-6.2, -6.0), (-6.2, 6.2), 2.1),
        wall((-6.2, 30.2), (6.0, 6.2), 2.1),
        wall((-6.2, 30.2), (-6.2, -6.0), 2.1),
    ]
    scene = Scene(Ground(), join([*yard, *fixtures]), Mount(x_m=8.6, y_m=-8.0, yaw_rad=0.0))
    tour = Tour(line((0.0, 0.0), (length_m, 0.0)), speed_mps, start_s=WAIT_S, accel_mps2=3.0, brake_mps2=20.0)
    return Scenario(name, LENGTH_S, scene, cast, vehicle=tour)


def _box(at_m: float, size_m: float, beside_m: float = 0.0) -> Solids:
    half_m = size_m / 2
    return box((at_m, at_m + size_m), (beside_m - half_m, beside_m + half_m), (0.0, size_m), "wall", "concrete")
