"""The bodies of people and vehicles as solids: believable enough that a classifier trained on them means something.

Body frame: origin at the centre of the foot print, x forward, y left, z up, metres.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from common.sim.solids import SPHERE, Solids, box, join, limb, solid

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
    height = size_m[2] / 1.72
    broad = size_m[1] / 0.60
    parts = [
        solid(SPHERE, (0.0, 0.0, 1.16 * height), (0.13, 0.20 * broad, 0.36 * height), "pedestrian", "cloth"),
        solid(SPHERE, (0.02, 0.0, 1.60 * height), (0.10, 0.085, 0.12 * height), "pedestrian", "skin"),
    ]
    for side in (1.0, -1.0):
        swing = side * 0.30 * effort * np.sin(phase_rad)
        hip = np.array([0.0, side * 0.10 * broad, 0.88 * height])
        foot = hip + 0.88 * height * np.array([np.sin(swing), 0.0, -np.cos(swing)])
        shoulder = np.array([0.0, side * 0.235 * broad, 1.38 * height])
        hand = shoulder + 0.62 * height * np.array([np.sin(-0.8 * swing), 0.0, -np.cos(0.8 * swing)])
        parts += [limb(foot, hip, 0.075, "pedestrian", "trousers"), limb(hand, shoulder, 0.045, "pedestrian", "cloth")]
    return join(parts)


def _cyclist(size_m: tuple[float, float, float], crank_rad: float) -> Solids:
    """A rider bent over a frame with two thin wheels."""
    scale = np.array([size_m[0] / 1.75, size_m[1] / 0.60, size_m[2] / 1.75])

    def tube(start: tuple[float, float, float], end: tuple[float, float, float], radius: float, part: str) -> Solids:
        return limb(np.multiply(start, scale), np.multiply(end, scale), radius, "cyclist", part)

    parts = [
        tube((-0.53, -0.02, 0.34), (-0.53, 0.02, 0.34), 0.34, "rubber"),
        tube((0.53, -0.02, 0.34), (0.53, 0.02, 0.34), 0.34, "rubber"),
        tube((-0.53, 0, 0.34), (-0.18, 0, 0.88), 0.02, "metal"),
        tube((-0.18, 0, 0.80), (0.38, 0, 0.82), 0.02, "metal"),
        tube((-0.05, 0, 0.30), (0.38, 0, 0.82), 0.025, "metal"),
        tube((0.53, 0, 0.34), (0.36, 0, 1.02), 0.02, "metal"),
        tube((0.38, -0.28, 1.04), (0.38, 0.28, 1.04), 0.018, "metal"),
        tube((-0.20, 0, 0.92), (0.16, 0, 1.42), 0.16, "cloth"),
        solid(SPHERE, tuple(np.multiply((0.24, 0.0, 1.62), scale)), (0.11, 0.09, 0.13), "cyclist", "skin"),
    ]
    for side in (1.0, -1.0):
        pedal = (0.02 + 0.17 * np.cos(crank_rad + side * np.pi / 2), side * 0.10, 0.33)
        pedal = (pedal[0], pedal[1], 0.33 + 0.17 * np.sin(crank_rad + side * np.pi / 2))
        parts.append(tube(pedal, (-0.18, side * 0.10, 0.92), 0.07, "trousers"))
        parts.append(tube((0.12, side * 0.19, 1.36), (0.38, side * 0.25, 1.06), 0.045, "cloth"))
    return join(parts)


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
    return [
        limb(np.array([x, y - 0.11, radius_m]), np.array([x, y + 0.11, radius_m]), radius_m, kind, "rubber")
        for x in axles_m
        for y in (-side_m + 0.12, side_m - 0.12)
    ]
