"""The health bar: one colour and one sentence for every combination of the on-board sensors' states."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

from common.messages import SensorState
from common.topics import spoken

Colour = Literal["green", "amber", "red"]


class SensorWords(NamedTuple):
    """How the bar speaks of one sensor."""

    missing: str  # what the vehicle lacks without this sensor
    alone: str  # what it is left with when this sensor alone is online


WORDS: dict[str, SensorWords] = {
    "lidar": SensorWords("no geometric range", "LiDAR only, no velocity"),
    "radar": SensorWords("no velocity / no TTC", "radar only, static obstacles may be missed"),
    "camera": SensorWords("no visual confirmation", "camera only, no measured range"),
}


def words_of(name: str) -> SensorWords:
    """A sensor without an entry in ``WORDS`` is called by its name."""
    return WORDS.get(name) or SensorWords(f"no {spoken(name)} data", f"{spoken(name)} only")


def bar(states: Mapping[str, SensorState], roadside: Mapping[str, SensorState] | None = None) -> tuple[Colour, str]:
    """Colour and text from the state of each on-board sensor; degraded and disconnected are both out.

    None out is green, one amber, more red; so is a vehicle without any. Sensors are named in the order of ``states``.
    Those of ``roadside`` change no colour, because the vehicle can do without them, but one that is out is named.
    """
    colour, text = _vehicle(states)
    missed = [f"{spoken(name)} {state}" for name, state in (roadside or {}).items() if state != "online"]
    return colour, "; ".join([text, *missed])


def _vehicle(states: Mapping[str, SensorState]) -> tuple[Colour, str]:
    out = [name for name, state in states.items() if state != "online"]
    left = [name for name in states if name not in out]
    if not states:
        return "red", "NO VEHICLE SENSOR FITTED, SYSTEM BLIND"
    if not out:
        return "green", "ALL VEHICLE SENSORS ONLINE"
    if not left:
        return "red", "ALL VEHICLE SENSORS OUT, SYSTEM BLIND"
    lost = " + ".join(f"{spoken(name)} {states[name].upper()}" for name in out)
    if len(out) == 1:
        return "amber", f"{lost}: {words_of(out[0]).missing}"
    if len(left) == 1:
        return "red", f"{lost}: {words_of(left[0]).alone}"
    return "red", f"{lost}: only {' + '.join(spoken(name) for name in left)} left"
