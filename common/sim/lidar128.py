"""A 128-beam lidar on the pole: every return of one turn with intensity, ring, time and the truth of what it hit.

Ray casting with the roles turned round: instead of asking for each of 230 000 rays which solid it hits, ask for each
solid which rays can hit it (the window of its bounding ball in azimuth and elevation) and keep the nearest. The
ground is a quadric in closed form. numba compiles the three passes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np

from common.compiled_from import watch_all_sources
from common.geometry import invert
from common.processor import aim_at_level
from common.sim.model import Scenario, WorldState
from common.sim.solids import GROUND_ID, KINDS, REFLECTIVITY, Solids
from common.sim.world import world_at

RINGS = 128
ELEVATION_RAD = np.radians(np.linspace(-25.0, 15.0, RINGS))  # ring 0 looks lowest
TURN_S = 0.1
MAX_RANGE_M = 120.0
RANGE_NOISE_M = 0.02
_DROPOUT = 0.01
_GROUND_REFLECTIVITY = 0.22
aim_at_level()
watch_all_sources()
_kernel = numba.njit(cache=True, nogil=True, error_model="numpy")


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
    rays = directions(columns)
    azimuth, column_s = column_angles(columns), column_times(columns)
    g, origin = world.scene.ground, T[:3, 3]
    ground = np.array([g.x_slope, g.y_slope, 0.5 * g.x_bend_per_m, 0.5 * g.y_bend_per_m])
    range_m = np.empty((columns, RINGS), np.float32)
    hit = np.empty((columns, RINGS), np.int32)
    _hit_ground(rays, T[:3, :3], origin, ground, MAX_RANGE_M, range_m, hit)
    number = _near_to_far(world.solids, origin)
    solids = world.solids.take(number)
    windows, clear_m = _windows(solids, invert(T), azimuth)
    to_unit = solids.to_unit @ T[:3, :3]  # takes sensor directions
    start = np.einsum("pij,pj->pi", solids.to_unit, origin - solids.centre_m)
    drift = np.einsum("pij,pj->pi", solids.to_unit, solids.velocity_mps)
    _hit_solids(rays, column_s, number, solids.shape, start, drift, to_unit, windows, clear_m, range_m, hit)
    reflectivity = np.append(REFLECTIVITY[solids.part], _GROUND_REFLECTIVITY).astype(np.float32)
    count, measured, intensity, rows = _measure(range_m, hit, reflectivity, MAX_RANGE_M, seed)
    return _collect(solids, rays, column_s, hit, measured[:count], intensity[:count], rows[:count])


def _collect(
    solids: Solids,
    rays: np.ndarray,
    column_s: np.ndarray,
    hit: np.ndarray,
    range_m: np.ndarray,
    intensity: np.ndarray,
    rows: np.ndarray,
) -> Scan:
    """Measured ranges to points with their truth; ``hit`` is -1 for the ground, which is the last row of the tables."""
    what = hit.ravel()[rows]
    owner = np.append(solids.owner, np.int32(GROUND_ID))
    kind = np.append(solids.kind, np.uint8(KINDS.index("ground")))
    return Scan(
        xyz=rays.reshape(-1, 3)[rows] * range_m[:, None],
        intensity=intensity,
        ring=(rows % RINGS).astype(np.uint8),
        time_s=column_s.astype(np.float32)[rows // RINGS],
        actor_id=owner[what],
        kind=kind[what],
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
    around = flat <= radius
    half = np.where(around, np.pi, np.arcsin(np.minimum(1.0, radius / np.maximum(flat, 1e-9))))
    middle = (np.pi - np.arctan2(place[:, 1], place[:, 0])) / step - 0.5
    first = np.floor(middle - half / step).astype(np.int64)
    count = np.minimum(np.ceil(2 * half / step).astype(np.int64) + 2, columns)
    up = np.arcsin(np.clip(place[:, 2] / np.maximum(distance, 1e-9), -1, 1))
    spread = np.where(distance <= radius, np.pi, np.arcsin(np.minimum(1.0, radius / np.maximum(distance, 1e-9))))
    low = np.searchsorted(ELEVATION_RAD, up - spread)
    high = np.searchsorted(ELEVATION_RAD, up + spread)
    return np.column_stack([first % columns, count, low, high]).astype(np.int64), distance - radius


@_kernel
def _hit_ground(rays, rotation, origin, ground, max_range_m, range_m, hit):  # type: ignore[no-untyped-def]
    """Range of every ray to z = a x + b y + c x^2 + d y^2 in the map; -1 in ``hit`` is the ground."""
    a, b, c, d = ground
    ox, oy, oz = origin
    start = oz - a * ox - b * oy - c * ox * ox - d * oy * oy
    for column in range(rays.shape[0]):
        for ring in range(rays.shape[1]):
            x, y, z = rays[column, ring, 0], rays[column, ring, 1], rays[column, ring, 2]
            dx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z
            dy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
            dz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
            # start + linear t - square t^2 = 0: the height of the ray over the ground
            linear = dz - a * dx - b * dy - 2.0 * (c * ox * dx + d * oy * dy)
            square = c * dx * dx + d * dy * dy
            t = np.inf
            root = linear * linear + 4.0 * square * start
            if root >= 0.0:
                # the stable form of the root that goes to start / -linear for a plane
                denominator = -linear + np.sqrt(root)
                if denominator > 1e-9:
                    t = 2.0 * start / denominator
            range_m[column, ring] = t if t <= max_range_m else np.inf
            hit[column, ring] = -1


@_kernel
def _noise(seed, ray):  # type: ignore[no-untyped-def]
    """64 random bits for a ray (SplitMix64, Steele et al. 2014)."""
    z = seed + np.uint64(0x9E3779B97F4A7C15) * (np.uint64(ray) + np.uint64(1))
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@_kernel
def _interval(shape, o, d):  # type: ignore[no-untyped-def]
    """Where the ray o + t d enters and leaves a unit shape; enter > leave when it misses."""
    enter, leave = -np.inf, np.inf
    if shape != 2:  # sphere, cylinder, foliage: the round part
        axes = 2 if shape == 1 else 3
        a, b, c = 0.0, 0.0, -1.0
        for k in range(axes):
            a += d[k] * d[k]
            b += o[k] * d[k]
            c += o[k] * o[k]
        root = b * b - a * c
        if root < 0.0 or (a < 1e-18 and c > 0.0):
            return np.inf, -np.inf
        if a >= 1e-18:
            spread = np.sqrt(root)
            enter, leave = (-b - spread) / a, (-b + spread) / a
    if shape == 1 or shape == 2:  # the flat part
        for k in range(2 if shape == 1 else 0, 3):
            step = d[k] if abs(d[k]) > 1e-12 else 1e-12
            first, second = (-1.0 - o[k]) / step, (1.0 - o[k]) / step
            enter = max(enter, min(first, second))
            leave = min(leave, max(first, second))
    return enter, leave


@_kernel
def _range_to(shape, o, d, luck):  # type: ignore[no-untyped-def]
    """Range at which the ray hits the unit shape, inf when it misses. Leaves are hit somewhere inside or not at all."""
    enter, leave = _interval(shape, o, d)
    if shape == 3:
        enter += 1.6 * luck * (leave - enter)
    return enter if 0.0 < enter <= leave else np.inf


@_kernel
def _hit_solids(rays, column_s, number, shape, start, drift, to_unit, windows, clear_m, range_m, hit):  # type: ignore[no-untyped-def]
    """Lower ``range_m`` where a solid is nearer and note its index in ``hit``."""
    columns, luck = rays.shape[0], 0.0
    o, d = np.empty(3), np.empty(3)
    for solid in range(shape.shape[0]):
        m = to_unit[solid]
        for k in range(windows[solid, 1]):
            column = (windows[solid, 0] + k) % columns
            for i in range(3):
                o[i] = start[solid, i] - drift[solid, i] * column_s[column]
            for ring in range(windows[solid, 2], windows[solid, 3]):
                if range_m[column, ring] <= clear_m[solid]:
                    continue
                x, y, z = rays[column, ring, 0], rays[column, ring, 1], rays[column, ring, 2]
                for i in range(3):
                    d[i] = m[i, 0] * x + m[i, 1] * y + m[i, 2] * z
                if shape[solid] == 3:  # the same leaves for the same ray in every turn
                    luck = np.float64(_noise(np.uint64(number[solid]), column * 128 + ring) >> np.uint64(40)) / 2.0**24
                distance = _range_to(shape[solid], o, d, luck)
                if distance < range_m[column, ring]:
                    range_m[column, ring] = distance
                    hit[column, ring] = solid


@_kernel
def _measure(range_m, hit, reflectivity, max_range_m, seed):  # type: ignore[no-untyped-def]
    """Returns among all rays: range with noise, intensity and the ray's number; weak and unlucky ones are lost."""
    total = range_m.size
    measured, intensity = np.empty(total, np.float32), np.empty(total, np.uint8)
    rows = np.empty(total, np.int64)
    flat_range, flat_hit = range_m.ravel(), hit.ravel()
    mask, count = np.uint64(0xFFFF), 0
    for ray in range(total):
        distance = flat_range[ray]
        if distance > max_range_m:
            continue
        bits = _noise(seed, ray)
        # the sum of three uniform numbers is nearly normal; the fourth decides on a dropout
        spread = 0.0
        for shift in (0, 16, 32):
            spread += np.float64((bits >> np.uint64(shift)) & mask) / 65535.0 - 0.5
        luck = np.float64(bits >> np.uint64(48)) / 65536.0
        reflects = reflectivity[flat_hit[ray]]
        weak = distance * distance / (max_range_m * max_range_m) * 0.12 / reflects
        if luck < _DROPOUT + min(weak, 0.98):
            continue
        noise_m = RANGE_NOISE_M * 2.0 * spread  # three uniforms have a standard deviation of one half
        measured[count] = max(distance + noise_m, 0.1)
        brightness = 255.0 * reflects * (0.9 + 0.2 * spread)
        intensity[count] = np.uint8(min(max(brightness, 1.0), 255.0))
        rows[count] = ray
        count += 1
    return count, measured, intensity, rows
