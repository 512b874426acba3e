"""Cases in which the vehicle hits something if it does not brake, scaled from those of Euro NCAP.

Sources: Euro NCAP test protocols AEB Car-to-Car (CCRs, CCRm, CCRb, CCFtap) and AEB/LSS Vulnerable Road Users (CPFA,
CPNA, CPLA, CPNCO, CBNA, CBLA), v4: their geometry, at speeds of a model car and of a one metre wide cart.
"""

from __future__ import annotations

from spotter_sim.model import Player
from spotter_sim.motion import Standing, Straight, bezier, line
from spotter_sim.scene import post
from spotter_sim.solids import box
from spotter_sim.tour import Tour
from spotter_tools.prove.case import BEGINS_S, PRESETS, Case
from spotter_tools.prove.places import (
    CHILD_M,
    MEETS_S,
    Backwards,
    IntoBend,
    case,
    rear_at,
    square,
    straight_on,
    street,
    walk,
)

_OTHER = 1  # actor id
_HEADWAY_S = 1.2
_LEAD_BRAKE_MPS2 = 2.0


def car_stopped(speed_mps: float, aside_m: float = 0.0, preset: str = "model") -> Case:
    """CCRs: a car stands in the lane, its rear to us."""
    cast = [Player(_OTHER, "car", Standing(rear_at("car", 0.0), aside_m))]
    name = f"car stopped, {speed_mps:g} m/s, {aside_m:+g} m"
    return case(name, straight_on(speed_mps, preset), street(1), cast, dangerous=True, preset=preset)


def car_slower(speed_mps: float, preset: str = "model") -> Case:
    """CCRm: a car ahead drives at 0.4 of our speed."""
    lead = 0.4 * speed_mps
    cast = [Player(_OTHER, "car", Straight((rear_at("car", -lead * MEETS_S), 0.0), 0.0, lead))]
    name = f"car slower, {speed_mps:g} m/s"
    return case(name, straight_on(speed_mps, preset), street(2), cast, dangerous=True, preset=preset)


def car_braking(speed_mps: float, preset: str = "model") -> Case:
    """CCRb: a car 1.2 s ahead at our speed brakes to rest."""
    braking_s = BEGINS_S + 1.5
    front_m = -speed_mps * MEETS_S
    start_m = rear_at("car", front_m + _HEADWAY_S * speed_mps)
    way_m = speed_mps * braking_s + speed_mps**2 / (2 * _LEAD_BRAKE_MPS2)
    lead = Tour(
        line((start_m, 0.0), (start_m + way_m, 0.0)), speed_mps, brake_mps2=_LEAD_BRAKE_MPS2, first_mps=speed_mps
    )
    cast = [Player(_OTHER, "car", lead)]
    name = f"car braking, {speed_mps:g} m/s"
    return case(name, straight_on(speed_mps, preset), street(3), cast, dangerous=True, preset=preset)


def pedestrian_crossing(
    speed_mps: float, side: str, percent: int, preset: str = "model", *, dark: bool = False
) -> Case:
    """CPNA, CPFA: a pedestrian crosses from the near (right) or far side and is hit at 25, 50 or 75 % of the width."""
    from_y, walks_mps = (-2.6, 1.2) if side == "near" else (3.2, 1.6)
    width_m = PRESETS[preset].chassis.size_m[1]
    hit_y = (percent / 100.0 - 0.5) * width_m * (1.0 if side == "near" else -1.0)
    motion = walk((0.15, from_y), (0.15, hit_y), walks_mps, MEETS_S)
    cast = [Player(_OTHER, "pedestrian", motion, material="dark" if dark else "")]
    name = f"{'dark clothes, ' if dark else 'pedestrian '}from {side}, {percent} %, {speed_mps:g} m/s"
    return case(name, straight_on(speed_mps, preset), street(4), cast, dangerous=True, preset=preset)


def pedestrian_along(speed_mps: float, walks_mps: float, preset: str = "model") -> Case:
    """CPLA: a pedestrian walks ahead of us in our direction, or stands with the back to us."""
    motion = Straight((0.15 - walks_mps * MEETS_S, 0.05), 0.0, walks_mps) if walks_mps else Standing(0.15, 0.05)
    cast = [Player(_OTHER, "pedestrian", motion)]
    name = f"pedestrian along, {speed_mps:g} m/s, walks {walks_mps:g} m/s"
    return case(name, straight_on(speed_mps, preset), street(5), cast, dangerous=True, preset=preset)


def child_behind_car(speed_mps: float, preset: str = "model") -> Case:
    """CPNCO: a child runs out from behind a parked car on the near side."""
    half_m = 0.5 * PRESETS[preset].chassis.size_m[1]
    parked_y = -(half_m + 0.7 + 0.9)
    child = walk((0.2, -3.0), (0.2, 0.0), 1.4, MEETS_S)
    cast = [
        Player(_OTHER, "pedestrian", child, CHILD_M),
        Player(2, "car", Standing(-0.35 - 2.15, parked_y)),
        Player(3, "car", Standing(-0.35 - 2.15 - 4.9, parked_y)),
    ]
    name = f"child behind a parked car, {speed_mps:g} m/s"
    return case(name, straight_on(speed_mps, preset), street(6), cast, dangerous=True, preset=preset)


def cyclist_crossing(speed_mps: float, side: str, preset: str = "model") -> Case:
    """CBNA, CBFA: a cyclist crosses at 2.5 m/s."""
    from_y = -3.0 if side == "near" else 3.2
    motion = walk((0.4, from_y), (0.4, 0.0), 2.5, MEETS_S)
    name = f"cyclist from {side}, {speed_mps:g} m/s"
    cast = [Player(_OTHER, "cyclist", motion)]
    return case(name, straight_on(speed_mps, preset), street(7), cast, dangerous=True, preset=preset)


def cyclist_along(speed_mps: float, preset: str = "model") -> Case:
    """CBLA: a cyclist ahead rides at 0.5 of our speed."""
    rides = 0.5 * speed_mps
    cast = [Player(_OTHER, "cyclist", Straight((rear_at("cyclist", -rides * MEETS_S), 0.0), 0.0, rides))]
    name = f"cyclist along, {speed_mps:g} m/s"
    return case(name, straight_on(speed_mps, preset), street(8), cast, dangerous=True, preset=preset)


def car_reversing(speed_mps: float, preset: str = "model") -> Case:
    """A car that stood ahead reverses two metres towards us."""
    start, end = (rear_at("car", 2.0), 0.1), (rear_at("car", 0.0), 0.1)
    # the body heads along x and moves against it
    motion = Backwards(Tour(line(start, end), 0.9, MEETS_S - 3.5, accel_mps2=1.0, brake_mps2=1.0))
    name = f"car reversing, {speed_mps:g} m/s"
    cast = [Player(_OTHER, "car", motion)]
    return case(name, straight_on(speed_mps, preset), street(9), cast, dangerous=True, preset=preset)


def thing(speed_mps: float, what: str, preset: str = "model") -> Case:
    """Something that stands in the way: a low box, a thin pole, a pane that lets the laser through."""
    wide_m = 0.5 * PRESETS[preset].chassis.size_m[1]
    solids = {
        "low box": box((0.0, 0.3), (-0.2, 0.2), (0.0, 0.15), "wall", "wood"),
        "box": box((0.0, 0.4), (-0.2, 0.2), (0.0, 0.4), "wall", "wood"),
        "thin pole": post(0.02, 0.3 * wide_m, 0.0, 1.0, 0.02),
        "glass wall": box((0.0, 0.02), (-1.2, 1.2), (0.0, 1.8), "wall", "clear"),
    }
    scene = street(10, solids[what])
    return case(f"{what}, {speed_mps:g} m/s", straight_on(speed_mps, preset), scene, [], dangerous=True, preset=preset)


def turning_across(speed_mps: float, preset: str = "model") -> Case:
    """CCFtap, the other way round: an oncoming car turns across our lane and stops in it."""
    way = bezier((9.0, 2.4), (4.0, 2.4), (2.4, 2.0), (1.6, -0.6))
    motion = Tour(way, 2.0, MEETS_S - 6.0, accel_mps2=2.0)
    cast = [Player(_OTHER, "car", motion, (2.7, 1.56, 1.46))]
    name = f"turning across, {speed_mps:g} m/s"
    return case(name, straight_on(speed_mps, preset), street(11), cast, dangerous=True, preset=preset)


def round_the_bend(speed_mps: float, preset: str = "model") -> Case:
    """A pedestrian stands in our lane in a left-hand bend of 5 m radius."""
    radius_m, turn = 5.0, 0.9  # it stands so many radians into the bend
    half_m = 0.5 * PRESETS[preset].chassis.size_m[0]
    vehicle = IntoBend(radius_m, speed_mps, turn * radius_m - half_m - speed_mps * MEETS_S)
    there = IntoBend(radius_m, 1.0, turn * radius_m + 0.15).at(0.0)
    cast = [Player(_OTHER, "pedestrian", Standing(there.x_m, there.y_m, there.yaw_rad))]
    return case(f"round the bend, {speed_mps:g} m/s", vehicle, square(), cast, dangerous=True, preset=preset)
