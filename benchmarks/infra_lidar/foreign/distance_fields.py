"""Second foreign hand: bodies as signed distances (capsules, rounded boxes, rings), traced by a sensor of uneven beams.

People are skeletons with joint angles, at rest, walking, running, sitting in a wheelchair, pushing. Beams are dense at
the horizon and sparse below, as the large sensors with 128 uneven channels have them; poles of 3 to 12 m.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.infra_lidar.foreign.distances import Body, trace
from benchmarks.infra_lidar.foreign.draw import draw_clusters
from services.infra_lidar.training.clusters import LabelledClusters

_RAYS = 5000
_SHARES = {"background": 0.36, "car": 0.22, "large_vehicle": 0.12, "cyclist": 0.12, "pedestrian": 0.18}


def clusters(seed: int, count: int) -> LabelledClusters:
    """About ``count`` clusters in the shares of a street; each its own group."""
    rng = np.random.default_rng([seed, 2])
    counts = {name: round(count * share) for name, share in _SHARES.items()}
    return draw_clusters(lambda name: _seen(rng, BODIES[name](rng)), counts)


def _beams_rad(rng: np.random.Generator) -> np.ndarray:
    """Elevations: every 0.125 degrees from +2 to -6, wider by and by to -40 degrees (scaled a little by the draw)."""
    dense = np.arange(2.0, -6.0, -0.125)
    wide = -6.0 - np.cumsum(np.linspace(0.2, 1.0, 56))
    return np.asarray(np.radians(np.concatenate((dense, wide)) * rng.uniform(0.9, 1.1)))


def _seen(rng: np.random.Generator, body: Body) -> np.ndarray:
    """(n, 3) float32 returns of the body from the pole above (0, 0)."""
    height, yaw = rng.uniform(3.0, 12.0), rng.uniform(-np.pi, np.pi)
    distance, bearing = rng.triangular(6.0, 18.0, 65.0), rng.uniform(-np.pi, np.pi)
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # world to body
    eye = turn @ np.array([-distance * np.cos(bearing), -distance * np.sin(bearing), height])
    low, high = body.reach()
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    to = corners - eye
    middle = np.arctan2(-eye[1], -eye[0])
    a = (np.arctan2(to[:, 1], to[:, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
    e = np.arctan2(to[:, 2], np.hypot(to[:, 0], to[:, 1]))
    beams = _beams_rad(rng) - rng.choice([0.0, np.radians(10.0)])  # some sensors are mounted level, some look down
    beams = beams[(beams > e.min() - 0.01) & (beams < e.max() + 0.01)]
    columns = np.arange(a.min(), a.max(), np.radians(rng.choice([0.1, 0.2, 0.4]))) + middle
    if len(beams) * len(columns) > _RAYS:
        columns = columns[:: -(-len(beams) * len(columns) // _RAYS)]
    az, el = (grid.ravel() for grid in np.meshgrid(columns, beams))
    rays = np.column_stack((np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)))
    t = trace(rng, body, eye, rays, np.linalg.norm(eye))
    kept = np.isfinite(t) & _not_hidden(rng, az - middle, t) & (rng.random(len(t)) > rng.beta(1.0, 8.0))
    t = np.round((t[kept] + rng.laplace(0.0, rng.uniform(0.005, 0.02), kept.sum())) / 0.004) * 0.004
    world = (eye + t[:, None] * rays[kept]) @ turn
    world[:, :2] += distance * np.array([np.cos(bearing), np.sin(bearing)])
    return np.asarray(world[world[:, 2] > rng.normal(0.15, 0.03)], np.float32)


def _not_hidden(rng: np.random.Generator, azimuth: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(n,) bool; in three of ten cases somebody passes in front and hides a band of directions."""
    found = azimuth[np.isfinite(t)]
    if rng.random() > 0.3 or len(found) < 2:
        return np.ones(len(t), bool)
    wide = rng.uniform(0.15, 0.5) * np.ptp(found)
    at = rng.uniform(found.min(), found.max())
    return np.asarray(np.abs(azimuth - at) > wide / 2)


def _skeleton(rng: np.random.Generator, hip: np.ndarray, tall: float, pose: dict[str, float]) -> list[Sequence[float]]:
    """Capsules of a person whose hip is there; angles from straight down, forward positive: thigh_l, arm_l ..."""
    bend, out = pose.get("bend", 0.05), []
    up = np.array([np.sin(bend), 0.0, np.cos(bend)])
    neck, thick = hip + 0.30 * tall * up, rng.uniform(0.9, 1.25)
    for side, y in (("l", 1.0), ("r", -1.0)):
        start = hip + np.array([0.0, y * 0.055 * tall, 0.0])
        thigh, knee = pose.get(f"thigh_{side}", 0.0), pose.get(f"knee_{side}", 0.0)
        mid = start + 0.245 * tall * np.array([np.sin(thigh), 0.0, -np.cos(thigh)])
        end = mid + 0.246 * tall * np.array([np.sin(thigh - knee), 0.0, -np.cos(thigh - knee)])
        arm, elbow = pose.get(f"arm_{side}", 0.0), pose.get("elbow", 0.25)
        shoulder = neck + np.array([0.0, y * 0.12 * tall, -0.02])
        hand0 = shoulder + 0.17 * tall * np.array([np.sin(arm), 0.1 * y, -np.cos(arm)])
        hand1 = hand0 + 0.2 * tall * np.array([np.sin(arm + elbow), 0.0, -np.cos(arm + elbow)])
        out += [(*start, *mid, 0.075 * thick), (*mid, *end, 0.055), (*end, *(end + np.array([0.14, 0.0, 0.0])), 0.04)]
        out += [(*shoulder, *hand0, 0.05), (*hand0, *hand1, 0.04)]
    for y in (-0.07, 0.07):
        low, high = hip + np.array([0.0, y * thick, 0.0]), neck + np.array([0.0, 1.3 * y * thick, -0.05])
        out.append((*low, *high, 0.10 * thick))
    head = neck + 0.12 * tall * up
    return [*out, (*head, *(head + np.array([0.02, 0.0, 0.06])), 0.095)]


def _walker(rng: np.random.Generator) -> Body:
    tall = float(np.clip(rng.normal(1.70, 0.10), 1.45, 2.0) if rng.random() < 0.85 else rng.uniform(0.95, 1.45))
    kind = rng.random()
    if kind < 0.06:  # wheelchair
        hip = np.array([0.0, 0.0, 0.52])
        pose = dict.fromkeys(("thigh_l", "thigh_r", "knee_l", "knee_r"), 1.45) | {"arm_l": 0.5, "arm_r": 0.5}
        rings = [(0.0, y, 0.3, 0.29, 0.02) for y in (-0.29, 0.29)]
        return Body(_skeleton(rng, hip, tall, pose), [(-0.2, 0.0, 0.65, 0.03, 0.2, 0.28, 0.02)], rings)
    swing = rng.uniform(0.0, 0.5) * (1.6 if kind > 0.94 else 1.0)
    pose = {"thigh_l": swing, "thigh_r": -swing, "knee_r": 0.6 * swing, "arm_l": -0.7 * swing, "arm_r": 0.7 * swing}
    body = Body(
        _skeleton(
            rng, np.array([0.0, 0.0, 0.5 * tall * np.cos(swing) + 0.03]), tall, pose | {"bend": rng.uniform(0.0, 0.15)}
        )
    )
    if kind < 0.13:  # pushing a pram or a trolley
        body.boxes.append((0.75, 0.0, 0.62, 0.38, 0.24, 0.28, 0.1))
        body.rings += [(x, y, 0.12, 0.10, 0.02) for x in (0.5, 1.0) for y in (-0.24, 0.24)]
    elif kind < 0.20:  # umbrella
        body.boxes.append((0.1, 0.0, tall + 0.25, 0.5, 0.5, 0.06, 0.05))
    elif kind < 0.28:  # long coat or skirt
        body.capsules.append((0.0, 0.0, 0.35, 0.0, 0.0, 0.9, 0.21))
    return body


def _rider(rng: np.random.Generator) -> Body:
    tall = float(np.clip(rng.normal(1.73, 0.09), 1.45, 1.95))
    if rng.random() < 0.2:  # motor scooter or motorcycle
        hip, r = np.array([-0.25, 0.0, 0.88]), rng.uniform(0.22, 0.32)
        pose = {
            "thigh_l": 1.2,
            "thigh_r": 1.2,
            "knee_l": 1.2,
            "knee_r": 1.2,
            "arm_l": 0.9,
            "arm_r": 0.9,
            "bend": rng.uniform(0.0, 0.5),
        }
        rings = [(x, 0.0, r, r - 0.06, 0.06) for x in (-0.65, 0.68)]
        frame = [
            (-0.3, 0.0, 0.62, 0.5, 0.15, 0.16, 0.08),
            (0.5, 0.0, 0.75, 0.08, 0.2, 0.35, 0.05),
            (0.1, 0.0, 0.35, 0.4, 0.16, 0.1, 0.05),
        ]
        return Body(_skeleton(rng, hip, tall, pose), frame, rings)
    r, half, lean = rng.uniform(0.31, 0.36), rng.uniform(0.48, 0.56), rng.choice([0.08, 0.4, 0.8], p=[0.4, 0.45, 0.15])
    hip, crank = np.array([-0.22, 0.0, rng.uniform(0.88, 1.02)]), rng.uniform(0, 2 * np.pi)
    pose = {"bend": lean, "arm_l": lean + 0.55, "arm_r": lean + 0.55, "elbow": 0.3}
    for side, at in (("l", crank), ("r", crank + np.pi)):
        pose[f"thigh_{side}"] = 0.85 + 0.4 * np.cos(at)
        pose[f"knee_{side}"] = 0.95 + 0.5 * np.sin(at + 0.5)
    tubes: list[Sequence[float]] = [
        (-0.22, 0, hip[2] - 0.1, -0.1, 0, 0.3, 0.02), (-0.1, 0, 0.3, half - 0.15, 0, 0.75, 0.022),
        (-0.2, 0, 0.75, half - 0.15, 0, 0.85, 0.018), (half, 0, r, half - 0.18, 0, 1.02, 0.02),
        (half - 0.18, -0.3, 1.05, half - 0.18, 0.3, 1.05, 0.018), (-half, 0, r, -0.2, 0, 0.8, 0.015),
    ]  # fmt: skip
    body = Body(_skeleton(rng, hip, tall, pose) + tubes, [], [(x, 0.0, r, r - 0.02, 0.02) for x in (-half, half)])
    if rng.random() < 0.1:  # child's seat with a child
        body.capsules += [(-0.62, 0, 0.95, -0.6, 0, 1.2, 0.12), (-0.58, 0, 1.35, -0.56, 0, 1.42, 0.09)]
    return body


def _car(rng: np.random.Generator) -> Body:
    segment = rng.choice(5, p=[0.15, 0.35, 0.2, 0.22, 0.08])
    length, width, height = np.array(
        [(3.5, 1.62, 1.48), (4.3, 1.79, 1.45), (4.75, 1.84, 1.43), (4.55, 1.86, 1.67), (5.1, 1.95, 1.98)][segment]
    )
    length, width, height = length * rng.normal(1, 0.04), width * rng.normal(1, 0.025), height * rng.normal(1, 0.03)
    waist, nose = 0.6 * height, rng.uniform(0.18, 0.27) * length
    tail = 0.02 * length if segment in (0, 1, 3, 4) else rng.uniform(0.08, 0.16) * length
    nose = 0.12 * length if segment == 4 else nose
    middle, half = 0.5 * (tail - nose), 0.5 * (length - nose - tail)
    boxes = [
        (0.0, 0.0, 0.5 * (waist + 0.22), length / 2, width / 2, 0.5 * (waist - 0.22), rng.uniform(0.08, 0.2)),
        (middle, 0.0, 0.5 * (waist + height), 0.92 * half, 0.44 * width, 0.5 * (height - waist) + 0.05, 0.16),
    ]  # fmt: skip
    rings = [(x * length, y * width, 0.32, 0.22, 0.10) for x in (-0.3, 0.31) for y in (-0.42, 0.42)]
    if rng.random() < 0.06:
        boxes.append((middle, 0.0, height + 0.2, 0.6, 0.4, 0.18, 0.08))  # roof box
    return Body([], boxes, rings)


def _large(rng: np.random.Generator) -> Body:
    kind, width = rng.random(), rng.normal(2.52, 0.04)
    if kind < 0.3:
        length, height = rng.choice([9.0, 12.0, 12.0, 14.5]), rng.uniform(2.9, 3.3)
        return Body(
            [],
            [(0, 0, 0.3 + (height - 0.3) / 2, length / 2, width / 2, (height - 0.3) / 2, 0.15)],
            _hubs((-0.28 * length, 0.3 * length), width),
        )
    load, height = rng.uniform(4.0, 7.5) if kind < 0.75 else rng.uniform(10.0, 12.5), rng.uniform(2.8, 3.8)
    cab = (load / 2 + 1.25, 0, rng.uniform(1.6, 1.9), 0.95, 0.48 * width, rng.uniform(1.1, 1.4), 0.12)
    tank = rng.random() < 0.15
    box = (0, 0, (height + 1.0) / 2, load / 2, width / 2, (height - 1.0) / 2, 0.9 if tank else 0.03)
    frame = (0.5, 0, 0.85, load / 2 + 1.4, 0.4, 0.12, 0.02)
    return Body([], [cab, box, frame], _hubs((-0.32 * load, load / 2 + 1.0), width))


def _hubs(axles: tuple[float, ...], width: float) -> list[Sequence[float]]:
    return [(x, y * width, 0.5, 0.36, 0.14) for x in axles for y in (-0.42, 0.42)]


def _thing(rng: np.random.Generator) -> Body:
    """Posts, trees, greenery, walls, boxes, barriers, bicycles without riders, benches, cones."""
    kind, tall = rng.integers(10), rng.uniform(0.6, 4.5)
    return _plant(rng, int(kind)) if kind in (1, 2, 3) else _built(rng, int(kind), tall)


def _plant(rng: np.random.Generator, kind: int) -> Body:
    if kind == 1:
        r = rng.uniform(0.1, 0.28)
        crown = [
            (*rng.uniform(-1.2, 1.2, 2), 3.4, *rng.uniform(-1.2, 1.2, 2), 4.2, rng.uniform(0.5, 1.1)) for _ in range(4)
        ]
        return Body([(0, 0, 0, 0.1, 0.1, 3.2, r), *crown], loose=0.06)
    if kind == 2:
        balls = [
            (*xy, 0.6 * r, *xy, r, r)
            for xy, r in ((rng.uniform(-1.0, 1.0, 2), rng.uniform(0.3, 0.9)) for _ in range(rng.integers(1, 7)))
        ]
        return Body(balls, loose=0.15)
    half, z = rng.uniform(0.7, 5.0), rng.uniform(0.4, 1.1)
    return Body([], [(0, 0, z, half, rng.uniform(0.2, 0.6), z, 0.15)], loose=0.1)


def _built(rng: np.random.Generator, kind: int, tall: float) -> Body:
    if kind == 0:
        return Body([(0, 0, 0, rng.normal(0, 0.05), 0, tall + 0.5, rng.uniform(0.04, 0.16))])
    if kind == 4:
        return Body([], [(0, 0, tall / 3, rng.uniform(0.7, 6.0), rng.uniform(0.06, 0.2), tall / 3, 0.01)])
    if kind == 5:
        x, y, z = rng.uniform(0.2, 0.6), rng.uniform(0.15, 0.4), rng.uniform(0.4, 0.8)
        return Body([], [(2.3 * x * i, 0, z, x, y, z, 0.04) for i in range(rng.integers(1, 4))])
    if kind == 6:
        long = rng.uniform(1.5, 7.0)
        return Body(
            [(x, 0, 0, x, 0, 0.8, 0.05) for x in np.arange(-long, long + 0.1, 1.3)],
            [(0, 0, z, long, 0.04, 0.1, 0.03) for z in (0.45, 0.85)],
        )
    if kind == 7:  # one to three parked bicycles
        out = Body()
        for i in range(rng.integers(1, 4)):
            y = 0.45 * i
            out.rings += [(x, y, 0.34, 0.32, 0.02) for x in (-0.52, 0.52)]
            out.capsules += [
                (-0.52, y, 0.34, 0.35, y, 0.85, 0.02),
                (0.52, y, 0.34, 0.36, y, 1.0, 0.02),
                (0.36, y - 0.28, 1.03, 0.36, y + 0.28, 1.03, 0.02),
                (-0.25, y, 0.9, -0.1, y, 0.92, 0.05),
            ]
        return out
    if kind == 8:  # sign or traffic light
        return Body(
            [(0, 0, 0, 0, 0, 2.7, 0.045)],
            [(0.08, 0, rng.uniform(2.0, 2.5), 0.06, rng.uniform(0.15, 0.45), rng.uniform(0.2, 0.45), 0.03)],
        )
    return Body(
        [],
        [
            (0, 0, 0.45, rng.uniform(0.6, 1.1), 0.22, 0.04, 0.02),
            (0, 0.22, 0.68, rng.uniform(0.6, 1.1), 0.03, 0.18, 0.02),
            (0.5, 0, 0.22, 0.05, 0.2, 0.2, 0.01),
        ],
    )


BODIES = {"background": _thing, "car": _car, "large_vehicle": _large, "cyclist": _rider, "pedestrian": _walker}
