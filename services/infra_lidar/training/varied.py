"""Single bodies of many builds, seen by sensors of many kinds: domain randomisation (Tobin et al., IROS 2017).

Mounting height, distance, spacing and evenness of the beams, noise, rounding of ranges, lost returns, what stands in
front, what is left of the ground and the error of its height are drawn anew for every body, so that the forest does not
depend on any of them.
"""

from __future__ import annotations

import numpy as np

from common.geometry import pose_2d
from services.infra_lidar.classification.classes import CLASSES, VEHICLES
from services.infra_lidar.training.clusters import LabelledClusters, collect
from services.infra_lidar.training.varied_furniture import furniture
from services.infra_lidar.training.varied_users import animal, person, rider
from services.infra_lidar.training.varied_vehicles import car, large_vehicle
from spotter_sim.raycast import cast
from spotter_sim.solids import PARTS, Solids

MAKERS = {"car": car, "large_vehicle": large_vehicle, "cyclist": rider, "pedestrian": person}
"""A body of each class, drawn at random."""
_LEAVES, _CLEAR, _GLASS = (PARTS.index(name) for name in ("leaves", "clear", "glass"))
_ANIMAL_SHARE = 0.02  # they belong to no class: each gets a random label, so that the forest learns to be unsure
_ANIMAL_LABELS = [CLASSES.index(name) for name in ("background", "cyclist", "pedestrian")]
_PARKED_SHARE = 0.35  # of the vehicles stand in a row: between their neighbours only a corner or an end is seen
_RAYS = 2500


def generated_clusters(seed: int, per_class: int, min_points: int = 10, background: int = 1) -> LabelledClusters:
    """``per_class`` clusters of every class and ``background`` times as many of that, seeded; each is its own group."""
    rng = np.random.default_rng(seed)
    clusters: list[np.ndarray] = []
    ground: list[float] = []
    labels: list[int] = []
    for label, name in enumerate(CLASSES):
        wanted = len(clusters) + per_class * (background if name == "background" else 1)
        while len(clusters) < wanted:
            shape, lift_m, called = _draw(rng, name, label)
            points = look_at(rng, shape, lift_m, parked=called in VEHICLES and rng.random() < _PARKED_SHARE)
            if len(points) >= min_points:
                clusters.append(points)
                ground.append(rng.normal(0.0, 0.05))
                labels.append(called)
    return collect(clusters, ground, labels, list(range(len(clusters))))


def _draw(rng: np.random.Generator, name: str, label: int) -> tuple[Solids, float, int]:
    """A body of the class, how high it hangs (m), and its label."""
    if name != "background":
        return MAKERS[name](rng), 0.0, label
    if rng.random() < _ANIMAL_SHARE:
        return animal(rng, rng.uniform(0.3, 1.7)), 0.0, int(rng.choice(_ANIMAL_LABELS))
    return furniture(rng), rng.uniform(0.3, 4.0) if rng.random() < 0.12 else 0.0, label


def look_at(rng: np.random.Generator, shape: Solids, lift_m: float = 0.0, parked: bool = False) -> np.ndarray:
    """(n, 3) float32 points of the body, level frame, sensor above (0, 0), road at 0."""
    sensor = np.array([0.0, 0.0, np.exp(rng.uniform(np.log(1.5), np.log(12.0)))])
    distance, bearing = np.exp(rng.uniform(np.log(4.0), np.log(75.0))), rng.uniform(-np.pi, np.pi)
    place = pose_2d(distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-np.pi, np.pi), lift_m)
    shape = shape.placed(place, 0, np.zeros(3))
    azimuth, elevation = _grid(rng, shape, sensor)
    rays = np.column_stack(
        (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    )
    range_m, part = _first(rng, sensor, rays, shape)
    seen = np.isfinite(range_m) & _returned(rng, part)
    seen &= ~_hidden(rng, azimuth, elevation, seen)
    if parked and seen.any():
        seen &= _between_neighbours(rng, azimuth, seen)
    points = sensor + _measured(rng, range_m[seen])[:, None] * rays[seen]
    return _above_ground(rng, points).astype(np.float32)


def _grid(rng: np.random.Generator, shape: Solids, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) azimuth and elevation of the rays that may meet the shape: even or uneven beams, some of them lost."""
    centre, reach = shape.centre_m - origin, shape.radius_m
    flat = np.hypot(centre[:, 0], centre[:, 1])
    middle = np.arctan2(centre[0, 1], centre[0, 0])
    turn = (np.arctan2(centre[:, 1], centre[:, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
    half = np.arcsin(np.minimum(reach / np.maximum(flat, reach + 0.1), 1.0))
    rise = np.arctan2(centre[:, 2], flat)
    step = np.exp(rng.uniform(np.log(np.radians(0.09)), np.log(np.radians(1.0))))
    elevation = np.arange((rise - half).min(), (rise + half).max(), step) + rng.uniform(0.0, step)
    if rng.random() < 0.4:  # uneven
        elevation = elevation + rng.uniform(-0.4, 0.4, len(elevation)) * step
    elevation = elevation[rng.random(len(elevation)) > rng.choice([0.0, 0.0, 0.05, 0.15])]
    across = np.exp(rng.uniform(np.log(np.radians(0.07)), np.log(np.radians(0.45))))
    azimuth = np.arange((turn - half).min(), (turn + half).max(), across) + middle
    thin = int(np.ceil(np.sqrt(len(azimuth) * len(elevation) / _RAYS)))
    if thin > 1:  # large and near: a coarser sensor sees the same
        azimuth, elevation = azimuth[::thin], elevation[::thin]
    a, e = np.meshgrid(azimuth, elevation)
    return a.ravel(), e.ravel()


def _first(
    rng: np.random.Generator, origin: np.ndarray, rays: np.ndarray, shape: Solids
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) range and part of the first thing hit; panes that are clear let every ray through."""
    solid = shape.take(shape.part != _CLEAR)
    range_m, hit = cast(origin, rays, solid)
    part = np.where(hit >= 0, solid.part[hit], 255)
    leafy = part == _LEAVES  # a ray goes some way into leaves, or through
    deep = rng.exponential(rng.uniform(0.05, 0.4), len(rays)) * leafy
    return np.where(leafy & (rng.random(len(rays)) < rng.uniform(0.0, 0.5)), np.inf, range_m + deep), part


def _returned(rng: np.random.Generator, part: np.ndarray) -> np.ndarray:
    """(N,) bool: losses at random, and at glass more."""
    lost = np.where(part == _GLASS, rng.choice([0.0, 0.5, 0.95]), 0.0)
    return rng.random(len(part)) > np.maximum(lost, rng.choice([0.0, 0.05, 0.15, 0.4]))


def _hidden(rng: np.random.Generator, azimuth: np.ndarray, elevation: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(N,) bool: behind a post, a corner, a vehicle's roof line or somebody who passes; mostly nothing."""
    away = np.zeros(len(azimuth), bool)
    for _ in range(rng.choice([0, 1, 2], p=[0.55, 0.35, 0.10])):
        if seen.sum() < 2:
            break
        over = elevation if rng.random() < 0.4 else azimuth
        low, high = over[seen].min(), over[seen].max()
        if over is elevation:  # what stands in front hides the lower part
            away |= over < low + rng.uniform(0.1, 0.6) * (high - low)
        elif rng.random() < 0.4:
            away |= np.abs(over - rng.uniform(low, high)) < rng.uniform(0.03, 0.25) * (high - low)
        else:
            share = rng.uniform(0.1, 0.65) * (high - low)
            away |= over < low + share if rng.random() < 0.5 else over > high - share
    return away


def _between_neighbours(rng: np.random.Generator, azimuth: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(N,) bool: a window of 15 to 60 percent of the directions, mostly at one end."""
    low, high = azimuth[seen].min(), azimuth[seen].max()
    wide = rng.uniform(0.15, 0.6) * (high - low)
    start = float(rng.choice([low, high - wide, rng.uniform(low, high - wide)]))
    return np.asarray((azimuth >= start) & (azimuth <= start + wide))


def _measured(rng: np.random.Generator, range_m: np.ndarray) -> np.ndarray:
    """Ranges as a sensor gives them: noise of one of two shapes, then rounded."""
    sigma, noise = np.exp(rng.uniform(np.log(0.004), np.log(0.05))), rng.choice(["normal", "laplace"])
    noisy = range_m + getattr(rng, noise)(0.0, sigma, len(range_m))
    step = rng.choice([0.001, 0.004, 0.01, 0.02, 0.04])
    return np.asarray(np.round(noisy / step) * step)


def _above_ground(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """Without what the ground step takes, and now and then with a little of the road around the foot."""
    cut = rng.uniform(0.05, 0.3)
    points = points[points[:, 2] > cut]
    if len(points) > 5 and rng.random() < 0.15:
        low, high = points[:, :2].min(axis=0) - 0.3, points[:, :2].max(axis=0) + 0.3
        n = int(rng.uniform(0.02, 0.2) * len(points)) + 1
        road = np.column_stack((rng.uniform(low, high, (n, 2)), rng.uniform(0.0, cut, n)))
        points = np.concatenate((points, road))
    return points
