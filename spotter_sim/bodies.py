"""The bodies of people and vehicles as solids: believable enough that a classifier trained on them means something.

Body frame: origin at the centre of the foot print, x forward, y left, z up, metres.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from spotter_sim.solids import SPHERE, Solids, box, join, limbs, solid

DEFAULT_SIZE_M: dict[str, tuple[float, float, float]] = {
    "pedestrian": (0.55, 0.60, 1.72),
    "cyclist": (1.75, 0.60, 1.75),
    "car": (4.30, 1.80, 1.48),
    "bus": (12.0, 2.55, 3.10),
    "truck": (8.00, 2.45, 3.40),
}
STRIDE_M = 1.4  # one full cycle of both legs
_CRANK_M = 4.0  # way of a bicycle per turn of the cranks


def body(kind: str, size_m: tuple[float, float, float], travelled_m: float = 0.0, speed_mps: float = 0.0) -> Solids:
    """The solids of one actor in its body frame; legs move with the way travelled.

    Raises ``KeyError`` for a kind that has no body.
    """
    if kind == "pedestrian":
        return _pedestrian(size_m, 2 * np.pi * travelled_m / STRIDE_M, min(1.0, speed_mps / 1.3))
    if kind == "cyclist":
        return _cyclist(size_m, 2 * np.pi * travelled_m / _CRANK_M)
    return _vehicle(kind, size_m)


def _pedestrian(size_m: tuple[float, float, float], phase_rad: float, effort: float) -> Solids:
    """Torso, head, two legs that swing about the hip and two arms that swing against them."""
    height, broad = size_m[2] / 1.72, size_m[1] / 0.60
    side = np.array([1.0, -1.0])
    swing = side * 0.30 * effort * np.sin(phase_rad)
    hip = np.array([[0.0, s * 0.10 * broad, 0.88 * height] for s in side])
    shoulder = np.array([[0.0, s * 0.235 * broad, 1.38 * height] for s in side])
    down = np.column_stack([np.sin(swing), [0.0, 0.0], -np.cos(swing)])
    foot = hip + 0.88 * height * down
    hand = shoulder + 0.62 * height * down * [-1.0, 1.0, 1.0]
    parts = ["trousers", "trousers", "cloth", "cloth"]
    radius = [0.075, 0.075, 0.045, 0.045]
    return join(
        [_trunk(height, broad), limbs(np.vstack([foot, hand]), np.vstack([hip, shoulder]), radius, "pedestrian", parts)]
    )


@lru_cache(maxsize=512)
def _trunk(height: float, broad: float) -> Solids:
    torso = solid(SPHERE, (0.0, 0.0, 1.20 * height), (0.13, 0.20 * broad, 0.32 * height), "pedestrian", "cloth")
    head = solid(SPHERE, (0.02, 0.0, 1.60 * height), (0.10, 0.085, 0.12 * height), "pedestrian", "skin")
    hips = solid(SPHERE, (0.0, 0.0, 0.90 * height), (0.13, 0.17 * broad, 0.20 * height), "pedestrian", "cloth")
    return join([torso, hips, head])


# A bicycle of 1.75 m with its rider: start, end (metres), radius, part.
_BICYCLE = (
    ((-0.53, -0.02, 0.34), (-0.53, 0.02, 0.34), 0.34, "rubber"),
    ((0.53, -0.02, 0.34), (0.53, 0.02, 0.34), 0.34, "rubber"),
    ((-0.53, 0.0, 0.34), (-0.18, 0.0, 0.88), 0.02, "metal"),
    ((-0.18, 0.0, 0.80), (0.38, 0.0, 0.82), 0.02, "metal"),
    ((-0.05, 0.0, 0.30), (0.38, 0.0, 0.82), 0.025, "metal"),
    ((0.53, 0.0, 0.34), (0.36, 0.0, 1.02), 0.02, "metal"),
    ((0.38, -0.28, 1.04), (0.38, 0.28, 1.04), 0.018, "metal"),
    ((-0.20, 0.0, 0.92), (0.16, 0.0, 1.42), 0.16, "cloth"),
    ((0.12, 0.19, 1.36), (0.38, 0.25, 1.06), 0.045, "cloth"),
    ((0.12, -0.19, 1.36), (0.38, -0.25, 1.06), 0.045, "cloth"),
)


def _cyclist(size_m: tuple[float, float, float], crank_rad: float) -> Solids:
    """A rider bent over a frame with two thin wheels; the feet follow the cranks."""
    scale = np.array(size_m) / DEFAULT_SIZE_M["cyclist"]
    tubes = list(_BICYCLE)
    for side in (1.0, -1.0):
        crank = crank_rad + side * np.pi / 2
        pedal = (0.02 + 0.17 * np.cos(crank), side * 0.10, 0.33 + 0.17 * np.sin(crank))
        tubes.append((pedal, (-0.18, side * 0.10, 0.92), 0.07, "trousers"))
    start, end, radius, parts = zip(*tubes, strict=True)
    head = solid(SPHERE, (0.24 * scale[0], 0.0, 1.62 * scale[2]), (0.11, 0.09, 0.13), "cyclist", "skin")
    return join([head, limbs(np.array(start) * scale, np.array(end) * scale, radius, "cyclist", parts)])


@lru_cache(maxsize=512)
def _vehicle(kind: str, size_m: tuple[float, float, float]) -> Solids:
    return {"car": _car, "bus": _bus, "truck": _truck}[kind](*size_m)


def _car(length: float, width: float, height: float) -> Solids:
    """Lower body over four wheels, a cabin that tapers upwards, lamps."""
    half, side = length / 2, width / 2
    parts = [
        box((-half, half), (-side, side), (0.18, 0.56 * height), "car", "paint"),
        box(
            (-0.40 * length, 0.22 * length), (-0.93 * side, 0.93 * side), (0.56 * height, 0.80 * height), "car", "glass"
        ),
        box((-0.34 * length, 0.12 * length), (-0.86 * side, 0.86 * side), (0.80 * height, height), "car", "paint"),
    ]
    for y in (-0.7 * side, 0.7 * side):
        parts.append(
            box((half - 0.02, half + 0.005), (y - 0.12, y + 0.12), (0.36 * height, 0.46 * height), "car", "lamp")
        )
    return join(parts + _wheels("car", (-0.31 * length, 0.31 * length), side, 0.31))


def _bus(length: float, width: float, height: float) -> Solids:
    half, side = length / 2, width / 2
    parts = [
        box((-half, half), (-side, side), (0.32, height), "bus", "paint"),
        box((-0.48 * length, half + 0.01), (-side - 0.01, side + 0.01), (1.25, 0.78 * height), "bus", "glass"),
    ]
    return join(parts + _wheels("bus", (-0.28 * length, 0.30 * length), side, 0.48))


def _truck(length: float, width: float, height: float) -> Solids:
    """A cab, a higher load box behind it and a narrow chassis."""
    half, side = length / 2, width / 2
    cab = half - 2.1
    parts = [
        box((cab, half), (-0.97 * side, 0.97 * side), (0.45, 0.80 * height), "truck", "paint"),
        box((cab + 0.9, half + 0.01), (-0.9 * side, 0.9 * side), (0.50 * height, 0.72 * height), "truck", "glass"),
        box((-half, cab - 0.25), (-side, side), (1.0, height), "truck", "cloth"),
        box((-half + 0.2, cab), (-0.35 * side, 0.35 * side), (0.55, 1.0), "truck", "metal"),
    ]
    return join(parts + _wheels("truck", (-half + 1.4, half - 1.2), side, 0.48))


def _wheels(kind: str, axles_m: tuple[float, float], side_m: float, radius_m: float) -> list[Solids]:
    hubs = np.array([[x, y, radius_m] for x in axles_m for y in (-side_m + 0.12, side_m - 0.12)])
    half_width = np.array([0.0, 0.11, 0.0])
    return [limbs(hubs - half_width, hubs + half_width, [radius_m] * 4, kind, ["rubber"] * 4)]
