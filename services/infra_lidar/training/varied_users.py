"""Road users of many builds as solids, drawn at random: what the forest learns people from.

Statures: NCD-RisC, eLife 2016 (means 1.65 and 1.77 m, deviation 7 cm) and WHO growth references for children.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from spotter_sim.solids import BOX, SPHERE, Solids, join, limbs, solid

_Rod = tuple[ArrayLike, ArrayLike, float]


def person(rng: np.random.Generator) -> Solids:
    """On foot, in a wheelchair, alone, with luggage, a pram or a dog; now and then two side by side."""
    tall = stature(rng)
    kind = rng.random()
    if kind < 0.05:
        return _wheelchair(rng, tall)
    parts = [_walker(rng, tall)]
    if kind < 0.12:
        parts.append(_shifted(_walker(rng, stature(rng)), 0.1 * rng.normal(), rng.uniform(0.4, 0.65)))
    elif kind < 0.40:
        parts.append(_luggage(rng, tall))
    return join(parts)


def stature(rng: np.random.Generator) -> float:
    """Height of a person, m."""
    if rng.random() < 0.12:
        return float(rng.uniform(0.95, 1.5))
    return float(np.clip(rng.normal(rng.choice([1.65, 1.77]), 0.07), 1.42, 2.02))


def _walker(rng: np.random.Generator, tall: float) -> Solids:
    girth, stoop = rng.uniform(0.8, 1.4), rng.choice([0.0, rng.uniform(0.0, 0.35)])
    stride = rng.uniform(0.0, 0.5) * (1.5 if rng.random() < 0.08 else 1.0)
    hip = np.array([0.0, 0.0, 0.51 * tall * np.cos(stride)])
    parts = _upper_body(rng, hip, tall, stoop, girth)
    rods: list[_Rod] = []
    for side, swing in ((1.0, stride), (-1.0, -stride * rng.uniform(0.3, 1.0))):
        start = hip + _at(0.0, side * 0.055 * tall, 0.0)
        knee = start + 0.26 * tall * np.array([np.sin(swing), 0.0, -np.cos(swing)])
        back = swing - rng.uniform(0.0, 0.5) * (swing < 0)
        foot = knee + 0.25 * tall * np.array([np.sin(back), 0.0, -np.cos(back)])
        thick = 0.045 * tall * girth
        rods += [(start, knee, thick), (knee, foot, 0.75 * thick), (foot, foot + _at(0.16, 0.0, 0.02), 0.045)]
    if rng.random() < 0.25:  # coat or skirt
        hem = rng.uniform(0.15, 0.4) * tall
        rods.append(([0.0, 0.0, hem], [0.0, 0.0, 0.6 * tall], 0.12 * tall * girth))
    return join([*parts, _rods(rods, "cloth")])


def _upper_body(
    rng: np.random.Generator, hip: np.ndarray, tall: float, bend_rad: float, girth: float,
    reach: np.ndarray | None = None,
) -> list[Solids]:  # fmt: skip
    """Trunk, head and arms on a hip; the hands hang, or hold what is at ``reach`` (3,)."""
    up = np.array([np.sin(bend_rad), 0.0, np.cos(bend_rad)])
    shoulder = hip + 0.29 * tall * up
    turn = np.array([[up[2], 0.0, up[0]], [0.0, 1.0, 0.0], [-up[0], 0.0, up[2]]])
    middle = hip + 0.15 * tall * up
    half = (0.065 * tall * girth, 0.105 * tall * girth, 0.19 * tall)
    head = shoulder + 0.13 * tall * up
    parts = [
        solid(SPHERE, tuple(middle), half, "pedestrian", "cloth", turn),
        solid(SPHERE, tuple(head), (0.055 * tall, 0.05 * tall, 0.07 * tall), "pedestrian", "skin"),
    ]
    rods: list[_Rod] = [(shoulder + _at(0, -0.1 * tall, 0), shoulder + _at(0, 0.1 * tall, 0), 0.04 * tall)]
    for side in (-1.0, 1.0):
        start = shoulder + _at(0.0, side * 0.125 * tall, -0.02)
        hang = rng.uniform(-0.5, 0.7)
        hand = start + 0.35 * tall * np.array([np.sin(hang), 0.1 * side, -np.cos(hang)])
        end = hand if reach is None else reach + _at(0.0, side * rng.uniform(0.15, 0.3), 0.0)
        rods.append((start, end, rng.uniform(0.04, 0.06)))
    return [*parts, _rods(rods, "cloth")]


def _luggage(rng: np.random.Generator, tall: float) -> Solids:
    kind, side = rng.integers(7), rng.choice([-1.0, 1.0])
    if kind == 0:  # rucksack
        z, deep = rng.uniform(0.65, 0.75) * tall, rng.uniform(0.08, 0.2)
        return _block((-0.1 - deep, 0.0, z), (deep, rng.uniform(0.12, 0.22), rng.uniform(0.18, 0.32)))
    if kind == 1:  # suitcase or shopping trolley
        return _block(
            (rng.uniform(-0.7, 0.1), 0.35 * side, 0.42), (rng.uniform(0.1, 0.2), 0.22, rng.uniform(0.25, 0.45))
        )
    if kind == 2:  # bags
        return join([_block((0.0, s * 0.33, 0.38), (0.18, 0.09, rng.uniform(0.12, 0.25))) for s in (-1.0, 1.0)])
    if kind == 3:  # umbrella
        wide = rng.uniform(0.4, 0.65)
        return solid(SPHERE, (0.1, 0.1 * side, tall + 0.15), (wide, wide, 0.14), "pedestrian", "cloth")
    if kind in (4, 5):  # pram, pushchair, walking frame
        x, high = rng.uniform(0.6, 0.85), rng.uniform(0.2, 0.5)
        body = _block((x, 0.0, 0.35 + high / 2), (rng.uniform(0.2, 0.45), rng.uniform(0.2, 0.28), high / 2))
        wheels = [
            ([x + dx, dy - 0.02, 0.13], [x + dx, dy + 0.02, 0.13], 0.12) for dx in (-0.3, 0.3) for dy in (-0.25, 0.25)
        ]
        return join([body, _rods([*wheels, ([x - 0.4, -0.2, 1.0], [x - 0.4, 0.2, 1.0], 0.02)], "rubber")])
    return _shifted(animal(rng, rng.uniform(0.3, 0.65)), rng.uniform(-0.3, 0.9), 0.5 * side)  # a dog


def _wheelchair(rng: np.random.Generator, tall: float) -> Solids:
    hip = np.array([0.0, 0.0, 0.55])
    parts = _upper_body(rng, hip, tall, rng.uniform(-0.1, 0.2), rng.uniform(0.9, 1.3))
    rods: list[_Rod] = [([0.0, y - 0.02, 0.3], [0.0, y + 0.02, 0.3], 0.3) for y in (-0.3, 0.3)]
    for y in (-0.1, 0.1):
        rods += [(hip + _at(0, y, 0), [0.45, y, 0.55], 0.07), ([0.45, y, 0.55], [0.55, y, 0.12], 0.055)]
    parts += [_rods(rods, "cloth"), _block((-0.2, 0.0, 0.65), (0.04, 0.22, 0.28))]
    if rng.random() < 0.4:
        parts.append(_shifted(_walker(rng, stature(rng)), -0.75, 0.0))
    return join(parts)


def animal(rng: np.random.Generator, high_m: float) -> Solids:
    """Four legs, a trunk and a head: a dog to a horse."""
    long, thick = 0.55 * high_m * rng.uniform(0.9, 1.2), 0.18 * high_m * rng.uniform(0.8, 1.3)
    rods: list[_Rod] = [([-long, 0.0, 0.78 * high_m], [long, 0.0, 0.8 * high_m], thick)]
    rods += [
        ([x, y, 0.0], [x, y, 0.7 * high_m], 0.05 * high_m)
        for x in (-0.8 * long, 0.8 * long)
        for y in (-0.6 * thick, 0.6 * thick)
    ]
    rods.append(([long, 0.0, 0.85 * high_m], [1.5 * long, 0.0, high_m * rng.uniform(0.9, 1.25)], 0.5 * thick))
    return _rods(rods, "cloth")


def rider(rng: np.random.Generator) -> Solids:
    """On a bicycle, cargo or racing bicycle, moped, motorcycle or kick scooter."""
    kind = rng.random()
    if kind < 0.15:
        return _motorcycle(rng)
    if kind < 0.20:
        return _kick_scooter(rng)
    tall = stature(rng)
    small = min(tall / 1.6, 1.0)  # a child's bicycle
    wheel, half = small * rng.uniform(0.29, 0.37), small * rng.uniform(0.46, 0.62)
    saddle, bend = small * rng.uniform(0.82, 1.05), float(rng.choice([rng.uniform(0.0, 0.25), rng.uniform(0.25, 0.9)]))
    hip, bar = (
        np.array([-0.22 * small, 0.0, saddle]),
        np.array([half - 0.2 * small, 0.0, small * rng.uniform(0.95, 1.12)]),
    )
    parts = _upper_body(rng, hip, tall, bend, rng.uniform(0.8, 1.3), bar)
    parts += [_wheel(rng, x, wheel) for x in (-half, half)]
    frame = [
        (hip - _at(0, 0, 0.06), [0.0, 0.0, 0.3], 0.02), ([0.0, 0.0, 0.3], bar - _at(0, 0, 0.2), 0.025),
        (hip - _at(0, 0, 0.15), bar - _at(0, 0, 0.15), 0.02), ([half, 0.0, wheel], bar, 0.02),
        ([-half, 0.0, wheel], hip - _at(0, 0, 0.15), 0.015), (bar - _at(0, 0.3, 0), bar + _at(0, 0.3, 0), 0.018),
    ]  # fmt: skip
    crank = rng.uniform(0, 2 * np.pi)
    for side, at in ((0.1, crank), (-0.1, crank + np.pi)):
        pedal = np.array([0.17 * np.cos(at), side, 0.3 + 0.17 * np.sin(at)])
        knee = np.array([hip[0] + 0.36 * tall / 1.7 + 0.06 * np.cos(at), side, 0.5 * (saddle + pedal[2]) + 0.1])
        frame += [(hip + _at(0, side, 0), knee, 0.075), (knee, pedal, 0.055)]
    return join([*parts, _rods(frame, "metal"), *_on_the_carrier(rng, half, wheel)])


def _on_the_carrier(rng: np.random.Generator, half: float, wheel: float) -> list[Solids]:
    kind = rng.random()
    if kind < 0.08:  # delivery box
        return [_block((-half, 0.0, 2 * wheel + 0.3), (0.25, 0.23, rng.uniform(0.15, 0.28)))]
    if kind < 0.18:  # panniers
        return [_block((-half, s * 0.16, 0.55), (0.18, 0.07, 0.18)) for s in (-1.0, 1.0)]
    if kind < 0.25:  # a child behind
        return [solid(SPHERE, (-half, 0.0, 1.05), (0.14, 0.15, 0.3), "cyclist", "cloth")]
    if kind < 0.33:  # cargo bay in front
        return [_block((half + 0.3, 0.0, 0.55), (rng.uniform(0.3, 0.5), 0.3, rng.uniform(0.15, 0.3)))]
    if kind < 0.37:  # trailer
        return [_block((-half - 1.1, 0.0, 0.5), (0.4, 0.35, rng.uniform(0.2, 0.4)))]
    return []


def _wheel(rng: np.random.Generator, x: float, radius: float) -> Solids:
    """A rim of short rods with spokes that few rays hit, or a disc."""
    if rng.random() < 0.3:
        return _rods([([x, -0.02, radius], [x, 0.02, radius], radius)], "rubber")
    angle = np.linspace(0, 2 * np.pi, 11)
    rim = np.column_stack((x + radius * np.cos(angle), np.zeros(11), radius + radius * np.sin(angle)))
    spokes: list[_Rod] = [([x, 0.0, radius], list(end), 0.006) for end in rim[:-1:2]]
    return _rods([*((list(a), list(b), 0.025) for a, b in pairwise(rim)), *spokes], "rubber")


def _motorcycle(rng: np.random.Generator) -> Solids:
    tall, wheel, half = stature(rng), rng.uniform(0.22, 0.33), rng.uniform(0.58, 0.75)
    hip, bar = np.array([-0.25, 0.0, rng.uniform(0.78, 0.92)]), np.array([0.4, 0.0, rng.uniform(0.95, 1.1)])
    parts = _upper_body(rng, hip, max(tall, 1.5), rng.uniform(0.0, 0.7), rng.uniform(0.9, 1.4), bar)
    rods: list[_Rod] = [([x, -0.06, wheel], [x, 0.06, wheel], wheel) for x in (-half, half)]
    rods += [([half, 0.0, wheel], bar, 0.05), (bar - _at(0, 0.35, 0), bar + _at(0, 0.35, 0), 0.02)]
    for y in (-0.2, 0.2):
        rods += [(hip + _at(0, 0.5 * y, 0), [0.15, y, 0.75], 0.08), ([0.15, y, 0.75], [0.05, y, 0.3], 0.06)]
    parts += [_rods(rods, "metal"), _block((-0.15, 0.0, 0.62), (half, 0.16, rng.uniform(0.12, 0.2)))]
    if rng.random() < 0.5:  # fairing or leg shield
        parts.append(_block((0.45, 0.0, 0.75), (0.1, 0.22, rng.uniform(0.2, 0.4))))
    return join(parts)


def _kick_scooter(rng: np.random.Generator) -> Solids:
    stem: list[_Rod] = [([0.45, 0.0, 0.1], [0.35, 0.0, 1.1], 0.025), ([0.35, -0.25, 1.1], [0.35, 0.25, 1.1], 0.02)]
    stem += [([x, -0.03, 0.11], [x, 0.03, 0.11], 0.11) for x in (-0.5, 0.5)]
    rider_ = _walker(rng, max(stature(rng), 1.4))
    return join(
        [_shifted(rider_, -0.05, 0.0, 0.14), _rods(stem, "metal"), _block((0.0, 0.0, 0.13), (0.45, 0.08, 0.03))]
    )


def _at(x: float, y: float, z: float) -> np.ndarray:
    return np.array([x, y, z], float)


def _rods(rods: list[_Rod], part: str) -> Solids:
    start, end, radius = zip(*rods, strict=True)
    return limbs(np.array(start, float), np.array(end, float), np.array(radius), "pedestrian", [part] * len(rods))


def _block(centre: tuple[float, float, float], half: tuple[float, float, float]) -> Solids:
    return solid(BOX, centre, half, "pedestrian", "cloth")


def _shifted(shape: Solids, x: float, y: float, z: float = 0.0) -> Solids:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return shape.placed(T, 0, np.zeros(3))
