"""Cars and large vehicles of many builds as solids, drawn at random.

Sizes: the span of the European segments A to J, vans, and the largest lorries of directive 96/53/EC.
"""

from __future__ import annotations

import numpy as np

from spotter_sim.solids import BOX, CYLINDER, Solids, box, join, limbs, solid

# length, width, height (m), share of the length before the windscreen and behind the rear window, weight
_CARS = (
    (2.7, 1.60, 1.55, 0.12, 0.02, 0.06), (3.6, 1.64, 1.48, 0.20, 0.02, 0.18), (4.3, 1.79, 1.46, 0.25, 0.03, 0.26),
    (4.7, 1.83, 1.44, 0.26, 0.14, 0.18), (4.5, 1.86, 1.68, 0.23, 0.02, 0.18), (4.8, 1.92, 1.90, 0.10, 0.01, 0.08),
    (5.3, 1.92, 1.82, 0.24, 0.32, 0.06),
)  # fmt: skip
_WEIGHT = np.array([row[5] for row in _CARS])


def car(rng: np.random.Generator) -> Solids:
    """City car to pick-up and small van; windows that let some rays through, boxes on the roof, small trailers."""
    length, width, height, nose, tail, _ = _CARS[rng.choice(len(_CARS), p=_WEIGHT / _WEIGHT.sum())]
    length, width, height = length * rng.normal(1, 0.05), width * rng.normal(1, 0.03), height * rng.normal(1, 0.04)
    half, side, waist = length / 2, width / 2, rng.uniform(0.54, 0.66) * height
    nose, tail = nose * rng.uniform(0.8, 1.2) * length, tail * rng.uniform(0.7, 1.3) * length
    glass = str(rng.choice(["glass", "paint", "clear"], p=[0.5, 0.3, 0.2]))
    slope = rng.uniform(0.15, 0.5) if height < 1.8 else 0.1
    steps = rng.integers(2, 5)
    parts = [box((-half, half), (-side, side), (rng.uniform(0.15, 0.3), waist), "car", "paint")]
    for i in range(steps):  # the cabin tapers in steps
        share, z = (i + 0.5) / steps, waist + (height - waist) * np.array([i, i + 1]) / steps
        x = (-half + tail + slope * share * 0.5, half - nose - slope * 2.0 * share)
        y = side * (0.95 - 0.14 * share)
        parts.append(box(x, (-y, y), (float(z[0]), float(z[1])), "car", glass if i < steps - 1 else "paint"))
    parts.append(_wheels((-0.31 * length, 0.31 * length), side, rng.uniform(0.28, 0.37)))
    if rng.random() < 0.05:
        parts.append(solid(BOX, (-0.1, 0.0, height + 0.18), (0.7, 0.4, 0.17), "car", "paint"))
    if rng.random() < 0.05:  # trailer
        behind, high = -half - 1.6, rng.uniform(0.2, 0.9)
        parts.append(solid(BOX, (behind, 0.0, 0.5 + high / 2), (rng.uniform(0.8, 1.2), 0.7, high / 2), "car", "paint"))
    return join(parts)


def large_vehicle(rng: np.random.Generator) -> Solids:
    """Bus, lorry with box, tarpaulin, tank, flat bed, tipper or container, articulated lorry, large van, tram's car."""
    kind = rng.random()
    if kind < 0.28:
        return _bus(rng)
    if kind < 0.42:
        return _large_van(rng)
    width, load = rng.uniform(2.2, 2.6), rng.uniform(3.5, 7.8) if kind < 0.72 else rng.uniform(9.0, 13.6)
    front, gap, high = load / 2, rng.uniform(0.1, 0.9), rng.uniform(2.5, 4.0)
    cab, top = rng.uniform(1.5, 2.4), rng.uniform(2.2, 3.6)
    parts = [
        box(
            (front + gap, front + gap + cab),
            (-0.48 * width, 0.48 * width),
            (rng.uniform(0.3, 0.6), top),
            "truck",
            "paint",
        ),
        box((-front, front + gap), (-0.4, 0.4), (0.6, 1.0), "truck", "metal"),
        _wheels((-0.35 * load, -0.2 * load, front + gap + 0.5 * cab), width / 2, rng.uniform(0.4, 0.52), "truck"),
    ]
    return join([*parts, *_load(rng, front, width / 2, high)])


def _load(rng: np.random.Generator, front: float, side: float, high: float) -> list[Solids]:
    kind, floor = rng.random(), rng.uniform(0.85, 1.3)
    if kind < 0.65:
        return [box((-front, front), (-side, side), (floor, high), "truck", "cloth")]
    if kind < 0.75:  # tank
        turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
        radius = 0.9 * side
        return [solid(CYLINDER, (0.0, 0.0, floor + radius), (radius, radius, front), "truck", "metal", turn)]
    bed = [box((-front, front), (-side, side), (floor - 0.15, floor), "truck", "metal")]
    if kind < 0.85:  # tipper or low sides
        bed.append(box((-front, front), (-side, side), (floor, floor + rng.uniform(0.4, 1.2)), "truck", "metal"))
    elif kind < 0.95:  # something on a flat bed
        x = sorted(rng.uniform(-front, front, 2))
        bed.append(
            box((x[0] - 0.3, x[1] + 0.3), (-0.8 * side, 0.8 * side), (floor, rng.uniform(1.5, high)), "truck", "metal")
        )
    return bed


def _bus(rng: np.random.Generator) -> Solids:
    length, side, high = (
        float(rng.choice([rng.uniform(6.5, 10.0), 12.0, rng.uniform(12.0, 18.0)])),
        1.27,
        rng.uniform(2.7, 4.2),
    )
    half, glass = length / 2, str(rng.choice(["glass", "paint"]))
    parts = [
        box((-half, half), (-side, side), (rng.uniform(0.25, 0.4), 1.1), "bus", "paint"),
        box((-half, half), (-side, side), (1.1, 0.8 * high), "bus", glass),
        box((-half, half), (-side, side), (0.8 * high, high), "bus", "paint"),
    ]
    return join([*parts, _wheels((-0.28 * length, 0.3 * length), side, 0.48, "bus")])


def _large_van(rng: np.random.Generator) -> Solids:
    length, side, high, nose = (
        rng.uniform(5.4, 7.2),
        rng.uniform(0.98, 1.1),
        rng.uniform(2.3, 2.9),
        rng.uniform(0.7, 1.2),
    )
    half = length / 2
    parts = [
        box((-half, half - nose), (-side, side), (0.35, high), "truck", "paint"),
        box((half - nose, half), (-0.95 * side, 0.95 * side), (0.35, rng.uniform(1.1, 1.5)), "truck", "paint"),
        box((half - nose, half - 0.4 * nose), (-0.9 * side, 0.9 * side), (1.1, 0.75 * high), "truck", "glass"),
    ]
    return join([*parts, _wheels((-0.3 * length, 0.32 * length), side, 0.35, "truck")])


def _wheels(axles: tuple[float, ...], side: float, radius: float, kind: str = "car") -> Solids:
    hubs = np.array([[x, y, radius] for x in axles for y in (-side + 0.12, side - 0.12)])
    half = np.array([0.0, 0.11, 0.0])
    return limbs(hubs - half, hubs + half, np.full(len(hubs), radius), kind, ["rubber"] * len(hubs))
