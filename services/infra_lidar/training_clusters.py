"""Labelled clusters for training: from folders in the article's layout, and from single bodies under generated rays.

A generated cluster is one body of the simulated world, seen from a random place by a sensor on a pole or a vehicle's
roof, cut at random by something in front of it, without its lowest centimetres (the ground step takes them), with range
noise. Height and spacing of beams are drawn anew for every body: the forest must not depend on one mounting.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.geometry import pose_2d
from common.sim.bodies import DEFAULT_SIZE_M, body
from common.sim.raycast import cast
from common.sim.solids import BOX, CYLINDER, PARTS, SPHERE, Solids, join, solid
from services.infra_lidar.classes import CLASSES

POLE_M, ROOF_M, HIGHEST_M = 5.5, 1.6, 7.5
POLE_SHARE = 0.4  # of the bodies are seen from the usual pole, the others from any height
_BEAM_STEP_RAD, _AZIMUTH_STEP_RAD = np.radians((0.25, 0.6)), np.radians((0.1, 0.3))
_KINDS = {"car": ("car",), "large_vehicle": ("bus", "truck"), "cyclist": ("cyclist",), "pedestrian": ("pedestrian",)}
FOLDER_CLASSES = {name: name for name in CLASSES} | {
    "bicyclist": "cyclist", "bicycle": "cyclist", "bus": "large_vehicle", "truck": "large_vehicle",
    "person": "pedestrian",
}  # fmt: skip


@dataclass(frozen=True)
class LabelledClusters:
    """K clusters: ``points`` (M, 3) float32 metres grouped by ``offsets`` (K + 1,), heights above ``ground_z_m`` (K,).

    ``labels`` (K,) index into ``CLASSES``; ``groups`` (K,) int64: clusters of one group show the same object or scene
    and never stand on both sides of a split.
    """

    points: np.ndarray
    offsets: np.ndarray
    ground_z_m: np.ndarray
    labels: np.ndarray
    groups: np.ndarray

    def __len__(self) -> int:
        return len(self.labels)


def collect(clusters: list[np.ndarray], ground: list[float], labels: list[int], groups: list[int]) -> LabelledClusters:
    """Lists, one entry a cluster, to arrays."""
    if not clusters:
        raise ValueError("no clusters")
    return LabelledClusters(
        np.concatenate(clusters).astype(np.float32),
        np.concatenate(([0], np.cumsum([len(c) for c in clusters]))).astype(np.int64),
        np.array(ground, np.float32),
        np.array(labels, np.int64),
        np.array(groups, np.int64),
    )


def join_clusters(parts: list[LabelledClusters]) -> LabelledClusters:
    """Several sets as one; their groups are kept apart."""
    shift, offsets, groups = 0, [np.zeros(1, np.int64)], []
    for part in parts:
        offsets.append(part.offsets[1:] + shift)
        shift += len(part.points)
    start = 0
    for part in parts:
        groups.append(part.groups + start)
        start += int(part.groups.max(initial=-1)) + 1
    return LabelledClusters(
        np.concatenate([p.points for p in parts]),
        np.concatenate(offsets),
        np.concatenate([p.ground_z_m for p in parts]),
        np.concatenate([p.labels for p in parts]),
        np.concatenate(groups),
    )


def read_folder(folder: Path, min_points: int = 5) -> LabelledClusters:
    """``<class>/*.bin``, float32 x y z in metres, z up; the lowest point counts as the ground.

    The article's class names (``bicyclist``) are understood. Every file is a group of its own unless its name begins
    with ``<group>_``, a number.

    Raises:
        ValueError: no class folder, an unknown one, or a file that is no whole number of points.
    """
    known = sorted(path for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
    wrong = [path.name for path in known if path.name not in FOLDER_CLASSES]
    if not known or wrong:
        raise ValueError(
            f"{folder}: expected folders named {', '.join(sorted(FOLDER_CLASSES))}; found {wrong or 'none'}"
        )
    clusters: list[np.ndarray] = []
    ground: list[float] = []
    labels: list[int] = []
    groups: list[int] = []
    for path in (file for one in known for file in sorted(one.glob("*.bin"))):
        values = np.fromfile(path, np.float32)
        if len(values) % 3 or not np.all(np.isfinite(values)):
            raise ValueError(f"{path}: expected finite float32 x y z, got {len(values)} values")
        if len(values) < 3 * min_points:
            continue
        clusters.append(values.reshape(-1, 3))
        ground.append(float(clusters[-1][:, 2].min()))
        labels.append(CLASSES.index(FOLDER_CLASSES[path.parent.name]))
        prefix = path.stem.split("_")[0]
        groups.append(int(prefix) if "_" in path.stem and prefix.isdigit() else 1_000_000 + len(groups))
    return collect(clusters, ground, labels, groups)


def generated_clusters(seed: int, per_class: int, min_points: int = 10, background: int = 1) -> LabelledClusters:
    """``per_class`` clusters of every class and ``background`` times as many of that, seeded; each is its own group."""
    rng = np.random.default_rng(seed)
    clusters: list[np.ndarray] = []
    labels: list[int] = []
    for label, name in enumerate(CLASSES):
        made = 0
        while made < per_class * (background if name == "background" else 1):
            aloft = name == "background" and rng.random() < 0.25  # branches, signs, balconies
            points = _look_at(rng, _body(rng, name), rng.uniform(1.0, 4.0) if aloft else 0.0)
            if len(points) >= min_points:
                clusters.append(points)
                labels.append(label)
                made += 1
    return collect(clusters, [0.0] * len(clusters), labels, list(range(len(clusters))))


def _body(rng: np.random.Generator, name: str) -> Solids:
    if name == "background":
        return _fixture(rng)
    kind = str(rng.choice(_KINDS[name]))
    size = np.array(DEFAULT_SIZE_M[kind]) * rng.uniform(0.85, 1.12, 3)
    return body(kind, (float(size[0]), float(size[1]), float(size[2])), rng.uniform(0, 10), rng.uniform(0, 2))


def _fixture(rng: np.random.Generator) -> Solids:
    """Something of the street: wall piece, pole, bush, tree, bin, fence, hedge."""
    kind = rng.integers(8)
    height = rng.uniform(0.6, 5.0)
    if kind == 0:
        half = (rng.uniform(0.5, 6.0), 0.15, height / 2)
        return join([solid(BOX, (0.0, 0.0, height / 2), half, "wall", "concrete")])
    if kind == 1:
        radius = rng.uniform(0.05, 0.25)
        return join([solid(CYLINDER, (0.0, 0.0, height / 2), (radius, radius, height / 2), "pole", "metal")])
    if kind == 2:
        x, y, z = rng.uniform(0.3, 2.0, 3)
        return join([solid(SPHERE, (0.0, 0.0, z * 0.8), (x, y, z), "bush", "leaves")])
    if kind == 3:
        crown = rng.uniform(0.8, 1.8)
        trunk = solid(CYLINDER, (0.0, 0.0, 1.2), (0.15, 0.15, 1.2), "tree", "wood")
        return join([trunk, solid(SPHERE, (0.0, 0.0, 2.4 + crown), (crown, crown, crown), "tree", "leaves")])
    if kind == 4:
        x, y, z = rng.uniform(0.2, 0.8, 3)
        return join([solid(BOX, (0.0, 0.0, z), (x, y, z), "wall", "metal")])
    if kind == 5:
        x, y, z = rng.uniform(0.5, 5.0), rng.uniform(0.2, 0.6), rng.uniform(0.3, 1.2)
        return join([solid(BOX, (0.0, 0.0, z), (x, y, z), "bush", "leaves")])
    if kind == 6:
        crowns = [rng.uniform(0.3, 1.4, 3) for _ in range(rng.integers(2, 5))]
        places = [(*rng.uniform(-1.2, 1.2, 2), 0.9 * crown[2]) for crown in crowns]
        return join(
            [solid(SPHERE, place, (x, y, z), "bush", "leaves") for place, (x, y, z) in zip(places, crowns, strict=True)]
        )
    posts = [solid(BOX, (1.2 * i, 0.0, 0.5), (0.05, 0.05, 0.5), "pole", "metal") for i in range(rng.integers(2, 5))]
    rail = solid(BOX, (1.2, 0.0, 0.9), (1.8, 0.03, 0.05), "pole", "metal")
    return join([*posts, rail])


def _look_at(rng: np.random.Generator, shape: Solids, lift_m: float = 0.0) -> np.ndarray:
    """(n, 3) points of the body from a sensor above (0, 0): placed, cut by an occluder, with noise and dropped rays."""
    sensor = np.array([0.0, 0.0, POLE_M if rng.random() < POLE_SHARE else rng.uniform(ROOF_M, HIGHEST_M)])
    distance, bearing = rng.uniform(5.0, 70.0), rng.uniform(-np.pi, np.pi)
    place = pose_2d(distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-np.pi, np.pi), lift_m)
    shape = shape.placed(place, 0, np.zeros(3))
    rays = _rays(shape, sensor, rng.uniform(*_BEAM_STEP_RAD), rng.uniform(*_AZIMUTH_STEP_RAD))
    range_m, hit = cast(sensor, rays, shape)
    seen = np.isfinite(range_m) & (rng.random(len(rays)) > rng.choice([0.0, 0.05, 0.3]))
    leafy = shape.part[hit[seen]] == PARTS.index("leaves")  # leaves are hit somewhere inside
    noisy = range_m[seen] + rng.normal(0.0, 0.02, int(seen.sum())) + leafy * rng.exponential(0.15, int(seen.sum()))
    points = sensor + noisy[:, None] * rays[seen]
    points = points[points[:, 2] > rng.uniform(0.10, 0.25)]
    return _occlude(rng, points).astype(np.float32)


def _rays(shape: Solids, origin: np.ndarray, beam_rad: float, azimuth_rad: float) -> np.ndarray:
    """(N, 3) unit directions of a sensor's grid, so wide between beams and between columns, that may meet the shape."""
    centre, reach = shape.centre_m - origin, shape.radius_m
    flat = np.hypot(centre[:, 0], centre[:, 1])
    azimuth, elevation = np.arctan2(centre[:, 1], centre[:, 0]), np.arctan2(centre[:, 2], flat)
    middle = azimuth[0]
    turn = (azimuth - middle + np.pi) % (2 * np.pi) - np.pi
    half = np.arcsin(np.minimum(reach / np.maximum(flat, reach + 0.1), 1.0))
    grid_a = np.arange((turn - half).min(), (turn + half).max(), azimuth_rad) + middle
    grid_e = np.arange((elevation - half).min(), (elevation + half).max(), beam_rad)
    a, e = (grid.ravel() for grid in np.meshgrid(grid_a, grid_e))
    return np.column_stack((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)))


def _occlude(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """In four of ten cases something in front hides one side or the lower part."""
    if len(points) < 2 or rng.random() > 0.4:
        return points
    if rng.random() < 0.6:
        across = np.arctan2(points[:, 1], points[:, 0])
        across = (across - across[0] + np.pi) % (2 * np.pi) - np.pi
        across *= rng.choice([-1.0, 1.0])
        return points[across > np.quantile(across, rng.uniform(0.1, 0.6))]
    return points[points[:, 2] > np.quantile(points[:, 2], rng.uniform(0.1, 0.5))]
