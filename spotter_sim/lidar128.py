"""A 128-beam lidar on the pole: every return of one turn with intensity, ring, time and the truth of what it hit.

Ray casting with the roles turned round: instead of asking for each of 230 000 rays which solid it hits, ask for each
solid which rays can hit it (the window of its bounding ball in azimuth and elevation) and keep the nearest. The
ground is the highest of some rectangles over a quadric, in closed form. The three passes are compiled
(lidar128_kernels.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from common.geometry import invert
from spotter_sim.lidar128_kernels import (
    Ground,
    RangeImage,
    Rays,
    Returns,
    Targets,
    hit_ground,
    hit_solids,
    measure,
)
from spotter_sim.model import Scenario, WorldState
from spotter_sim.solids import GROUND_ID, KINDS, REFLECTIVITY, Solids
from spotter_sim.world import world_at

RINGS = 128
ELEVATION_RAD = np.radians(np.linspace(-25.0, 15.0, RINGS))  # ring 0 looks lowest
TURN_S = 0.1
MAX_RANGE_M = 120.0
_GROUND_REFLECTIVITY = 0.22


@dataclass(frozen=True, eq=False)
class Scan:
    """The N returns of one turn, in firing order (column by column, clockwise), sensor frame."""

    xyz: np.ndarray  # (N, 3) float32 metres, the sensor's own tilted frame
    intensity: np.ndarray  # (N,) uint8
    ring: np.ndarray  # (N,) uint8, 0 looks lowest
    time_s: np.ndarray  # (N,) float32, relative to the scan's time: -0.05 to 0.05
    actor_id: np.ndarray  # (N,) int32: actor, SCENE_ID (-1) or GROUND_ID (-2)
    kind: np.ndarray  # (N,) uint8 index into KINDS: the true class

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def kinds(self) -> np.ndarray:
        """(N,) the true class by name."""
        return np.array(KINDS)[self.kind]


def scan(name: str | Scenario, t_s: float, columns: int = 1800) -> Scan:
    """The turn whose middle is at ``t_s``; straight ahead of the sensor is measured at ``t_s`` exactly.

    Bodies move during the turn, as in a real one. Noise depends on the scenario and the time only.
    """
    world = world_at(name, t_s)
    return _cast(world, columns, _seed(world))


def _seed(world: WorldState) -> np.uint64:
    """64 bits that depend on scenario and time (to the microsecond) only: FNV-1a."""
    value = 0xCBF29CE484222325
    for byte in f"{world.scenario}/{round(world.t_s * 1e6)}".encode():
        value = ((value ^ byte) * 0x100000001B3) % 2**64
    return np.uint64(value)


def _cast(world: WorldState, columns: int, seed: np.uint64) -> Scan:
    """Cast all rays of one turn at the world."""
    T = world.scene.T_map_pole
    rays = Rays(directions(columns), column_times(columns))
    image = RangeImage(np.empty((columns, RINGS), np.float32), np.empty((columns, RINGS), np.int32))
    hit_ground(rays, _ground(world), MAX_RANGE_M, image)
    number = _near_to_far(world.solids, T[:3, 3])
    solids = world.solids.take(number)
    hit_solids(rays, _targets(solids, number, T, column_angles(columns)), image)
    reflectivity = np.append(REFLECTIVITY[solids.part], _GROUND_REFLECTIVITY).astype(np.float32)
    return _collect(solids, rays, image, measure(image, reflectivity, MAX_RANGE_M, seed))


def _ground(world: WorldState) -> Ground:
    g, T = world.scene.ground, world.scene.T_map_pole
    quadric = np.array([g.x_slope, g.y_slope, 0.5 * g.x_bend_per_m, 0.5 * g.y_bend_per_m])
    return Ground(quadric, g.patches, T[:3, :3], T[:3, 3])


def _targets(solids: Solids, number: np.ndarray, T_map_sensor: np.ndarray, azimuth_rad: np.ndarray) -> Targets:
    """The solids as the kernel reads them: rays start in their unit space, ``number`` seeds their leaves."""
    windows, clear_m = _windows(solids, invert(T_map_sensor), azimuth_rad)
    return Targets(
        number=number,
        shape=solids.shape,
        start=np.einsum("pij,pj->pi", solids.to_unit, T_map_sensor[:3, 3] - solids.centre_m),
        drift=np.einsum("pij,pj->pi", solids.to_unit, solids.velocity_mps),
        to_unit=solids.to_unit @ T_map_sensor[:3, :3],
        windows=windows,
        clear_m=clear_m,
    )


def _collect(solids: Solids, rays: Rays, image: RangeImage, returns: Returns) -> Scan:
    """Returns to points with their truth; ``image.hit`` is -1 for the ground, the last row of the tables."""
    row = image.hit.ravel()[returns.ray]
    owner = np.append(solids.owner, np.int32(GROUND_ID))
    kind = np.append(solids.kind, np.uint8(KINDS.index("ground")))
    return Scan(
        xyz=np.take(rays.direction.reshape(-1, 3), returns.ray, axis=0) * returns.range_m[:, None],
        intensity=returns.intensity,
        ring=np.tile(np.arange(RINGS, dtype=np.uint8), len(rays.column_s))[returns.ray],
        time_s=np.repeat(rays.column_s.astype(np.float32), RINGS)[returns.ray],
        actor_id=owner[row],
        kind=kind[row],
    )


def column_angles(columns: int) -> np.ndarray:
    """(columns,) azimuths in firing order: clockwise from just before straight back, all round."""
    return np.pi - (np.arange(columns) + 0.5) * (2 * np.pi / columns)


def column_times(columns: int) -> np.ndarray:
    """(columns,) seconds relative to the middle of the turn."""
    return ((np.arange(columns) + 0.5) / columns - 0.5) * TURN_S


@lru_cache(maxsize=4)
def directions(columns: int) -> np.ndarray:
    """(columns, RINGS, 3) float32 unit vectors in the sensor frame."""
    azimuth, elevation = np.meshgrid(column_angles(columns), ELEVATION_RAD, indexing="ij")
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).astype(np.float32)
    rays.setflags(write=False)
    return rays


def _near_to_far(solids: Solids, origin_m: np.ndarray) -> np.ndarray:
    """Indices of the solids in range, the nearest first: what they hide is then skipped at once."""
    clear_m = np.linalg.norm(solids.centre_m - origin_m, axis=1) - solids.radius_m
    order = np.argsort(clear_m, kind="stable")
    return order[clear_m[order] <= MAX_RANGE_M]


def _windows(solids: Solids, T_sensor_map: np.ndarray, azimuth_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which rays can hit each solid: those through the ball that holds it during the whole turn.

    Returns:
        windows (P, 4) int64: first column, number of columns (they count on modulo all), first ring, last ring + 1;
        clear_m (P,) float64: no hit is nearer.
    """
    place = solids.centre_m @ T_sensor_map[:3, :3].T + T_sensor_map[:3, 3]
    radius = solids.radius_m + 0.5 * TURN_S * np.linalg.norm(solids.velocity_mps, axis=1) + 0.01
    flat, distance = np.hypot(place[:, 0], place[:, 1]), np.linalg.norm(place, axis=1)
    columns = len(azimuth_rad)
    step = 2 * np.pi / columns
    sensor_inside = flat <= radius
    half = np.where(sensor_inside, np.pi, np.arcsin(np.minimum(1.0, radius / np.maximum(flat, 1e-9))))
    middle = (np.pi - np.arctan2(place[:, 1], place[:, 0])) / step - 0.5
    first = np.floor(middle - half / step).astype(np.int64)
    count = np.minimum(np.ceil(2 * half / step).astype(np.int64) + 2, columns)
    up = np.arcsin(np.clip(place[:, 2] / np.maximum(distance, 1e-9), -1, 1))
    spread = np.where(distance <= radius, np.pi, np.arcsin(np.minimum(1.0, radius / np.maximum(distance, 1e-9))))
    low = np.searchsorted(ELEVATION_RAD, up - spread)
    high = np.searchsorted(ELEVATION_RAD, up + spread)
    return np.column_stack([first % columns, count, low, high]).astype(np.int64), distance - radius
