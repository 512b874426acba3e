"""One simulated world, a pure function of (scenario, time): what every simulated sensor looks at.

The map's origin is where the vehicle of ``crossing`` stands. A scenario repeats itself after its length, so every
process that takes the time from the same clock sees the same world without a word between them.
"""

from __future__ import annotations

import numpy as np

from common.geometry import transform
from common.sim.crossing import crossing, empty, faults
from common.sim.model import FAULTS, Actor, DeviceUnplugged, Scenario, WorldState

# The model car: origin on the ground below its middle.
VEHICLE_SIZE_M = (0.40, 0.191, 0.25)
T_vehicle_ld06 = transform(translation=np.array([0.10, 0.0, 0.22]))
T_vehicle_radar = transform(translation=np.array([0.20, 0.0, 0.20]))
T_vehicle_camera = transform(translation=np.array([0.16, 0.0, 0.24]))  # x forward: the optical axis

SCENARIOS: dict[str, Scenario] = {scenario.name: scenario for scenario in (crossing(), empty(), faults())}
T_map_pole = SCENARIOS["crossing"].scene.T_map_pole


def scenario_named(name: str | Scenario) -> Scenario:
    """The scenario of that name; a scenario itself is passed through.

    Raises:
        ValueError: no such scenario; the message lists the known ones.
    """
    if isinstance(name, Scenario):
        return name
    if name not in SCENARIOS:
        raise ValueError(f"no scenario {name!r}; known: {', '.join(SCENARIOS)}")
    return SCENARIOS[name]


def world_at(name: str | Scenario, t_s: float) -> WorldState:
    """The world of a scenario (or of ``roadside.roadside(...)``) at a time in seconds; any time, it repeats."""
    return scenario_named(name).at(t_s)


def scenario_time(name: str | Scenario, utc_ns: int, t0_s: float | None = None, started_ns: int | None = None) -> float:
    """Scenario time in [0, length): UTC modulo the length, or counted from ``t0_s`` at ``started_ns``.

    Raises:
        ValueError: no such scenario, or a ``t0_s`` without ``started_ns``.
    """
    length_ns = round(scenario_named(name).length_s * 1e9)
    if t0_s is None:
        return (utc_ns % length_ns) / 1e9
    if started_ns is None:
        raise ValueError("t0_s needs started_ns, the UTC at which the scenario began")
    return ((utc_ns - started_ns + round(t0_s * 1e9)) % length_ns) / 1e9


__all__ = [
    "FAULTS",
    "SCENARIOS",
    "VEHICLE_SIZE_M",
    "Actor",
    "DeviceUnplugged",
    "Scenario",
    "T_map_pole",
    "T_vehicle_camera",
    "T_vehicle_ld06",
    "T_vehicle_radar",
    "WorldState",
    "scenario_named",
    "scenario_time",
    "world_at",
]
