"""One simulated world for all simulated sensors, a pure function of (scenario, time).

The map's origin is where the vehicle of ``crossing`` stands. A scenario repeats itself after its length. Processes with
the same clock compute the same world; no communication is needed.
"""

from __future__ import annotations

from spotter_sim.crossing import crossing, empty, faults
from spotter_sim.emergency import emergency
from spotter_sim.model import FAULTS, Actor, DeviceUnplugged, Scenario, WorldState
from spotter_sim.vehicle import MODEL_CAR
from spotter_sim.yard import drive

# The model car, by short names.
VEHICLE_SIZE_M = MODEL_CAR.size_m
T_vehicle_ld06, T_vehicle_radar = MODEL_CAR.T_vehicle_ld06, MODEL_CAR.T_vehicle_radar
T_vehicle_camera = MODEL_CAR.T_vehicle_camera

SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario for scenario in (crossing(), empty(), faults(), drive(), emergency())
}
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
