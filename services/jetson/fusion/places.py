"""Places in the vehicle's frame: near one another, in a sensor's view, carried along by our own motion."""

from __future__ import annotations

import math

from services.jetson.fusion.evidence import Place

# Half of each sensor's forward view, degrees. A sensor says nothing about a place beside it.
HALF_VIEW_DEG = {"lidar": 20.0, "camera": 18.0, "radar": 60.0}
WIDE_DEG = 60.0  # of a sensor that is not listed
ODOMETRY_ERROR = 0.3  # share of the way by which the reported motion may be wrong
FORGET_M = 15.0  # a place beside the way and so far from us is forgotten


def gap_m(one: Place, other: Place) -> float:
    """Between the edges of two places; negative when they overlap."""
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) - one.radius_m - other.radius_m


def in_view(sensor: str, place: Place | None) -> bool:
    """Whether the sensor looks in the place's direction; an unknown place is somewhere ahead."""
    if place is None:
        return True
    distance_m = math.hypot(place.x_m, place.y_m)
    if distance_m <= place.radius_m:
        return True
    bearing = abs(math.atan2(place.y_m, place.x_m)) - math.asin(place.radius_m / distance_m)
    return bearing <= math.radians(HALF_VIEW_DEG.get(sensor, WIDE_DEG))


def carried(place: Place, way_m: float, turn_rad: float, half_width_m: float) -> Place:
    """The place after we have moved ``way_m`` forward and turned ``turn_rad`` to the left.

    What lies in front of our own width cannot pass through us: it stays at the bumper. Either we push it along, or it
    has gone, or the motion is wrong; only a sensor or a person can tell.
    """
    x, y = place.x_m - way_m, place.y_m
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    x, y = cos * x + sin * y, cos * y - sin * x
    if x < 0.0 <= place.x_m and abs(y) - place.radius_m < half_width_m:
        x = 0.0
    return Place(x, y, place.radius_m)


def is_behind(place: Place, travelled_m: float, length_m: float) -> bool:
    """Past our rear, whatever the motion's error."""
    return place.x_m + place.radius_m + ODOMETRY_ERROR * travelled_m < -length_m


def is_beside(place: Place, travelled_m: float, half_width_m: float) -> bool:
    """Outside our way by turning or passing, whatever the motion's error."""
    return abs(place.y_m) - place.radius_m - ODOMETRY_ERROR * travelled_m > half_width_m
