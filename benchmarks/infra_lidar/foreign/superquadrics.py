"""First foreign hand: bodies of superquadrics, seen through evenly spaced beams from a pole of 4 to 8 m.

Surfaces are sampled as points; the nearest point in each cell of the sensor's grid is the return (a depth buffer).
Superquadrics: Barr, IEEE CG&A 1981. Heights of people: NCD-RisC, eLife 2016 (northern Europe).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.infra_lidar.foreign.draw import MIN_POINTS, draw_clusters
from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.training.clusters import LabelledClusters

_GRIDS = ((64, 45.0, 1024), (128, 45.0, 1024), (128, 22.5, 2048), (128, 45.0, 2048))  # beams, degrees, columns
_SAMPLES = 60_000


@dataclass(frozen=True)
class Part:
    """Centre and half sizes in metres, two exponents (1, 1: ellipsoid; near 0: box), turn about y and share kept."""

    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    round_: tuple[float, float] = (1.0, 1.0)
    lean_rad: float = 0.0
    solid: float = 1.0  # below 1: foliage, this share of the surface returns, from anywhere inside


def clusters(seed: int, per_class: int) -> LabelledClusters:
    """``per_class`` clusters of every class, twice as many of the background; each its own group."""
    rng = np.random.default_rng([seed, 1])
    counts = {name: per_class * (2 if name == "background" else 1) for name in CLASSES}
    return draw_clusters(lambda name: _seen(rng, BODIES[name](rng)), counts)


def _surface(rng: np.random.Generator, part: Part, n: int) -> np.ndarray:
    """(n, 3) points on one part: directions of a sphere pushed onto the superquadric."""
    u = rng.normal(size=(n, 3))
    u /= np.abs(u).max(axis=1, keepdims=True)  # cube directions: flat faces get their share
    e1, e2 = part.round_
    flat = (np.abs(u[:, 0]) ** (2 / e2) + np.abs(u[:, 1]) ** (2 / e2)) ** (e2 / e1)
    u /= (flat + np.abs(u[:, 2]) ** (2 / e1))[:, None] ** (e1 / 2)
    if part.solid < 1.0:
        u = u[rng.random(n) < part.solid]
        u *= rng.uniform(0.55, 1.0, (len(u), 1))
    p = u * part.half
    c, s = np.cos(part.lean_rad), np.sin(part.lean_rad)
    x, z = p[:, 0].copy(), p[:, 2].copy()
    p[:, 0], p[:, 2] = c * x + s * z, c * z - s * x
    return np.asarray(p + part.centre)


class View(NamedTuple):
    """Where a body is, as seen from above the sensor's foot (m, rad), the sensor's height (m) and its grid."""

    distance: float
    bearing: float
    yaw: float
    height: float
    grid: tuple[int, float, int]


def passing(seed: int, label: int, bodies: int, frames: int) -> list[list[np.ndarray]]:
    """For each of the bodies of a class its clusters in ``frames`` revolutions, 0.1 s apart, as it goes straight past.

    A revolution with too few returns is left out.
    """
    rng = np.random.default_rng([seed, 2, label])
    found = []
    for _ in range(bodies):
        parts, step_m = BODIES[CLASSES[label]](rng), 0.1 * rng.uniform(*SPEEDS_MPS[CLASSES[label]])
        grid, height = _GRIDS[rng.integers(len(_GRIDS))], rng.uniform(4.0, 8.0)
        start, yaw = rng.uniform(-20.0, 20.0, 2), rng.uniform(-np.pi, np.pi)
        way = [start + i * step_m * np.array([np.cos(yaw), np.sin(yaw)]) for i in range(frames)]
        views = [View(float(np.hypot(*at)), float(np.arctan2(at[1], at[0])), yaw, height, grid) for at in way]
        seen = [_returns(rng, _samples(rng, parts), view) for view in views]
        found.append([points for points in seen if len(points) >= MIN_POINTS])
    return found


def _seen(rng: np.random.Generator, parts: list[Part]) -> np.ndarray:
    """(n, 3) float32 returns of a body somewhere around the pole, after hiding, losses and noise."""
    p = _samples(rng, parts)
    distance, bearing, yaw = 6.0 * np.exp(rng.uniform(0.0, 2.3)), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
    height = rng.uniform(4.0, 8.0)
    return _returns(rng, p, View(distance, bearing, yaw, height, _GRIDS[rng.integers(len(_GRIDS))]))


def _samples(rng: np.random.Generator, parts: list[Part]) -> np.ndarray:
    """(n, 3) points on all parts of a body."""
    area = np.array([np.prod(np.sort(part.half)[1:]) for part in parts])
    counts = np.maximum((_SAMPLES * area / area.sum()).astype(int), 500)
    return np.concatenate([_surface(rng, part, int(n)) for part, n in zip(parts, counts, strict=True)])


def _returns(rng: np.random.Generator, p: np.ndarray, view: View) -> np.ndarray:
    """(n, 3) float32 returns of a body sampled at ``p`` (N, 3), after hiding, losses and noise."""
    distance, bearing, yaw, height, (beams, fov, columns) = view
    c, s = np.cos(yaw), np.sin(yaw)
    p = p @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    p[:, :2] += distance * np.array([np.cos(bearing), np.sin(bearing)])
    p[:, 2] -= height
    r = np.linalg.norm(p, axis=1)
    azimuth = (np.arctan2(p[:, 1], p[:, 0]) - bearing + np.pi) % (2 * np.pi)
    a = (azimuth * columns / (2 * np.pi)).astype(np.int64)
    e = np.floor(np.degrees(np.arcsin(p[:, 2] / r)) / (fov / beams)).astype(np.int64) + 4096
    order = np.argsort(r, kind="stable")
    _, first = np.unique((a * 8192 + e)[order], return_index=True)
    near = order[first]
    near = near[_open(rng, azimuth[near], p[near, 2]) & (rng.random(len(near)) > rng.choice([0.0, 0.1, 0.25]))]
    q = p[near] * (1.0 + rng.normal(0.0, rng.uniform(0.01, 0.04), len(near)) / r[near])[:, None]
    q[:, 2] += height
    return np.asarray(q[q[:, 2] > rng.uniform(0.08, 0.22)], np.float32)


def _open(rng: np.random.Generator, azimuth: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(n,) bool: not behind what stands in front: in a third of the cases a post, a car's roof line or a corner."""
    kind = rng.random()
    if len(azimuth) < 2 or kind > 0.33:
        return np.ones(len(azimuth), bool)
    low, high = azimuth.min(), azimuth.max()
    if kind < 0.11:
        middle = rng.uniform(low, high)
        return np.asarray(np.abs(azimuth - middle) > 0.08 * (high - low))
    if kind < 0.22:
        return np.asarray(z > np.quantile(z, rng.uniform(0.1, 0.45)))
    edge = low + rng.uniform(0.15, 0.5) * (high - low)
    return np.asarray(azimuth > edge if rng.random() < 0.5 else azimuth < high + low - edge)


def _person(rng: np.random.Generator) -> list[Part]:
    tall = rng.normal(*((1.80, 0.07) if rng.random() < 0.5 else (1.67, 0.065)))
    if rng.random() < 0.12:
        tall = rng.uniform(1.05, 1.5)
    broad, stride, turn = tall * rng.normal(0.13, 0.012), tall * rng.uniform(0.0, 0.18), rng.choice([-1.0, 1.0])
    lean = np.arctan(stride / (0.45 * tall))
    parts = [
        Part((0.0, 0.0, 0.66 * tall), (0.075 * tall, broad, 0.17 * tall), (0.7, 0.8)),
        Part((0.0, 0.0, 0.93 * tall), (0.055 * tall, 0.045 * tall, 0.068 * tall)),
    ]
    for side in (-1.0, 1.0):
        sway = side * turn
        middle = 0.5 * sway * stride
        parts.append(
            Part((middle, 0.5 * side * broad, 0.25 * tall), (0.05, 0.055, 0.25 * tall), (0.5, 1.0), -sway * lean)
        )
        arm = (-0.5 * middle, side * (broad + 0.04), 0.62 * tall)
        parts.append(Part(arm, (0.045, 0.045, 0.18 * tall), (0.6, 1.0), sway * lean))
    load = rng.random()
    if load < 0.12:
        parts.append(Part((-0.11 * tall, 0.0, 0.70 * tall), (0.13, 0.17, 0.24), (0.5, 0.5)))  # rucksack
    elif load < 0.20:
        parts.append(Part((-0.5, 0.25, 0.33), (0.13, 0.2, 0.3), (0.3, 0.3)))  # suitcase
    elif load < 0.25:
        parts.append(Part((0.65, 0.0, 0.6), (0.4, 0.24, 0.25), (0.7, 0.7)))  # pram
        parts.append(Part((0.65, 0.0, 0.2), (0.35, 0.2, 0.12), (0.4, 0.4), solid=0.5))
    return parts


def _rider(rng: np.random.Generator) -> list[Part]:
    wheel, base, tall = rng.uniform(0.30, 0.36), rng.uniform(0.95, 1.15), rng.normal(1.74, 0.09) / 1.74
    bend = rng.choice([0.05, 0.3, 0.75], p=[0.45, 0.4, 0.15])  # upright, trekking, racing
    seat = wheel + 0.56 * tall
    long = 0.29 * tall
    chest = (-0.25 + np.sin(bend) * long, 0.0, seat + 0.08 + np.cos(bend) * long)
    head = (-0.25 + 2.35 * np.sin(bend) * long, 0.0, seat + 0.1 + 2.35 * np.cos(bend) * long + 0.06)
    parts = [
        Part((-base / 2, 0.0, wheel), (wheel, 0.025, wheel), (1.0, 1.0), solid=0.45),
        Part((base / 2, 0.0, wheel), (wheel, 0.025, wheel), (1.0, 1.0), solid=0.45),
        Part((0.02, 0.0, wheel + 0.22), (0.40, 0.02, 0.18), (0.3, 0.3), solid=0.4),
        Part((0.40, 0.0, 1.0), (0.03, rng.uniform(0.2, 0.33), 0.02), (0.5, 0.5)),
        Part((0.45, 0.0, 0.75), (0.02, 0.02, 0.3), (0.5, 0.5), -0.3),
        Part(chest, (0.125, 0.19 * tall, long), (0.7, 0.8), bend),
        Part(head, (0.10, 0.08, 0.125)),
    ]
    for side in (-1.0, 1.0):
        up = rng.uniform(-0.12, 0.12)
        parts.append(
            Part((-0.06 + up, side * 0.11, seat - 0.3), (0.07, 0.065, 0.36), (0.5, 1.0), 0.5 * side * up - 0.35)
        )
        arm = (0.5 * (chest[0] + 0.45), side * 0.22, 0.5 * (chest[2] + 1.15))
        parts.append(Part(arm, (0.045, 0.045, 0.3), (0.5, 1.0), 1.0))
    if rng.random() < 0.12:
        parts.append(Part((-base / 2 - 0.1, 0.0, 2 * wheel + 0.2), (0.25, 0.2, 0.2), (0.3, 0.3)))  # box on the carrier
    if rng.random() < 0.08:
        parts.append(Part((base / 2 + 0.1, 0.0, 0.55), (0.45, 0.3, 0.28), (0.4, 0.4)))  # cargo bicycle
    return parts


def _car(rng: np.random.Generator) -> list[Part]:
    kinds = ((3.6, 1.65, 1.50), (4.1, 1.78, 1.46), (4.8, 1.85, 1.45), (4.5, 1.87, 1.68), (5.0, 1.95, 1.95))
    length, width, height = np.array(kinds[rng.integers(len(kinds))]) * rng.normal(1.0, 0.03, 3)
    waist, edge = rng.uniform(0.55, 0.66) * height, rng.uniform(0.15, 0.45)
    cabin, back = rng.uniform(0.24, 0.34) * length, rng.uniform(-0.14, 0.0) * length
    if height > 1.8:
        cabin, back = 0.40 * length, -0.08 * length
    body = Part((0.0, 0.0, 0.5 * (waist + 0.2)), (length / 2, width / 2, 0.5 * (waist - 0.2)), (0.3, edge))
    glass = rng.choice([1.0, 0.6])  # some windows let the beams through
    roof = Part((back, 0.0, waist - 0.1), (cabin, 0.44 * width, height - waist + 0.1), (0.5, 0.4), solid=float(glass))
    wheels = [Part((x * length, y * width, 0.32), (0.31, 0.1, 0.31)) for x in (-0.30, 0.31) for y in (-0.43, 0.43)]
    return [body, roof, *wheels]


def _lorry(rng: np.random.Generator) -> list[Part]:
    width, height = rng.normal(2.5, 0.05), rng.uniform(2.7, 3.9)
    kind = rng.random()
    if kind < 0.35:  # bus
        length = rng.uniform(8.5, 13.5)
        hull = Part((0.0, 0.0, 0.3 + height / 2), (length / 2, width / 2, height / 2), (0.15, 0.15))
        return [hull, *_wheels((-0.3 * length, 0.32 * length), width)]
    length = rng.uniform(5.5, 9.0) if kind < 0.75 else rng.uniform(11.0, 13.6)
    cab = Part((length / 2 + 1.2, 0.0, 1.75), (1.0, 0.47 * width, rng.uniform(1.2, 1.45)), (0.3, 0.3))
    load = rng.random()
    low = 0.25 * height if load < 0.8 else 0.12 * height  # box, or a flat bed
    box = Part((0.0, 0.0, 1.0 + low * 1.3), (length / 2, width / 2, 1.3 * low + 0.1), (0.15, 0.15))
    frame = Part((0.3, 0.0, 0.8), (length / 2 + 1.0, 0.35 * width, 0.2), (0.3, 0.3))
    return [cab, box, frame, *_wheels((-0.35 * length, -0.2 * length, length / 2 + 1.0), width)]


def _wheels(axles: tuple[float, ...], width: float) -> list[Part]:
    return [Part((x, y * width, 0.5), (0.5, 0.14, 0.5)) for x in axles for y in (-0.43, 0.43)]


def _thing(rng: np.random.Generator) -> list[Part]:
    """What stands in a street and is no road user; up to a few metres of it, as clustering leaves it."""
    kind, z = int(rng.integers(11)), rng.uniform(0.5, 2.4)
    return _thin_or_green(rng, kind, z) if kind < 5 else _built(rng, kind, z)


def _thin_or_green(rng: np.random.Generator, kind: int, z: float) -> list[Part]:
    if kind == 0:  # lamp post with a bracket
        return [Part((0.0, 0.0, 2.4), (0.09, 0.09, 2.4), (0.2, 1.0)), Part((0.4, 0.0, 4.6), (0.5, 0.06, 0.05))]
    if kind == 1:  # traffic light or a sign on a post
        board = Part((0.08, 0.0, 2.3), (0.08, rng.uniform(0.15, 0.4), rng.uniform(0.2, 0.5)), (0.2, 0.2))
        return [Part((0.0, 0.0, 1.3), (0.05, 0.05, 1.3), (0.2, 1.0)), board]
    if kind == 2:  # hedge
        half = (rng.uniform(0.6, 4.5), rng.uniform(0.25, 0.7), 0.6 * z)
        return [Part((0.0, 0.0, 0.6 * z), half, (0.4, 0.4), solid=0.5)]
    if kind == 3:  # shrub of several balls
        return [
            Part((*rng.uniform(-0.8, 0.8, 2), r), (r, r, r), solid=0.5)
            for r in rng.uniform(0.3, 1.0, rng.integers(1, 6))
        ]
    trunk = Part((0.0, 0.0, 1.5), (*[rng.uniform(0.08, 0.3)] * 2, 1.5), (0.2, 1.0))
    crown = [
        Part((*rng.uniform(-1, 1, 2), rng.uniform(2.5, 4.0)), tuple(rng.uniform(0.6, 1.5, 3)), solid=0.35)
        for _ in range(4)
    ]
    return [trunk, *crown]


def _built(rng: np.random.Generator, kind: int, z: float) -> list[Part]:
    if kind == 5:  # wall
        half = (rng.uniform(0.8, 6.0), rng.uniform(0.05, 0.2), z / 2)
        return [Part((0.0, 0.0, z / 2), half, (0.1, 0.1))]
    if kind == 6:  # bins and cabinets
        row = rng.integers(1, 4)
        half = (rng.uniform(0.2, 0.5), rng.uniform(0.2, 0.4), rng.uniform(0.4, 0.75))
        return [Part((1.15 * i, 0.0, half[2]), half, (0.2, 0.2)) for i in range(row)]
    if kind == 7:  # crash barrier
        long = rng.uniform(2.0, 8.0)
        posts = [Part((x, 0.0, 0.35), (0.05, 0.06, 0.35), (0.2, 0.2)) for x in np.arange(-long, long, 2.0)]
        return [Part((0.0, 0.0, 0.62), (long, 0.05, 0.15), (0.3, 0.3)), *posts]
    if kind == 8:  # bus shelter
        sides = [Part((x, 0.0, 1.2), (0.04, 0.6, 1.1), (0.1, 0.1), solid=0.4) for x in (-1.6, 1.6)]
        return [
            Part((0.0, 0.0, 2.4), (1.8, 0.75, 0.07), (0.1, 0.1)),
            Part((0.0, 0.6, 1.2), (1.6, 0.04, 1.1), (0.1, 0.1), solid=0.4),
            *sides,
        ]
    if kind == 9:  # planter or fountain
        r = rng.uniform(0.4, 1.3)
        return [
            Part((0.0, 0.0, 0.35), (r, r, 0.35), (0.2, 1.0)),
            Part((0.0, 0.0, 0.9), (0.7 * r, 0.7 * r, 0.4), solid=0.4),
        ]
    long = rng.uniform(0.7, 1.2)  # bench or an empty bicycle stand
    return [
        Part((0.0, 0.0, 0.45), (long, 0.25, 0.05), (0.2, 0.2)),
        Part((0.0, 0.25, 0.7), (long, 0.04, 0.2), (0.2, 0.2)),
    ]


BODIES = {"background": _thing, "car": _car, "large_vehicle": _lorry, "cyclist": _rider, "pedestrian": _person}
SPEEDS_MPS = {"car": (5.0, 14.0), "large_vehicle": (4.0, 12.0), "cyclist": (3.0, 7.0), "pedestrian": (0.8, 1.8)}
