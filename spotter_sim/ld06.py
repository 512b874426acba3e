"""The LD06's serial byte stream: 47-byte packets of 12 points, byte for byte as the device sends them.

Source: LDROBOT LD06 development manual v1.0 (packet, CRC-8 polynomial 0x4D) and data sheet (4500 samples/s, 10 Hz,
0.02-12 m). The device counts angles clockwise seen from above; x forward, y left: y = -d sin(angle).
"""

from __future__ import annotations

import math
import struct
from functools import lru_cache

import numpy as np

from spotter_sim.model import Actor, Scenario, WorldState, fixtures_near, noise_rng
from spotter_sim.raycast import cast, cast_moving
from spotter_sim.scene import Scene
from spotter_sim.solids import REFLECTIVITY, join
from spotter_sim.world import scenario_named, world_at

POINTS = 12  # per packet
SAMPLE_HZ = 4500
SPEED_DPS = 3600  # 10 turns a second
PACKET_BYTES = 47
RANGE_M = (0.02, 12.0)
_BLOCK_PACKETS = 10  # the world is looked at every 27 ms; a block of packets is what the cache holds
_BLOCK_POINTS = _BLOCK_PACKETS * POINTS
_PLANE_SLACK_M = 0.02  # by which a ray of a driving vehicle may leave the plane of the middle of its block
_RANGE_NOISE_M = 0.010
_DROPOUT, _GHOST = 0.004, 0.002  # shares of the points


def _crc_table() -> bytes:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value << 1) ^ 0x4D if value & 0x80 else value << 1
            value &= 0xFF
        table.append(value)
    return bytes(table)


CRC_TABLE = _crc_table()


def crc8(data: bytes) -> int:
    """CRC-8 of the LD06: polynomial 0x4D, initial value 0, nothing reflected or inverted."""
    crc = 0
    for byte in data:
        crc = CRC_TABLE[crc ^ byte]
    return crc


def encode_packet(
    start_cdeg: int,
    end_cdeg: int,
    distances_mm: np.ndarray,
    confidences: np.ndarray,
    timestamp_ms: int,
    speed_dps: int = SPEED_DPS,
) -> bytes:
    """One packet. Angles in 0.01 degree clockwise; (12,) distances in mm (0 = no return) and confidences 0-255."""
    points = np.zeros(POINTS, np.dtype([("mm", "<u2"), ("confidence", "u1")]))
    points["mm"], points["confidence"] = distances_mm, confidences
    head = struct.pack("<BBHH", 0x54, 0x2C, speed_dps, start_cdeg % 36000)
    data = head + points.tobytes() + struct.pack("<HH", end_cdeg % 36000, timestamp_ms % 30000)
    return data + bytes([crc8(data)])


def encode(
    angles_deg: np.ndarray,
    distances_mm: np.ndarray,
    confidences: np.ndarray,
    speed_dps: int = SPEED_DPS,
    start_ms: float = 0.0,
) -> bytes:
    """Pack any points into packets.

    Args:
        angles_deg: (N,) clockwise, evenly spaced within each group of 12; N is a multiple of 12.
        distances_mm: (N,) 0..65535, 0 = no return.
        confidences: (N,) 0..255.
        start_ms: device time of the first packet.

    Raises:
        ValueError: N is not a multiple of 12.
    """
    if len(angles_deg) % POINTS:
        raise ValueError(f"an LD06 packet holds {POINTS} points; {len(angles_deg)} points do not fill packets")
    centi = np.round(np.asarray(angles_deg) * 100).astype(int)
    step_ms = 1000.0 * POINTS / SAMPLE_HZ
    return b"".join(
        encode_packet(
            int(centi[i]),
            int(centi[i + POINTS - 1]),
            np.asarray(distances_mm)[i : i + POINTS],
            np.asarray(confidences)[i : i + POINTS],
            int(start_ms + i // POINTS * step_ms),
            speed_dps,
        )
        for i in range(0, len(centi), POINTS)
    )


def packets(name: str | Scenario, t_start_s: float, t_end_s: float) -> bytes:
    """The bytes that are complete after ``t_start_s`` and not later than ``t_end_s``.

    Neighbouring intervals give the same bytes as one long interval. A start after the end is taken as an interval
    across the scenario's loop. Unplugged: no bytes; blocked lens: packets whose distances are all zero.
    """
    scenario = scenario_named(name)
    if t_end_s < t_start_s:
        t_end_s += scenario.length_s
    period_s = POINTS / SAMPLE_HZ
    first, last = (math.floor(t / period_s + 1e-6) for t in (t_start_s, t_end_s))  # numbers of whole packets by then
    out = []
    for number in range(first, last):
        block, place = divmod(number, _BLOCK_PACKETS)
        out.append(_block(scenario, block)[place])
    return b"".join(out)


@lru_cache(maxsize=64)
def _block(scenario: Scenario, block: int) -> tuple[bytes, ...]:
    """Ten packets from one look at the world; empty packets while the plug is out."""
    first = block * _BLOCK_POINTS
    world = world_at(scenario, (first + 0.5 * _BLOCK_POINTS) / SAMPLE_HZ)
    if "lidar_unplugged" in world.faults:
        return (b"",) * _BLOCK_PACKETS
    angles_deg = (first + np.arange(_BLOCK_POINTS)) * (SPEED_DPS / SAMPLE_HZ)
    distances_mm, confidences = _measure(world, -np.radians(angles_deg % 360.0))
    data = encode(angles_deg, distances_mm, confidences, start_ms=first / SAMPLE_HZ * 1000.0)
    return tuple(data[i : i + PACKET_BYTES] for i in range(0, len(data), PACKET_BYTES))


def slice_ranges(world: WorldState, angles_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact ranges of the solids in the lidar's plane.

    Args:
        angles_rad: (N,) counter-clockwise from straight ahead, lidar frame.

    Returns:
        range_m (N,), inf where nothing is within 12 m; reflectivity (N,) 0..1.
    """
    T_map_lidar = world.T_map_vehicle @ world.chassis.T_vehicle_ld06
    origin, rays, range_m, reflectivity = _before_fixtures(world.scene, T_map_lidar.tobytes(), angles_rad.tobytes())
    range_m, reflectivity = range_m.copy(), reflectivity.copy()
    in_sight = _in_sight(world.actors, origin, rays, range_m)
    bodies = [world.actors[i].solids for i in np.flatnonzero(in_sight.any(axis=1))]
    if not bodies:
        return range_m, reflectivity
    solids = join(bodies)
    above_m = (solids.centre_m - origin) @ T_map_lidar[:3, 2]
    solids = solids.take(np.abs(above_m) <= solids.radius_m)  # the plane cuts a few of a body's parts
    rows = np.flatnonzero(in_sight.any(axis=0))
    distance, index = cast(origin, rays[rows], solids, RANGE_M[1])
    nearer = distance < range_m[rows]
    range_m[rows[nearer]] = distance[nearer]
    reflectivity[rows[nearer]] = REFLECTIVITY[solids.part[index[nearer]]]
    return range_m, reflectivity


@lru_cache(maxsize=64)
def _before_fixtures(scene: Scene, pose: bytes, angles: bytes) -> tuple[np.ndarray, ...]:
    """What stands still looks the same in every turn: origin, rays (N, 3), ranges and reflectivities of fixtures.

    The pose and the angles come as the bytes of their arrays, so that they can be looked up.
    """
    T_map_lidar, angles_rad = np.frombuffer(pose).reshape(4, 4), np.frombuffer(angles)
    origin = T_map_lidar[:3, 3]
    rays = np.column_stack([np.cos(angles_rad), np.sin(angles_rad), np.zeros_like(angles_rad)]) @ T_map_lidar[:3, :3].T
    x, y, z = origin.tolist()
    solids = fixtures_near(scene, (x, y, z), RANGE_M[1])
    range_m, index = cast(origin, rays, solids, RANGE_M[1])
    reflectivity = np.where(index >= 0, REFLECTIVITY[solids.part[index]], 0.0) if len(solids) else np.zeros(len(rays))
    return origin, rays, range_m, reflectivity


def _in_sight(actors: tuple[Actor, ...], origin_m: np.ndarray, rays: np.ndarray, range_m: np.ndarray) -> np.ndarray:
    """(actors, N) bool: rays that come near an actor before they end; seen from above, so slopes do not matter."""
    if not actors:
        return np.zeros((0, len(rays)), bool)
    flat = np.hypot(rays[:, 0], rays[:, 1])
    ahead = rays[:, :2] / flat[:, None]
    place = np.array([actor.position_m[:2] for actor in actors]) - origin_m[:2]
    reach_m = np.array([[actor.reach_m] for actor in actors])
    along = place @ ahead.T
    aside = place[:, :1] * ahead[:, 1] - place[:, 1:] * ahead[:, 0]
    until_m = np.minimum(range_m, RANGE_M[1]) * flat
    return np.asarray((np.abs(aside) <= reach_m) & (along >= -reach_m) & (along - reach_m <= until_m))


def skewed_ranges(world: WorldState, angles_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As ``slice_ranges``, but every ray leaves at its own time and place, and bodies are where they are by then.

    The rays of a block leave one after the other; ``world`` is the middle of the block. Motions are taken as uniform
    for its length (27 ms).

    Args:
        angles_rad: (N,) in the order in which the device measures.
    """
    n = len(angles_rad)
    seconds = (np.arange(n) - 0.5 * n) / SAMPLE_HZ
    T_vehicle_ld06 = world.chassis.T_vehicle_ld06
    T_map_lidar = world.vehicle.T_map_vehicle_after(seconds) @ T_vehicle_ld06
    flat = np.column_stack([np.cos(angles_rad), np.sin(angles_rad), np.zeros(n)])
    rays = np.einsum("nij,nj->ni", T_map_lidar[:, :3, :3], flat)
    solids = world.solids_near(world.T_map_vehicle[:3, 3], RANGE_M[1] + world.chassis.size_m[0])
    above_m = (solids.centre_m - world.T_map_vehicle[:3, 3]) @ world.T_map_vehicle[:3, 2] - T_vehicle_ld06[2, 3]
    in_plane = np.abs(above_m) <= solids.radius_m + _PLANE_SLACK_M
    solids = solids.take(in_plane & (REFLECTIVITY[solids.part] > 0.0))
    range_m, index = cast_moving(T_map_lidar[:, :3, 3], rays, seconds, solids, RANGE_M[1])
    return range_m, np.where(index >= 0, REFLECTIVITY[solids.part[index]], 0.0) if len(solids) else np.zeros(n)


def _measure(world: WorldState, angles_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances in mm and confidences as the device would report them: noise, dropouts and a few faint ghosts."""
    n = len(angles_rad)
    if "lidar_blocked" in world.faults:
        return np.zeros(n, int), np.zeros(n, int)
    rng = noise_rng(world.scenario, world.t_s, "ld06")
    range_m, reflectivity = skewed_ranges(world, angles_rad) if world.drives else slice_ranges(world, angles_rad)
    rain = world.weather.rain
    seen = np.isfinite(range_m) & (range_m >= RANGE_M[0]) & (rng.random(n) > _DROPOUT + 0.10 * rain)
    strength = (
        265.0
        * (1.0 - 0.4 * rain)
        * np.sqrt(reflectivity / 0.9)
        * np.minimum(1.0, (6.0 / np.where(seen, range_m, 6.0)) ** 2)
    )
    confidence = np.clip(strength + rng.normal(0.0, 4.0, n), 12, 255)
    noisy_mm = 1000.0 * np.where(seen, range_m, 0.0) + 1000.0 * _RANGE_NOISE_M * (1.0 + 0.5 * rain) * rng.normal(size=n)
    ghost = rng.random(n) < _GHOST + 0.02 * rain  # a drop near the lens is a faint, single return
    distance_mm = np.where(ghost, rng.uniform(150, 2500, n), np.where(seen, np.maximum(noisy_mm, 20.0), 0.0))
    confidence = np.where(ghost, rng.uniform(3, 30, n), np.where(seen, confidence, 0.0))
    return np.round(distance_mm).astype(int), np.round(confidence).astype(int)
