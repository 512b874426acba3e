"""The health bar: all 27 combinations of three sensors' states."""

from __future__ import annotations

from typing import Any

import pytest

from services.jetson.fusion.bar import bar

STATE = {"on": "online", "deg": "degraded", "disc": "disconnected"}

# Rows 1 to 27 of the health bar: lidar, radar, camera, colour, text.
BAR = """
on on on | green | ALL VEHICLE SENSORS ONLINE
on on deg | amber | camera DEGRADED: no visual confirmation
on on disc | amber | camera DISCONNECTED: no visual confirmation
on deg on | amber | radar DEGRADED: no velocity / no TTC
on deg deg | red | radar DEGRADED + camera DEGRADED: LiDAR only, no velocity
on deg disc | red | radar DEGRADED + camera DISCONNECTED: LiDAR only, no velocity
on disc on | amber | radar DISCONNECTED: no velocity / no TTC
on disc deg | red | radar DISCONNECTED + camera DEGRADED: LiDAR only, no velocity
on disc disc | red | radar DISCONNECTED + camera DISCONNECTED: LiDAR only, no velocity
deg on on | amber | LiDAR DEGRADED: no geometric range
deg on deg | red | LiDAR DEGRADED + camera DEGRADED: radar only, static obstacles may be missed
deg on disc | red | LiDAR DEGRADED + camera DISCONNECTED: radar only, static obstacles may be missed
deg deg on | red | LiDAR DEGRADED + radar DEGRADED: camera only, no measured range
deg deg deg | red | ALL VEHICLE SENSORS OUT, SYSTEM BLIND
deg deg disc | red | ALL VEHICLE SENSORS OUT, SYSTEM BLIND
deg disc on | red | LiDAR DEGRADED + radar DISCONNECTED: camera only, no measured range
deg disc deg | red | ALL VEHICLE SENSORS OUT, SYSTEM BLIND
deg disc disc | red | ALL VEHICLE SENSORS OUT, SYSTEM BLIND
disc on on | amber | LiDAR DISCONNECTED: no geometric range
disc on deg | red | LiDAR DISCONNECTED + camera DEGRADED: radar only, static obstacles may be missed
disc on disc | red | LiDAR DISCONNECTED + camera DISCONNECTED: radar only, static obstacles may be missed
disc deg on | red | LiDAR DISCONNECTED + radar DEGRADED: camera only, no measured range
disc deg deg | red | ALL VEHICLE SENSORS OUT, SYSTEM BLIND
disc deg disc | red | ALL VEHICLE SENSORS OUT, SYSTEM BLIND
disc disc on | red | LiDAR DISCONNECTED + radar DISCONNECTED: camera only, no measured range
disc disc deg | red | ALL VEHICLE SENSORS OUT, SYSTEM BLIND
disc disc disc | red | ALL VEHICLE SENSORS OUT, SYSTEM BLIND
"""


@pytest.mark.parametrize("row", BAR.strip().splitlines())
def test_the_bar(row: str) -> None:
    states, colour, text = (part.strip() for part in row.split("|"))
    by_name: Any = dict(zip(("lidar", "radar", "camera"), (STATE[s] for s in states.split()), strict=True))
    assert bar(by_name) == (colour, text)


def test_all_27_rows_are_there() -> None:
    assert len({row.split("|")[0] for row in BAR.strip().splitlines()}) == 27


def test_a_vehicle_without_sensors_is_blind() -> None:
    assert bar({}) == ("red", "NO VEHICLE SENSOR FITTED, SYSTEM BLIND")
