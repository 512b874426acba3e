"""Rays against solids in plain numpy: every ray against every solid, for few of both and as a reference.

Slab and quadric tests in the unit frame of each solid (Glassner, An Introduction to Ray Tracing, 1989, ch. 2).
"""

from __future__ import annotations

import numpy as np

from spotter_sim.solids import BOX, CYLINDER, Solids


def _ball(o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters where rays o + t d enter and leave the unit ball (in as many dimensions as given)."""
    a = np.sum(d * d, axis=-1)
    b = np.sum(o * d, axis=-1)
    c = np.sum(o * o, axis=-1) - 1.0
    flat = a < 1e-18  # parallel to the axis: always inside, or never
    root = b * b - a * c
    hit = np.where(flat, c <= 0, root >= 0)
    spread = np.sqrt(np.maximum(root, 0.0))
    safe = np.where(flat, 1.0, a)
    enter = np.where(flat, -np.inf, (-b - spread) / safe)
    leave = np.where(flat, np.inf, (-b + spread) / safe)
    return np.where(hit, enter, np.inf), np.where(hit, leave, -np.inf)


def _slab(o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters where rays enter and leave |component| <= 1."""
    safe = np.where(np.abs(d) < 1e-12, 1e-12, d)
    first, second = (-1.0 - o) / safe, (1.0 - o) / safe
    return np.minimum(first, second), np.maximum(first, second)


def cast(
    origin_m: np.ndarray, direction: np.ndarray, solids: Solids, max_range_m: float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """First hit of each ray from one origin.

    Args:
        origin_m: (3,) in the solids' frame.
        direction: (N, 3) unit vectors.

    Returns:
        range_m (N,) float64, inf without a hit; index (N,) int of the solid hit, -1 without.
    """
    n = len(direction)
    if len(solids) == 0:
        return np.full(n, np.inf), np.full(n, -1)
    o = np.einsum("pij,pj->pi", solids.to_unit, origin_m - solids.centre_m)[None]  # (1, P, 3)
    d = np.einsum("pij,nj->npi", solids.to_unit, direction)  # (N, P, 3)
    return _first(np.broadcast_to(o, d.shape), d, solids.shape, max_range_m)


def cast_moving(
    origin_m: np.ndarray, direction: np.ndarray, seconds: np.ndarray, solids: Solids, max_range_m: float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """The same for rays that leave from their own places at their own times, while the solids move on.

    Args:
        origin_m: (N, 3).
        direction: (N, 3) unit vectors.
        seconds: (N,) after the moment at which the solids are where they say; each goes on with its velocity.
    """
    n = len(direction)
    near = _reachable(origin_m, seconds, solids, max_range_m)
    if not len(near):
        return np.full(n, np.inf), np.full(n, -1)
    close = solids.take(near)
    start = origin_m[:, None] - close.centre_m - seconds[:, None, None] * close.velocity_mps  # (N, P, 3)
    o = np.einsum("pij,npj->npi", close.to_unit, start)
    d = np.einsum("pij,nj->npi", close.to_unit, direction)
    range_m, index = _first(o, d, close.shape, max_range_m)
    return range_m, np.where(index >= 0, near[index], -1)


def _reachable(origin_m: np.ndarray, seconds: np.ndarray, solids: Solids, max_range_m: float) -> np.ndarray:
    """Numbers of the solids that any of the rays can reach at all."""
    middle = origin_m.mean(axis=0)
    spread_m = float(np.linalg.norm(origin_m - middle, axis=1).max())
    drift_m = np.linalg.norm(solids.velocity_mps, axis=1) * float(np.abs(seconds).max())
    away_m = np.linalg.norm(solids.centre_m - middle, axis=1) - solids.radius_m - drift_m - spread_m
    return np.flatnonzero(away_m <= max_range_m)


def _first(o: np.ndarray, d: np.ndarray, shape: np.ndarray, max_range_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Range and number of the solid that each ray hits first, from origins and directions (N, P, 3) in unit frames."""
    n = len(d)
    enter, leave = _interval(o, d, shape)
    t = np.where((enter <= leave) & (enter > 0.0) & (enter <= max_range_m), enter, np.inf)
    index = np.argmin(t, axis=1)
    range_m = t[np.arange(n), index]
    return range_m, np.where(np.isfinite(range_m), index, -1)


def _interval(o: np.ndarray, d: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entering and leaving parameters (N, P) of rays in the unit frames."""
    enter, leave = np.empty(d.shape[:2]), np.empty(d.shape[:2])
    is_box, is_drum = shape == BOX, shape == CYLINDER
    for these, test in ((is_box, _cube), (is_drum, _drum), (~is_box & ~is_drum, _ball)):
        if these.any():
            enter[:, these], leave[:, these] = test(o[:, these], d[:, these])
    return enter, leave


def _cube(o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    enter, leave = _slab(o, d)
    return enter.max(axis=-1), leave.min(axis=-1)


def _drum(o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    (enter, leave), (low, high) = _ball(o[..., :2], d[..., :2]), _slab(o[..., 2], d[..., 2])
    return np.maximum(enter, low), np.minimum(leave, high)
