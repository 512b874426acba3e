"""All cases of the proving ground: the base cases, and the same in other weather, with sensors out, without odometry.

To add one: write a function that returns a ``Case`` and put it into ``dangers`` or ``innocents`` here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from spotter_sim.model import Weather
from spotter_sim.yard import YARDS
from spotter_tools.prove import dangers as d
from spotter_tools.prove import innocents as i
from spotter_tools.prove.case import OUT, Case

WEATHER = {"day": Weather(), "dusk": Weather(light=0.45), "rain": Weather(light=0.8, rain=1.0)}
SINGLE = tuple(name for name, faults in OUT.items() if len(faults) == 1)
DOUBLE = tuple(name for name, faults in OUT.items() if len(faults) == 2)
SUBSET_EVERY = 13  # every so-manieth case is in it


def all_cases() -> list[Case]:
    """Every case, in a fixed order; names are unique."""
    dangerous, innocent = list(dangers()), list(innocents())
    cart = [*cart_dangers(), *cart_innocents()]
    each = _one_of_each(dangerous)
    cases = [*dangerous, *innocent, *yards(), *cart]
    cases += [
        in_weather(case, name) for name in ("dusk", "rain") for case in (*dangerous[::6], *innocent[1::6], *cart[::6])
    ]
    cases += [with_out(case, out) for case in each for out in SINGLE]
    cases += [with_out(case, out) for case in each[::3] for out in DOUBLE]
    cases += [with_out(case, out) for case in innocent[1::9] for out in SINGLE]
    cases += [without_ego(case) for case in (*each[::2], *innocent[2::6])]
    return cases


def subset() -> list[Case]:
    """A fixed part, spread over all kinds."""
    return all_cases()[::SUBSET_EVERY]


def dangers() -> Iterator[Case]:
    """The model car by day, everything online."""
    yield from (d.car_stopped(v) for v in (0.5, 1.0, 2.0, 3.0, 4.0, 5.0))
    yield from (d.car_stopped(v, aside) for v in (2.0, 4.0) for aside in (-0.8, 0.8))
    yield from (d.car_slower(v) for v in (2.0, 3.0, 4.0, 5.0))
    yield from (d.car_braking(v) for v in (2.0, 3.0, 4.0))
    for side in ("near", "far"):
        yield from (d.pedestrian_crossing(v, side, p) for v in (1.0, 2.0, 3.0, 4.0) for p in (25, 50, 75))
        yield from (d.cyclist_crossing(v, side) for v in (2.0, 3.0))
        yield from (d.pedestrian_crossing(v, side, 50, dark=True) for v in (1.0, 2.0))
    yield from (d.pedestrian_along(v, walks) for v in (1.0, 2.0, 3.0) for walks in (0.0, 0.5))
    yield from (d.child_behind_car(v) for v in (1.0, 1.5, 2.0, 3.0, 5.0))
    yield from (d.cyclist_along(v) for v in (2.0, 3.0, 4.0))
    yield from (d.car_reversing(v) for v in (1.0, 2.0, 3.0))
    for what in ("box", "low box", "thin pole", "glass wall"):
        yield from (d.thing(v, what) for v in (1.0, 2.0, 3.0))
    yield from (d.turning_across(v) for v in (1.0, 2.0, 3.0))
    yield from (d.round_the_bend(v) for v in (1.0, 2.0, 3.0))


def innocents() -> Iterator[Case]:
    """The same with nothing in the way."""
    for v in (1.0, 2.0, 3.0):
        yield from (i.parked_rows(v, room) for room in (0.7, 0.9))
        yield from (i.gate(v), i.pillars(v), i.passage(v), i.oncoming(v, "car"), i.oncoming(v, "cyclist"))
        yield from (i.overtaken(v), i.waiting(v), i.following(v), i.bend_along_wall(v))
    yield from (i.crossing_far(v) for v in (0.5, 1.0))


def yards() -> Iterator[Case]:
    """One lap of each; `spotter prove --drive` does many."""
    yield from (i.yard(v, number) for v in (1.0, 2.0, 3.0) for number in range(YARDS))


def cart_dangers() -> Iterator[Case]:
    """The vehicle of one metre width, up to 25 km/h."""
    yield from (d.car_stopped(v, preset="cart") for v in (2.0, 4.0, 5.5, 6.9))
    yield from (d.car_slower(v, "cart") for v in (4.0, 6.9))
    yield from (d.car_braking(v, "cart") for v in (3.0, 5.0))
    yield from (
        d.pedestrian_crossing(v, side, p, "cart") for v in (2.0, 4.0, 5.5) for side in ("near", "far") for p in (25, 75)
    )
    yield from (d.pedestrian_along(v, 1.0, "cart") for v in (3.0, 5.5))
    yield from (d.child_behind_car(v, "cart") for v in (2.0, 3.0))
    yield from (d.cyclist_crossing(v, "near", "cart") for v in (3.0, 5.0))
    yield from (d.cyclist_along(v, "cart") for v in (4.0, 6.9))
    yield from (d.thing(v, what, "cart") for v in (2.0, 4.0) for what in ("box", "low box", "glass wall"))


def cart_innocents() -> Iterator[Case]:
    """The cart with nothing in its way."""
    for v in (2.0, 4.0):
        yield from (
            i.parked_rows(v, 0.9, "cart"),
            i.gate(v, 0.4, "cart"),
            i.pillars(v, 0.6, "cart"),
            i.passage(v, "cart"),
        )
        yield from (i.oncoming(v, "car", "cart"), i.overtaken(v, "cart"), i.waiting(v, "cart"), i.following(v, "cart"))


def in_weather(case: Case, name: str) -> Case:
    """The same case at dusk or in rain."""
    scenario = replace(case.scenario, weather=WEATHER[name])
    return replace(case, name=f"{case.name}, {name}", scenario=scenario, tags=(*case.tags, name))


def with_out(case: Case, out: str) -> Case:
    """The same case with one or two sensors degraded or gone."""
    return replace(case, name=f"{case.name}, without {out}", out=out)


def without_ego(case: Case) -> Case:
    """The same case with nobody who tells how the vehicle moves."""
    return replace(case, name=f"{case.name}, motion unknown", ego=False)


def _one_of_each(cases: list[Case]) -> list[Case]:
    """The first case at 2 m/s of each family, or its first."""
    chosen: dict[str, Case] = {}
    for case in cases:
        if case.family not in chosen or ("2 m/s" in case.name and "2 m/s" not in chosen[case.family].name):
            chosen[case.family] = case
    return list(chosen.values())
