"""Ray casting of the 128-beam lidar: range and hit of every ray, then the returns that the receiver detects.

A solid is hit in its own unit space, where it is a unit sphere, cylinder or cube, or foliage that fills a unit sphere.
The numbers of the shapes are those of ``spotter_sim.solids``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import numba
import numpy as np

from spotter_sim.solids import CYLINDER, FOLIAGE, SPHERE

RANGE_NOISE_M = 0.02
_DROPOUT = 0.01
F = TypeVar("F", bound=Callable[..., object])
Vector = tuple[float, float, float]  # numbers stay in registers, where an array would be read from memory


def _kernel(function: F) -> F:
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


class Rays(NamedTuple):
    """The rays of one turn, C columns in firing order."""

    direction: np.ndarray  # (C, RINGS, 3) float32 unit vectors, sensor frame
    column_s: np.ndarray  # (C,) float64, relative to the middle of the turn


class RangeImage(NamedTuple):
    """The nearest surface on every ray."""

    range_m: np.ndarray  # (C, RINGS) float32, inf where there is none
    hit: np.ndarray  # (C, RINGS) int32 row of ``Targets``; -1 is the ground


class Ground(NamedTuple):
    """The ground z = a x + b y + c x^2 + d y^2 and what lies on it, map frame, and the pose of the sensor over it."""

    quadric: np.ndarray  # (4,) a, b, c, d
    patches: np.ndarray  # (M, 7) x from, to, y from, to, and a rise r + s x + t y there; the highest is the ground
    rotation: np.ndarray  # (3, 3) takes sensor directions to the map
    origin_m: np.ndarray  # (3,) the sensor in the map


class Targets(NamedTuple):
    """P solids, each with the ray start in its unit space and the window of rays that can hit it."""

    number: np.ndarray  # (P,) int64 index among all solids of the world
    shape: np.ndarray  # (P,) uint8: SPHERE, CYLINDER, BOX, FOLIAGE
    start: np.ndarray  # (P, 3) ray start at the middle of the turn, unit space
    drift: np.ndarray  # (P, 3) per second: the solid's own motion, unit space
    to_unit: np.ndarray  # (P, 3, 3) takes sensor directions to unit space
    windows: np.ndarray  # (P, 4) int64 first column, columns (modulo all), first ring, last ring + 1
    clear_m: np.ndarray  # (P,) no hit is nearer


class Returns(NamedTuple):
    """The N detected returns."""

    range_m: np.ndarray  # (N,) float32 with noise
    intensity: np.ndarray  # (N,) uint8
    ray: np.ndarray  # (N,) int64 column * RINGS + ring


@_kernel
def _turned(m: np.ndarray, rays: Rays, column: int, ring: int) -> Vector:
    """The direction of a ray times the matrix m (3, 3)."""
    x, y, z = rays.direction[column, ring, 0], rays.direction[column, ring, 1], rays.direction[column, ring, 2]
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@_kernel
def _start(targets: Targets, solid: int, time_s: float) -> Vector:
    """Where the rays of a column start in the unit space of a solid that moves."""
    at, drift = targets.start, targets.drift
    return (
        at[solid, 0] - drift[solid, 0] * time_s,
        at[solid, 1] - drift[solid, 1] * time_s,
        at[solid, 2] - drift[solid, 2] * time_s,
    )


@_kernel
def _range_to_patch(ground: Ground, patch: int, direction: Vector) -> float:
    """Range at which a ray, direction in the map, comes down on a patch, inf when it misses."""
    p, q = ground.patches, ground.quadric
    ox, oy, oz = ground.origin_m[0], ground.origin_m[1], ground.origin_m[2]
    dx, dy, dz = direction
    x0, x1, y0, y1 = p[patch, 0], p[patch, 1], p[patch, 2], p[patch, 3]
    if (ox > x1 and dx >= 0.0) or (ox < x0 and dx <= 0.0) or (oy > y1 and dy >= 0.0) or (oy < y0 and dy <= 0.0):
        return np.inf  # the ray leads away from it
    rise, a, b, c, d = p[patch, 4], q[0] + p[patch, 5], q[1] + p[patch, 6], q[2], q[3]
    # start + linear t - square t^2 = 0: the height of the ray over the ground
    start = oz - a * ox - b * oy - c * ox * ox - d * oy * oy - rise
    linear = dz - a * dx - b * dy - 2.0 * (c * ox * dx + d * oy * dy)
    square = c * dx * dx + d * dy * dy
    root = linear * linear + 4.0 * square * start
    if root < 0.0:
        return np.inf
    # the stable form of the root that goes to start / -linear for a plane
    denominator = -linear + np.sqrt(root)
    if denominator <= 1e-9:
        return np.inf
    t = 2.0 * start / denominator
    x, y = ox + t * dx, oy + t * dy
    return t if t > 0.0 and x0 <= x <= x1 and y0 <= y <= y1 else np.inf


@_kernel
def hit_ground(rays: Rays, ground: Ground, max_range_m: float, image: RangeImage) -> None:
    """Fill ``image`` with the range of every ray to the ground, inf beyond ``max_range_m``."""
    for column in range(image.range_m.shape[0]):
        for ring in range(image.range_m.shape[1]):
            direction, t = _turned(ground.rotation, rays, column, ring), np.inf
            for patch in range(ground.patches.shape[0]):
                t = min(t, _range_to_patch(ground, patch, direction))
            image.range_m[column, ring] = t if t <= max_range_m else np.inf
            image.hit[column, ring] = -1


@_kernel
def _noise(seed: np.uint64, ray: int) -> np.uint64:
    """64 random bits for a ray (SplitMix64, Steele et al. 2014)."""
    z = seed + np.uint64(0x9E3779B97F4A7C15) * (np.uint64(ray) + np.uint64(1))
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@_kernel
def _between_planes(o: float, d: float) -> tuple[float, float]:
    """Where o + t d passes -1 and 1, the nearer first."""
    per_unit = 1.0 / d if abs(d) > 1e-12 else 1e12
    middle, half = -o * per_unit, abs(per_unit)
    return middle - half, middle + half


@_kernel
def _within_circle(a: float, b: float, c: float) -> tuple[float, float]:
    """Where a t^2 + 2 b t + c is below 0; enter > leave where it never is."""
    root = b * b - a * c
    if root < 0.0 or (a < 1e-18 and c > 0.0):
        return np.inf, -np.inf
    if a < 1e-18:
        return -np.inf, np.inf
    spread = np.sqrt(root)
    return (-b - spread) / a, (-b + spread) / a


@_kernel
def _interval(shape: int, o: Vector, d: Vector) -> tuple[float, float]:
    """Where the ray o + t d enters and leaves a unit shape; enter > leave when it misses."""
    ox, oy, oz = o
    dx, dy, dz = d
    a, b, c = dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - 1.0
    if shape in (SPHERE, FOLIAGE):
        return _within_circle(a + dz * dz, b + oz * dz, c + oz * oz)
    low, high = _between_planes(oz, dz)
    if shape == CYLINDER:
        enter, leave = _within_circle(a, b, c)
        return max(low, enter), min(high, leave)
    left, right = _between_planes(ox, dx)
    back, front = _between_planes(oy, dy)
    return max(low, left, back), min(high, right, front)


@_kernel
def _range_to(shape: int, o: Vector, d: Vector, luck: float) -> float:
    """Range at which the ray hits the unit shape, inf when it misses. Leaves are hit somewhere inside or not at all."""
    enter, leave = _interval(shape, o, d)
    if shape == FOLIAGE:
        enter += 1.6 * luck * (leave - enter)
    return enter if 0.0 < enter <= leave else np.inf


@_kernel
def hit_solids(rays: Rays, targets: Targets, image: RangeImage) -> None:
    """Lower ``image.range_m`` where a solid is nearer and note its row in ``image.hit``."""
    columns, luck = rays.direction.shape[0], 0.0
    for solid in range(targets.shape.shape[0]):
        shape, to_unit, clear_m = targets.shape[solid], targets.to_unit[solid], targets.clear_m[solid]
        first_column, count, first_ring, stop_ring = targets.windows[solid]
        for k in range(count):
            column = (first_column + k) % columns
            o = _start(targets, solid, rays.column_s[column])
            for ring in range(first_ring, stop_ring):
                if image.range_m[column, ring] <= clear_m:
                    continue
                d = _turned(to_unit, rays, column, ring)
                if shape == FOLIAGE:  # the same leaves for the same ray in every turn
                    bits = _noise(np.uint64(targets.number[solid]), column * 128 + ring)
                    luck = np.float64(bits >> np.uint64(40)) / 2.0**24
                distance = _range_to(shape, o, d, luck)
                if distance < image.range_m[column, ring]:
                    image.range_m[column, ring] = distance
                    image.hit[column, ring] = solid


@_kernel
def measure(image: RangeImage, reflectivity: np.ndarray, max_range_m: float, seed: np.uint64) -> Returns:
    """Detect the returns: range noise, intensity, and the loss of weak returns and of one in a hundred others.

    Args:
        image: what the rays hit.
        reflectivity: (P + 1,) float32 of the targets; the last row is the ground's.
        max_range_m: a surface beyond it gives no return.
        seed: of the noise.
    """
    total = image.range_m.size
    measured, intensity = np.empty(total, np.float32), np.empty(total, np.uint8)
    rows = np.empty(total, np.int64)
    flat_range, flat_hit = image.range_m.ravel(), image.hit.ravel()
    mask, count = np.uint64(0xFFFF), 0
    for ray in range(total):
        distance = flat_range[ray]
        if distance > max_range_m:
            continue
        bits = _noise(seed, ray)
        # the sum of three uniform numbers is nearly normal; the fourth decides on a dropout
        spread = 0.0
        for shift in (0, 16, 32):
            spread += np.float64((bits >> np.uint64(shift)) & mask) / 65535.0 - 0.5
        luck = np.float64(bits >> np.uint64(48)) / 65536.0
        reflects = reflectivity[flat_hit[ray]]
        weak = distance * distance / (max_range_m * max_range_m) * 0.12 / reflects
        if luck < _DROPOUT + min(weak, 0.98):
            continue
        noise_m = RANGE_NOISE_M * 2.0 * spread  # three uniforms have a standard deviation of one half
        measured[count] = max(distance + noise_m, 0.1)
        brightness = 255.0 * reflects * (0.9 + 0.2 * spread)
        intensity[count] = np.uint8(min(max(brightness, 1.0), 255.0))
        rows[count] = ray
        count += 1
    return Returns(measured[:count], intensity[:count], rows[:count])
