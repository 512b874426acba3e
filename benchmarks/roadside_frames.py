"""Turns of generated streets for the roadside lidar's benchmarks, with their truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from common.geometry import rotation_between, transform
from common.sim import lidar128, roadside, world


@dataclass(frozen=True)
class Frame:
    """One turn with its truth."""

    points: np.ndarray
    actor: np.ndarray
    kind: np.ndarray
    T_level_sensor: np.ndarray


def frames_of(seed: int, objects: int, count: int, columns: int = 2300, kind: str = "open") -> list[Frame]:
    """Consecutive turns of a generated street, about 180 000 returns each at 2300 columns."""
    return list(turns(seed, objects, count, columns, kind))


def turns(seed: int, objects: int, count: int, columns: int = 2300, kind: str = "open") -> Iterator[Frame]:
    """The same one by one: a minute of them has no room in memory."""
    scenario = roadside.roadside(seed, objects, kind)  # type: ignore[arg-type]
    for k in range(count):
        t_s = 4.0 + 0.1 * k
        scan, place = lidar128.scan(scenario, t_s, columns), world.world_at(scenario, t_s).scene
        normal = np.array([-place.ground.x_slope, -place.ground.y_slope, 1.0])
        normal /= np.linalg.norm(normal)
        T = place.T_map_pole
        height = float(normal @ (T[:3, 3] - [0.0, 0.0, place.ground.height(0.0, 0.0)]))
        rotation = rotation_between(T[:3, :3].T @ normal, np.array([0.0, 0.0, 1.0]))
        points = np.column_stack([scan.xyz, scan.intensity, scan.ring]).astype(np.float32)
        level = transform(rotation, np.array([0.0, 0.0, height]))
        yield Frame(points, scan.actor_id, np.array(lidar128.KINDS)[scan.kind], level)


def as_arrived(frame: Frame) -> Frame:
    """The frame as a receiver leaves it: just written."""
    return replace(frame, points=frame.points.copy())


def own_cluster_share(frame: Frame, cluster_id: np.ndarray) -> float:
    """Share of the objects with 20 points or more within 80 m that have a cluster mostly theirs, with half of them."""
    sizes = np.bincount(cluster_id[cluster_id >= 0], minlength=1)
    near = np.einsum("ij,ij->i", frame.points[:, :2], frame.points[:, :2]) < 80.0**2
    good = total = 0
    for actor in np.unique(frame.actor[frame.actor > 0]):
        mine = (frame.actor == actor) & near
        ids = cluster_id[mine]
        count = np.bincount(ids[ids >= 0], minlength=1)
        if mine.sum() >= 20:
            best = int(count.argmax())
            total += 1
            good += bool(count[best] >= 0.5 * mine.sum() and count[best] > 0.5 * sizes[best])
    return good / max(total, 1)
