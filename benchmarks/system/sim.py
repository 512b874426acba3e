"""What the simulated sensors cost. Run with ``python -m benchmarks sim``; about 20 seconds.

Milliseconds of processor time for 0.1 s of each sensor, as a share of a core at the sensor's own rate, and against a
plain reference that computes the same: every ray at every solid.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from spotter_sim import bgt60, camera, ld06, lidar128
from spotter_sim.model import WorldState
from spotter_sim.raycast import cast
from spotter_sim.solids import REFLECTIVITY
from spotter_sim.truth import expect
from spotter_sim.world import T_vehicle_ld06, world_at

SCENARIO, SECONDS, STEP_S = "crossing", 6.0, 0.1
PLAIN_RAYS = 2000  # of the 128-beam lidar's, one in so many is cast the plain way


def main() -> None:
    """Cost of each simulated sensor, beside a plain ray caster."""
    print(f"{SCENARIO}, {SECONDS:.0f} s            ms    rate   share of a core   x plain reference")
    rows: tuple[tuple[str, float, Callable[[float], Any], float | None], ...] = (
        ("LD06 bytes of 0.1 s", 10.0, packets, plain_ld06_ms()),
        ("radar frame", 10.0, lambda t: bgt60.frame(SCENARIO, t), None),
        ("camera picture", 15.0, lambda t: camera.image(SCENARIO, t), None),
        ("128-beam turn, 1800 columns", 10.0, lambda t: lidar128.scan(SCENARIO, t), plain_lidar128_ms()),
        ("truth", 10.0, lambda t: expect(SCENARIO, t), None),
    )
    for name, rate_hz, run, plain_ms in rows:
        cost_ms = milliseconds(run)
        ratio = "" if plain_ms is None else f"{plain_ms / cost_ms:12.1f}"
        print(f"  {name:28s} {cost_ms:6.2f} {rate_hz:4.0f} Hz {100e-3 * cost_ms * rate_hz:12.1f} % {ratio}")


def milliseconds(run: Callable[[float], Any], begin_s: float = 2.0) -> float:
    """Processor time of one step; what is made only once has been made before."""
    for t_s in (0.0, 0.5, 1.0, 1.5):
        run(t_s)
    times = np.arange(begin_s, begin_s + SECONDS, STEP_S)
    started_s = time.process_time()
    for t_s in times:
        run(float(t_s))
    return 1e3 * (time.process_time() - started_s) / len(times)


def packets(t_s: float) -> bytes:
    """The LD06's bytes of one step."""
    return ld06.packets(SCENARIO, t_s, t_s + STEP_S)


def plain_ld06_ms() -> float:
    """The same stream with every ray cast at every solid within reach, looked at every five packets."""
    fast, block = ld06.slice_ranges, (ld06._BLOCK_PACKETS, ld06._BLOCK_POINTS)
    ld06.slice_ranges, (ld06._BLOCK_PACKETS, ld06._BLOCK_POINTS) = plain_slice, (5, 60)
    ld06._block.cache_clear()
    try:
        return milliseconds(packets)
    finally:
        ld06.slice_ranges, (ld06._BLOCK_PACKETS, ld06._BLOCK_POINTS) = fast, block
        ld06._block.cache_clear()


def plain_slice(world: WorldState, angles_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ranges (N,) in metres and reflectivities (N,) by casting every ray at every solid."""
    T_map_lidar = world.T_map_vehicle @ T_vehicle_ld06
    rays = np.column_stack([np.cos(angles_rad), np.sin(angles_rad), np.zeros_like(angles_rad)]) @ T_map_lidar[:3, :3].T
    solids = world.solids_near(T_map_lidar[:3, 3], ld06.RANGE_M[1])
    range_m, index = cast(T_map_lidar[:3, 3], rays, solids, ld06.RANGE_M[1])
    return range_m, np.where(index >= 0, REFLECTIVITY[solids.part[index]], 0.0)


def plain_lidar128_ms() -> float:
    """Every solid for a sample of the rays, as many times as there are rays."""
    rays = lidar128.directions(1800).reshape(-1, 3)
    sample = rays[:: len(rays) // PLAIN_RAYS].astype(float)

    def run(t_s: float) -> None:
        world = world_at(SCENARIO, t_s)
        T_map_pole = world.scene.T_map_pole
        cast(T_map_pole[:3, 3], sample @ T_map_pole[:3, :3].T, world.solids)

    run(0.0)
    started_s = time.process_time()
    for t_s in (2.0, 4.0, 6.0):
        run(t_s)
    return 1e3 * (time.process_time() - started_s) / 3 * len(rays) / len(sample)


if __name__ == "__main__":
    main()
