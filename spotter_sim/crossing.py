"""The demonstration's place and cast: a walled yard with the vehicle, and the street beside it with the pole.

Map: the vehicle stands at the origin and looks along +x to a gate; the street runs along y, left to right beyond the
front wall; the pole stands at the corner and looks along the street (+y), the yard at its left.
"""

from __future__ import annotations

import numpy as np

from spotter_sim.model import Fault, Player, Scenario
from spotter_sim.motion import Circuit, Errand, Path, Ride, Straight, bezier, ellipse, line
from spotter_sim.scene import Ground, Mount, Scene, facade, post, tree, wall
from spotter_sim.solids import join

LENGTH_S = 15.0
NORTH, SOUTH = np.pi / 2, -np.pi / 2
PERSON, SMALL_CAR = 1, 2
SMALL_CAR_SIZE_M = (2.70, 1.56, 1.46)


def yard_and_street() -> Scene:
    """Walls 4 to 7 m around the vehicle, a gate ahead, two bollards; houses, trees and lamp posts on the street."""
    rng = np.random.default_rng(7)
    walls = [
        wall((-4.2, -4.0), (-5.0, 5.0), 2.1),
        wall((-4.2, 7.2), (4.8, 5.0), 2.1),
        wall((-4.2, 7.2), (-5.0, -4.8), 2.1),
        wall((7.0, 7.2), (1.25, 5.0), 2.1),
        wall((7.0, 7.2), (-5.0, -1.25), 2.1),
    ]
    furniture = [post(3.6, 1.75, 0.0, 0.9, 0.07), post(2.7, -1.6, 0.0, 0.9, 0.07)]
    street = [
        facade((23.0, -38.0), (23.0, 75.0), 9.0, rng),
        facade((-14.0, -30.0), (-14.0, 60.0), 12.0, rng),
        facade((-14.0, -30.0), (9.0, -30.0), 12.0, rng),
    ]
    street += [post(9.2, y, 0.0, 6.0) for y in (12.0, 36.0, 60.0)]
    street += [post(18.5, y, 0.0, 2.4, 0.04) for y in (3.0, 27.0)]
    street += [tree(20.5, y, 0.0, 6.5 + 0.3 * i, rng) for i, y in enumerate((-6.0, 9.0, 21.0, 38.0, 55.0))]
    return Scene(Ground(), join(walls + furniture + street), Mount(x_m=8.6, y_m=-8.0, yaw_rad=NORTH))


def person_errand() -> Errand:
    """From the left corner into the corridor, head-on to the vehicle, a short stop, back to the corner."""
    waiting, stop = (5.2, 2.3), (0.80, 0.0)
    turn_in = bezier(waiting, (4.3, 1.0), (4.0, 0.0), (3.2, 0.0))
    approach = Path(np.vstack([_points(turn_in), np.linspace((3.2, 0.0), stop, 120)[1:]]))
    back = bezier(stop, (1.5, 0.8), (2.8, 3.6), waiting)
    come = Ride(approach, start_s=0.1, speed_mps=1.35, accel_mps2=2.2)
    return Errand((come, Ride(back, come.start_s + come.duration_s + 0.8, speed_mps=1.3)), LENGTH_S)


def car_errand() -> Errand:
    """The small car drives in through the gate, stops in front of the vehicle and backs out again."""
    half = 0.5 * SMALL_CAR_SIZE_M[0]
    outside, inside = (6.4 + half, 0.0), (0.74 + half, 0.0)
    come = Ride(line(outside, inside), start_s=7.3, speed_mps=1.5, accel_mps2=1.5)
    out = Ride(line(inside, outside), come.start_s + come.duration_s + 0.8, 1.6, 1.2, backwards=True)
    return Errand((come, out), LENGTH_S)


def _points(path: Path) -> np.ndarray:
    return np.array([path.point(s)[:2] for s in np.linspace(0.0, path.length_m, 400)])


def street_traffic() -> list[Player]:
    """Cars, a bus and cyclists drive past under the pole; pedestrians walk round and cross."""
    cast = _stream(10, "car", lane_x_m=15.7, yaw_rad=NORTH, speed_mps=13.4, first_y_m=-104.0)
    cast += _stream(20, "car", lane_x_m=12.2, yaw_rad=SOUTH, speed_mps=12.0, first_y_m=70.0)
    cast += _stream(30, "bus", lane_x_m=15.7, yaw_rad=NORTH, speed_mps=8.0, first_y_m=-2.0)
    cast += _stream(40, "cyclist", lane_x_m=17.6, yaw_rad=NORTH, speed_mps=4.6, first_y_m=-30.0)
    cast += _stream(50, "cyclist", lane_x_m=10.4, yaw_rad=SOUTH, speed_mps=5.2, first_y_m=20.0)
    for i, (y, turn, phase) in enumerate(((6.0, 1.0, 0.0), (14.5, -1.0, 0.3), (27.0, 1.0, 0.1))):
        round_the_tree = ellipse((20.4, y), (1.5, 4.2), turn)  # 20 m
        cast.append(Player(60 + i, "pedestrian", Circuit(round_the_tree, LENGTH_S, 1, phase)))
    there, again = line((8.6, 3.0), (8.6, 12.0)), line((8.6, 12.0), (8.6, 3.0))
    cast.append(Player(65, "pedestrian", Errand((Ride(there, 0.5, 1.45), Ride(again, 8.0, 1.45)), LENGTH_S)))
    across = Ride(line((9.2, 18.0), (18.6, 18.0)), 1.0, 1.9, 1.5)
    back = Ride(line((18.6, 18.0), (9.2, 18.0)), 8.3, 1.9, 1.5)
    return [*cast, Player(70, "pedestrian", Errand((across, back), LENGTH_S))]


def _stream(
    first_id: int, kind: str, lane_x_m: float, yaw_rad: float, speed_mps: float, first_y_m: float
) -> list[Player]:
    """Vehicles one loop apart, so that at the loop's end each stands where the next began.

    The identity moves on by one there; beyond the street's ends (95 m) nobody is.
    """
    gap_m = speed_mps * LENGTH_S
    ahead = 1.0 if yaw_rad > 0 else -1.0
    starts = [first_y_m + k * gap_m * ahead for k in range(-3, 4)]
    seen = [y for y in starts if max(y, y + ahead * gap_m) > -95.0 and min(y, y + ahead * gap_m) < 95.0]
    return [
        Player(first_id + i, kind, Straight((lane_x_m, y), yaw_rad, speed_mps, LENGTH_S)) for i, y in enumerate(seen)
    ]


def crossing() -> Scenario:
    """A walker and a small car come close to the standing vehicle and leave again, with traffic behind them."""
    approach = [
        Player(PERSON, "pedestrian", person_errand()),
        Player(SMALL_CAR, "car", car_errand(), SMALL_CAR_SIZE_M),
    ]
    return Scenario("crossing", LENGTH_S, yard_and_street(), (*approach, *street_traffic()))


def empty() -> Scenario:
    """The same place with nobody in it."""
    return Scenario("empty", 10.0, yard_and_street())


def faults() -> Scenario:
    """The crossing five times, while one sensor after the other fails; at the end two at once, then all."""
    timeline = (
        Fault("lidar_blocked", 4.0, 9.0),
        Fault("lidar_unplugged", 13.0, 18.0),
        Fault("camera_dark", 22.0, 27.0),
        Fault("camera_unplugged", 31.0, 36.0),
        Fault("radar_silent", 40.0, 45.0),
        Fault("radar_unplugged", 49.0, 54.0),
        Fault("lidar_blocked", 58.0, 63.0),
        Fault("camera_dark", 58.0, 63.0),
        Fault("lidar_blocked", 67.0, 72.0),
        Fault("camera_dark", 67.0, 72.0),
        Fault("radar_silent", 67.0, 72.0),
    )
    once = crossing()
    return Scenario("faults", 5 * LENGTH_S, once.scene, once.cast, timeline)
