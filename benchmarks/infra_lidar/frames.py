"""Revolutions of generated streets for the roadside lidar's benchmarks, with their truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from common.geometry import rotation_between, transform
from services.infra_lidar.input.range_image import RangeImage
from spotter_sim import lidar128, roadside, world


@dataclass(frozen=True)
class Frame:
    """One revolution with its truth.

    image: what the sensor measured, a row a column; ``place`` (N,) is where the points are in it.
    """

    points: np.ndarray
    image: RangeImage
    place: np.ndarray
    actor: np.ndarray
    kind: np.ndarray
    T_level_sensor: np.ndarray


def frames_of(seed: int, objects: int, count: int, columns: int = 2300, kind: str = "open") -> list[Frame]:
    """Consecutive revolutions of a generated street, about 180 000 returns each at 2300 columns."""
    return list(revolutions(seed, objects, count, columns, kind))


def revolutions(seed: int, objects: int, count: int, columns: int = 2300, kind: str = "open") -> Iterator[Frame]:
    """The same one by one, because a minute of them does not fit in memory."""
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
        image, place = image_of(scan, columns)
        yield Frame(points, image, place, scan.actor_id, np.array(lidar128.KINDS)[scan.kind], level)


def image_of(scan: lidar128.Scan, columns: int) -> tuple[RangeImage, np.ndarray]:
    """The range image of a revolution, and (N,) the places of its returns in it."""
    turned = np.pi - np.arctan2(scan.xyz[:, 1], scan.xyz[:, 0])
    column = np.round(turned * columns / (2 * np.pi) - 0.5).astype(int) % columns
    range_m, intensity = np.zeros((columns, lidar128.RINGS), np.float32), np.zeros((columns, lidar128.RINGS), np.uint8)
    range_m[column, scan.ring] = np.linalg.norm(scan.xyz, axis=1)
    intensity[column, scan.ring] = scan.intensity
    heading, flat, none = lidar128.column_angles(columns), np.cos(lidar128.ELEVATION_RAD), np.zeros(lidar128.RINGS)
    beams = [flat, none, np.sin(lidar128.ELEVATION_RAD), none, none, none, np.arange(lidar128.RINGS)]
    image = RangeImage(
        range_m, intensity, np.cos(heading).astype(np.float32), np.sin(heading).astype(np.float32),
        np.zeros(columns, np.uint8), np.stack(beams).astype(np.float32),
    )  # fmt: skip
    return image, column * lidar128.RINGS + scan.ring


def as_arrived(frame: Frame) -> Frame:
    """The frame as a receiver leaves it: just written."""
    return replace(frame, points=frame.points.copy(), image=image_as_arrived(frame.image))


def image_as_arrived(image: RangeImage) -> RangeImage:
    """The same of a range image."""
    return replace(image, range_m=image.range_m.copy())


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
