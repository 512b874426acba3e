"""``emergency``: a lap with a danger on every side, one after the other. A driver brakes late, but in time.

South: a child runs out from behind a parked car. East: a car reverses out of its bay. North: a pedestrian crosses from
the far side, then a cyclist from the near one. West: an oncoming car turns across. Each leaves the way again, and
goes back to where it began while the vehicle is elsewhere.
"""

from __future__ import annotations

import math

import numpy as np

from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Errand, Path, Ride, Standing, bezier, line
from spotter_sim.scene import Ground, Mount, Scene, post, wall
from spotter_sim.solids import join
from spotter_sim.tour import Stop, Tour, rounded

SPEED_MPS = 1.5
STOPS_M = {"child": 12.0, "reversing": 28.1, "pedestrian": 42.5, "cyclist": 50.5, "turning": 62.5}
_WAITS_S = {"reversing": 5.6}  # until the way is free; elsewhere:
_WAIT_S = 3.0
_PERIOD_S = 0.8
_LOOP_M = (24.0, 12.0)
_SMALL_CAR_M = (2.70, 1.56, 1.46)
_CHILD_M = (0.40, 0.42, 1.15)
_BACK_S = {"reversing": 4.2}  # after it began, everybody goes back to where it was; elsewhere:
_LATER_S = 12.0


def emergency() -> Scenario:
    """The lap with all five."""
    x, y = _LOOP_M
    way = rounded([(2.0, 0.0), (x, 0.0), (x, y), (0.0, y), (0.0, 0.0), (2.0, 0.0)], 1.9)
    stops = tuple(Stop(at_m, _WAITS_S.get(name, _WAIT_S)) for name, at_m in STOPS_M.items())
    tour = Tour(way, SPEED_MPS, start_s=1.5, stops=stops, brake_mps2=2.8)
    length_s = _PERIOD_S * math.ceil((tour.end_s + 0.5) / _PERIOD_S)
    return Scenario("emergency", length_s, _place(), tuple(_cast(tour, length_s)), vehicle=tour)


def _place() -> Scene:
    walls = [
        wall((-5.0, 30.0), (-4.2, -4.0), 2.0),
        wall((-5.0, 30.0), (16.0, 16.2), 2.0),
        wall((-5.2, -5.0), (-4.0, 16.0), 2.0),
        wall((30.0, 30.2), (-4.0, 16.0), 2.0),
    ]
    posts = [post(8.0, 2.5, 0.0, 1.0), post(19.0, 2.2, 0.0, 1.0), post(2.6, 6.0, 0.0, 1.0), post(21.0, 9.0, 0.0, 1.0)]
    return Scene(Ground(), join([*walls, *posts]), Mount(x_m=-8.0, y_m=-8.0, yaw_rad=math.pi / 4))


def _cast(tour: Tour, length_s: float) -> list[Player]:
    stop_s = {name: tour.when(at_m) for name, at_m in STOPS_M.items()}

    def there_and_back(name: str, way: Path, speed_mps: float, before_s: float, *, reverse: bool = False) -> Errand:
        """On its way ``before_s`` before the vehicle comes to rest; ``reverse`` goes there in reverse gear."""
        start_s = stop_s[name] - before_s
        points = [way.point(way.length_m * k / 200)[:2] for k in range(201)]
        again = Path(np.array(points[::-1]))
        there = Ride(way, start_s, speed_mps, 2.0, backwards=reverse)
        return Errand(
            (there, Ride(again, start_s + _BACK_S.get(name, _LATER_S), speed_mps, 2.0, backwards=not reverse)), length_s
        )

    def walk(name: str, way: Path, speed_mps: float, before_s: float) -> Errand:
        start_s = stop_s[name] - before_s
        end, begin = way.point(way.length_m)[:2], way.point(0.0)[:2]
        again = line(end, begin)
        return Errand((Ride(way, start_s, speed_mps, 2.5), Ride(again, start_s + _LATER_S, speed_mps, 2.5)), length_s)

    front_m = 2.0 + STOPS_M["child"] + 0.2  # x of the bumper at the first stop
    north_x = {name: _north_x(tour, name) for name in ("pedestrian", "cyclist")}
    across = bezier((-2.4, -2.5), (-2.4, 2.5), (-1.2, 3.6), (4.5, 3.6))
    return [
        Player(1, "pedestrian", walk("child", line((front_m + 0.6, -3.2), (front_m + 0.6, 2.6)), 1.4, 2.2), _CHILD_M),
        Player(2, "car", Standing(front_m + 0.2 - 2.15, -1.7)),
        Player(
            3, "car", there_and_back("reversing", line((27.6, 8.4), (24.6, 8.4)), 1.2, 2.0, reverse=True), _SMALL_CAR_M
        ),
        Player(
            4,
            "pedestrian",
            walk("pedestrian", line((north_x["pedestrian"], 8.6), (north_x["pedestrian"], 15.0)), 1.5, 2.4),
        ),
        Player(5, "cyclist", walk("cyclist", line((north_x["cyclist"], 15.0), (north_x["cyclist"], 7.0)), 2.5, 1.6)),
        Player(6, "car", there_and_back("turning", across, 1.8, 2.9), _SMALL_CAR_M),
    ]


def _north_x(tour: Tour, name: str) -> float:
    """Where somebody crosses: 0.7 m before the bumper of the stopped vehicle, which heads along -x there."""
    return tour.at(tour.when(STOPS_M[name]) + 0.5).x_m - 0.9
