"""The health bar: one colour and one sentence for every combination of the three sensors' states."""

from __future__ import annotations

from typing import Literal

from common.messages import SensorState

Colour = Literal["green", "amber", "red"]

SHORT = {"lidar": "LIDAR", "radar": "RADAR", "camera": "CAM"}
MISSING_ONE = {
    "lidar": "no geometric range",
    "radar": "no velocity / no TTC",
    "camera": "no visual confirmation",
}
LEFT_ALONE = {
    "lidar": "LiDAR only, no velocity",
    "radar": "radar only, static obstacles may be missed",
    "camera": "camera only, no measured range",
}


def bar(states: dict[str, SensorState]) -> tuple[Colour, str]:
    """Colour and text from the states of ``lidar``, ``radar`` and ``camera``; either kind of being out counts."""
    out = [name for name in SHORT if states[name] != "online"]
    if not out:
        return "green", "ALL SENSORS ONLINE"
    if len(out) == 3:
        return "red", "ALL SENSORS OFFLINE, SYSTEM BLIND"
    who = " + ".join(f"{SHORT[name]} {states[name].upper()}" for name in out)
    if len(out) == 1:
        return "amber", f"{who}: {MISSING_ONE[out[0]]}"
    (left,) = (name for name in SHORT if name not in out)
    return "red", f"{who}: {LEFT_ALONE[left]}"
