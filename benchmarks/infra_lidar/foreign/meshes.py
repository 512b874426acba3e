"""Third foreign hand: bodies of triangles, from profiles and rings, seen by rotating sensors of 32 to 80 beams.

Low masts and vehicles' roofs (1.8 to 5 m), range quantised, rows of beams lost. People are stacks of ellipses after
body measures by height share (Drillis & Contini 1966); vehicles are extruded side views; plants are loose triangles.
"""

from __future__ import annotations

import numpy as np

from benchmarks.infra_lidar.foreign.draw import draw_clusters
from benchmarks.infra_lidar.foreign.triangles import cast, extruded, rod, tube, wheel
from services.infra_lidar.training.clusters import LabelledClusters

_RAYS = 3000
_SHARES = {"background": 3, "car": 2, "large_vehicle": 1, "cyclist": 1, "pedestrian": 2}
_SENSORS = ((32, 30.0), (40, 35.0), (64, 26.8), (80, 40.0))  # beams, degrees


def clusters(seed: int, per_share: int) -> LabelledClusters:
    """``per_share`` times the shares of each class; each cluster its own group."""
    rng = np.random.default_rng([seed, 3])
    counts = {name: per_share * share for name, share in _SHARES.items()}
    return draw_clusters(lambda name: _seen(rng, np.concatenate(BODIES[name](rng))), counts)


def _seen(rng: np.random.Generator, mesh: np.ndarray) -> np.ndarray:
    """(n, 3) float32 returns of a mesh (T, 3, 3) that is put somewhere around the sensor."""
    yaw, away, bearing = rng.uniform(-np.pi, np.pi, 3)
    away = rng.gamma(4.0, 5.0) + 5.0
    c, s = np.cos(yaw), np.sin(yaw)
    mesh = mesh @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [away, 0.0, 0.0]
    eye = np.array([0.0, 0.0, 1.8 if rng.random() < 0.35 else rng.uniform(2.5, 5.0)])
    to = (mesh - eye).reshape(-1, 3)
    az, el = np.arctan2(to[:, 1], to[:, 0]), np.arctan2(to[:, 2], np.hypot(to[:, 0], to[:, 1]))
    beams, fov = _SENSORS[rng.integers(len(_SENSORS))]
    e = np.arange(el.min(), el.max(), np.radians(fov / beams)) + rng.uniform(0, 0.005)
    e = e[rng.random(len(e)) > 0.04]  # a beam is lost here and there
    a = np.arange(az.min(), az.max(), np.radians(rng.choice([0.17, 0.2, 0.33])))
    if len(a) * len(e) > _RAYS:
        a = a[:: -(-len(a) * len(e) // _RAYS)]
    ga, ge = (grid.ravel() for grid in np.meshgrid(a, e))
    rays = np.column_stack((np.cos(ge) * np.cos(ga), np.cos(ge) * np.sin(ga), np.sin(ge)))
    t = np.minimum(cast(eye, rays, mesh), _screen(rng, ga, ge))
    hit = np.isfinite(t) & (t > 0) & (rng.random(len(t)) > 0.05)
    t = np.round((t[hit] + rng.normal(0, 0.025, int(hit.sum()))) / 0.02) * 0.02
    p = eye + t[:, None] * rays[hit]
    c, s = np.cos(bearing), np.sin(bearing)
    p = p @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(p[p[:, 2] > rng.uniform(0.1, 0.2)], np.float32)


def _screen(rng: np.random.Generator, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """(n,) minus infinity where something nearer stands in front (a quarter of the cases), plus infinity elsewhere."""
    if rng.random() > 0.25 or not len(azimuth):
        return np.full(len(azimuth), np.inf)
    low = rng.random() < 0.5
    over = elevation if low else azimuth
    edge = over.min() + rng.uniform(0.2, 0.5) * np.ptp(over)
    return np.where(over < edge, -np.inf, np.inf)


def _upper(tall: float, x: float, base: float, bend: float, girth: float) -> list[np.ndarray]:
    """Trunk, head and shoulders on a hip at x, base."""

    def at(share: float) -> tuple[float, float, float]:
        return x + np.sin(bend) * share * tall, 0.0, base + np.cos(bend) * share * tall

    wide = [(0.0, 0.10, 0.075), (0.10, 0.085, 0.065), (0.22, 0.125, 0.075), (0.29, 0.11, 0.06), (0.32, 0.04, 0.04)]
    trunk = tube([(*at(s), d * tall * girth, w * tall * girth) for s, w, d in wide])
    head = [(0.335, 0.03), (0.37, 0.052), (0.41, 0.058), (0.45, 0.03)]
    return [trunk, tube([(*at(s), 1.15 * r * tall, r * tall) for s, r in head])]


def _person(rng: np.random.Generator) -> list[np.ndarray]:
    tall = rng.uniform(1.5, 1.92) if rng.random() < 0.9 else rng.uniform(1.1, 1.5)
    step, girth = rng.uniform(0, 0.22) * tall, rng.uniform(0.85, 1.3)
    hip = 0.52 * tall
    parts = _upper(tall, 0.0, hip, rng.uniform(0, 0.12), girth)
    for y, way in ((0.055 * tall, 1.0), (-0.055 * tall, -1.0)):
        foot = way * step
        parts.append(
            tube(
                [
                    (foot, y, 0.0, 0.12, 0.045),
                    (foot, y, 0.08, 0.05, 0.045),
                    (0.6 * foot, y, 0.28 * tall, 0.055, 0.055),
                    (0.0, y, hip, 0.085, 0.08),
                ]
            )
        )
        parts.append(rod((0.0, 3.0 * y * girth, 0.80 * tall), (-0.8 * foot, 3.2 * y * girth, 0.45 * tall), 0.045))
    extra = rng.random()
    if extra < 0.1:
        parts.append(
            extruded([(-0.36, 0.55 * tall), (-0.12, 0.55 * tall), (-0.12, 0.82 * tall), (-0.36, 0.8 * tall)], 0.34)
        )
    elif extra < 0.18:  # shopping bags
        parts += [
            extruded([(-0.18, 0.2), (0.18, 0.2), (0.15, 0.62), (-0.15, 0.62)], 0.14) + np.array([0, y, 0])
            for y in (-0.36, 0.36)
        ]
    elif extra < 0.25:  # a child by the hand
        parts += [m + np.array([0.1, 0.45, 0.0]) for m in _upper(1.05, 0.0, 0.54, 0.05, 1.0)]
        parts.append(tube([(0.1, 0.45, 0.0, 0.09, 0.12), (0.1, 0.45, 0.54, 0.08, 0.1)]))
    return parts


def _cyclist(rng: np.random.Generator) -> list[np.ndarray]:
    tall, r = rng.uniform(1.5, 1.92), rng.uniform(0.32, 0.36)
    half, bend = rng.uniform(0.47, 0.57), rng.uniform(0.0, 0.9) ** 1.3
    saddle = rng.uniform(0.84, 1.0)
    parts = _upper(tall, -0.22, saddle, bend, rng.uniform(0.85, 1.2))
    hand, shoulder = (half - 0.2, 1.03), (-0.22 + np.sin(bend) * 0.3 * tall, saddle + np.cos(bend) * 0.3 * tall)
    turn = rng.uniform(0, 2 * np.pi)
    for y, phase in ((0.12, 0.0), (-0.12, np.pi)):
        pedal = (0.0 + 0.17 * np.cos(turn + phase), y, 0.28 + 0.17 * np.sin(turn + phase))
        knee = (0.18 + 0.1 * np.cos(turn + phase), y, 0.5 * (saddle + pedal[2]) + 0.06)
        parts += [
            rod((-0.22, y, saddle), knee, 0.075),
            rod(knee, pedal, 0.055),
            rod((shoulder[0], 1.8 * y, shoulder[1]), (hand[0], 2.1 * y, hand[1]), 0.042),
        ]
    parts += [wheel(x, 0.0, r, 0.04, open_=True) for x in (-half, half)]
    for a, b in (
        ((-0.22, saddle), (0.0, 0.3)),
        ((0.0, 0.3), (half - 0.15, 0.8)),
        ((-0.2, 0.75), (half - 0.15, 0.85)),
        ((half, r), (half - 0.2, 1.0)),
        ((-half, r), (-0.2, 0.72)),
        ((-half, r), (0.0, 0.3)),
    ):
        parts.append(rod((a[0], 0.0, a[1]), (b[0], 0.0, b[1]), 0.02, 3))
    parts.append(rod((hand[0], -0.3, hand[1]), (hand[0], 0.3, hand[1]), 0.018, 3))
    if rng.random() < 0.15:  # bags at the carrier
        parts += [
            extruded([(-0.75, 0.35), (-0.4, 0.35), (-0.4, 0.75), (-0.75, 0.75)], 0.14) + np.array([0, y, 0])
            for y in (-0.14, 0.14)
        ]
    return parts


def _car(rng: np.random.Generator) -> list[np.ndarray]:
    kind = rng.choice(["hatch", "saloon", "suv", "van", "pickup"], p=[0.35, 0.25, 0.22, 0.1, 0.08])
    length = {"hatch": 4.0, "saloon": 4.7, "suv": 4.5, "van": 4.9, "pickup": 5.3}[kind] * rng.normal(1, 0.05)
    height = {"hatch": 1.48, "saloon": 1.44, "suv": 1.68, "van": 1.95, "pickup": 1.8}[kind] * rng.normal(1, 0.03)
    width, h, waist = rng.uniform(1.65, 1.95), length / 2, 0.62 * height
    tops = {
        "hatch": [(0.50 * h, waist), (0.10 * h, height), (-0.75 * h, 0.97 * height), (-0.96 * h, waist)],
        "saloon": [(0.45 * h, waist), (0.08 * h, height), (-0.40 * h, 0.98 * height), (-0.70 * h, waist)],
        "suv": [(0.50 * h, waist), (0.18 * h, height), (-0.80 * h, height), (-0.97 * h, waist)],
        "van": [(0.72 * h, 0.55 * height), (0.40 * h, 0.97 * height), (-0.97 * h, height), (-0.99 * h, waist)],
        "pickup": [(0.48 * h, waist), (0.22 * h, height), (-0.20 * h, height), (-0.28 * h, waist)],
    }
    profile = [(h, 0.25), (h, 0.5 * height), *tops[str(kind)], (-h, 0.55 * height), (-h, 0.28)]
    hull = extruded(profile, width, rng.uniform(0.78, 0.9), waist + 0.01)
    return [hull, *(wheel(x * h, y * width, 0.32, 0.2) for x in (-0.6, 0.62) for y in (-0.42, 0.42))]


def _heavy(rng: np.random.Generator) -> list[np.ndarray]:
    width, kind = rng.uniform(2.35, 2.6), rng.random()
    if kind < 0.3:
        length, top = rng.uniform(8.0, 13.0), rng.uniform(2.9, 3.5)
        parts = [
            extruded([(length / 2, 0.3), (length / 2 - 0.15, top), (-length / 2, top), (-length / 2, 0.35)], width)
        ]
        axles = [-0.28 * length, 0.3 * length]
    else:
        load, top = rng.uniform(3.8, 7.0) if kind < 0.75 else rng.uniform(9.0, 12.0), rng.uniform(2.7, 3.9)
        nose = load / 2 + 2.2
        parts = [
            extruded(
                [(nose, 0.4), (nose, 1.3), (nose - 0.35, 2.6), (load / 2 + 0.3, 2.8), (load / 2 + 0.3, 0.5)],
                0.96 * width,
            ),
            extruded([(-load / 2, 1.0), (load / 2, 1.0), (load / 2, top), (-load / 2, top)], width),
            extruded([(-load / 2, 0.7), (nose - 0.3, 0.7), (nose - 0.3, 1.0), (-load / 2, 1.0)], 0.9),
        ]
        axles = [-0.3 * load, nose - 1.0]
    return parts + [wheel(x, y * width, 0.48, 0.28) for x in axles for y in (-0.42, 0.42)]


def _leaves(rng: np.random.Generator, half: np.ndarray, middle: tuple[float, float, float], count: int) -> np.ndarray:
    """Loose triangles within an ellipsoid."""
    at = rng.normal(0.0, 0.5, (count, 1, 3)) * half + middle
    leaf = np.maximum(0.06, 0.22 * float(half.min()))
    mesh = at + rng.normal(0.0, leaf, (count, 3, 3))
    return np.asarray(mesh[mesh[:, :, 2].min(axis=1) > 0.0])


def _thing(rng: np.random.Generator) -> list[np.ndarray]:
    kind, z = int(rng.integers(9)), rng.uniform(0.6, 2.5)
    return _simple(rng, kind, z) if kind < 4 else _built(rng, kind, z)


def _simple(rng: np.random.Generator, kind: int, z: float) -> list[np.ndarray]:
    if kind == 0:
        r = rng.uniform(0.05, 0.18)
        return [tube([(0, 0, 0, r, r), (rng.normal(0, 0.1), 0, rng.uniform(1.0, 5.0), 0.8 * r, 0.8 * r)])]
    if kind == 1:
        r = rng.uniform(0.1, 0.3)
        return [
            tube([(0, 0, 0, 1.4 * r, 1.4 * r), (0.1, 0, 3.0, r, r)]),
            _leaves(rng, rng.uniform(0.7, 1.6, 3), (0, 0, 3.3), 120),
        ]
    if kind == 2:
        return [
            _leaves(rng, rng.uniform(0.4, 1.6, 3), (0.0, 0.0, rng.uniform(0.4, 0.9)), 150)
            for _ in range(rng.integers(1, 3))
        ]
    return [_leaves(rng, np.array([rng.uniform(1.0, 4.0), 0.4, 0.5 * z]), (0, 0, 0.5 * z), 200)]


def _built(rng: np.random.Generator, kind: int, z: float) -> list[np.ndarray]:
    if kind == 4:
        long, thick = rng.uniform(0.6, 5.0), rng.uniform(0.1, 0.4)
        return [extruded([(-long, 0), (long, 0), (long, z), (-long, z)], thick)]
    if kind == 5:
        x, top = rng.uniform(0.2, 0.7), rng.uniform(0.7, 1.6)
        return [extruded([(-x, 0), (x, 0), (0.9 * x, top), (-0.9 * x, top)], rng.uniform(0.3, 1.1))]
    if kind == 6:  # concrete barrier
        long = rng.uniform(1.0, 6.0)
        shape = [(-0.3, 0.0), (0.3, 0.0), (0.12, 0.3), (0.08, 0.9), (-0.08, 0.9), (-0.12, 0.3)]
        return [extruded(shape, 2 * long)]
    if kind == 7:  # sign on two posts
        wide = rng.uniform(0.3, 1.5)
        posts = [rod((0, y, 0), (0, y, 2.8), 0.05) for y in (-0.8 * wide, 0.8 * wide)]
        return [*posts, extruded([(-0.02, 1.6), (0.02, 1.6), (0.02, 2.9), (-0.02, 2.9)], 2 * wide)]
    return [rod((x, 0, 0), (x, 0, 1.05), 0.04) for x in np.arange(0, rng.uniform(0.1, 3.0), 0.5)] + [
        rod((0, 0, 1.0), (2.5, 0, 1.0), 0.03)
    ]


BODIES = {"background": _thing, "car": _car, "large_vehicle": _heavy, "cyclist": _cyclist, "pedestrian": _person}
