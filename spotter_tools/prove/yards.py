"""``spotter prove --drive``: laps of the three yards at three speeds, in which any alarm is false."""

from __future__ import annotations

import math

from spotter_sim.yard import YARDS
from spotter_tools.prove.case import Case
from spotter_tools.prove.innocents import yard

SPEEDS_MPS = (1.0, 2.0, 3.0)


def yard_cases(seconds: float) -> list[Case]:
    """One case a yard and speed, of at least so many seconds each."""
    cases = []
    for number in range(YARDS):
        for speed_mps in SPEEDS_MPS:
            lap_s = yard(speed_mps, number).scenario.length_s
            cases.append(yard(speed_mps, number, laps=math.ceil(seconds / lap_s)))
    return cases
