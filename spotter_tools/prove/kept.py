"""Regression cases: they pass and must go on passing. CI runs them, about a minute on two cores.

``spotter prove --kept`` exits with 1 when one of them fails. If a change makes a case pass, add the case. If a case
starts to fail, fix the change; do not delete the case.
"""

from __future__ import annotations

from spotter_tools.prove.case import Case
from spotter_tools.prove.catalogue import all_cases

KEPT = (
    "car stopped, 2 m/s, +0 m",
    "pedestrian from near, 50 %, 2 m/s",
    "pedestrian from far, 50 %, 3 m/s",
    "pedestrian from far, 25 %, 5.5 m/s, cart, rain",
    "child behind a parked car, 2 m/s",
    "child behind a parked car, 5 m/s",
    "cyclist from near, 3 m/s",
    "low box, 3 m/s",
    "thin pole, 2 m/s",
    "glass wall, 2 m/s",
    "cyclist from near, 3 m/s, cart",
    "cyclist from near, 3 m/s, rain",
    "cyclist from near, 3 m/s, cart, rain",
    "cyclist from near, 2 m/s, without lidar",
    "child behind a parked car, 2 m/s, without camera",
    "cyclist from near, 2 m/s, without radar",
    "child behind a parked car, 2 m/s, without lidar+camera",
    "cyclist from near, 2 m/s, motion unknown",
    "parked rows, 1 m/s, 0.7 m",
    "parked rows, 2 m/s, 0.7 m",
    "parked rows, 3 m/s, 0.7 m",
    "gate, 1 m/s, 0.3 m",
    "gate, 2 m/s, 0.3 m",
    "gate, 2 m/s, 0.3 m, rain",
    "pillars, 3 m/s, 0.5 m",
    "passage, 2 m/s",
    "oncoming car, 2 m/s",
    "overtaken pedestrians, 3 m/s",
    "following, 2 m/s",
    "parked rows, 4 m/s, 0.9 m, cart",
    "pillars, 4 m/s, 0.6 m, cart",
)


def kept() -> list[Case]:
    """In the order of ``KEPT``.

    Raises:
        KeyError: a name that no case has.
    """
    by_name = {case.name: case for case in all_cases()}
    return [by_name[name] for name in KEPT]
