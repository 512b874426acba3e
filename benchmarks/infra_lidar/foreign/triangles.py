"""Skins of triangles (T, 3, 3), and rays against them (Möller & Trumbore, JGT 1997)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def cast(eye: np.ndarray, rays: np.ndarray, mesh: np.ndarray) -> np.ndarray:
    """(n,) distance to the nearest triangle, inf without."""
    best = np.full(len(rays), np.inf)
    for a, b, c in mesh:
        ab, ac, s = b - a, c - a, eye - a
        h = np.cross(rays, ac)
        det = h @ ab
        safe = np.where(np.abs(det) < 1e-12, 1e-12, det)
        u, q = h @ s / safe, np.cross(s, ab)
        v, t = rays @ q / safe, (ac @ q) / safe
        np.copyto(best, t, where=(u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0.3) & (t < best))
    return best


def tube(rings: list[tuple[float, float, float, float, float]], sides: int = 7) -> np.ndarray:
    """(T, 3, 3) skin over ellipses x, y, z, half x, half y from below to above."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    loops = np.array(
        [
            np.column_stack((x + hx * np.cos(angle), y + hy * np.sin(angle), np.full(sides, z)))
            for x, y, z, hx, hy in rings
        ]
    )
    return skin(loops)


def skin(loops: np.ndarray) -> np.ndarray:
    """Triangles between loops (L, S, 3) of S points, and fans over both ends."""
    low, high, n = loops[:-1], loops[1:], loops.shape[1]
    right_low, right_high = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    walls = np.concatenate((np.stack((low, right_low, high), axis=2), np.stack((high, right_low, right_high), axis=2)))
    fans = [
        np.stack((np.broadcast_to(end.mean(axis=0), (n, 3)), end, np.roll(end, -1, axis=0)), axis=1)
        for end in (loops[0], loops[-1])
    ]
    return np.concatenate((walls.reshape(-1, 3, 3), *fans))


def extruded(profile: list[tuple[float, float]], width: float, narrow: float = 1.0, waist: float = 1e9) -> np.ndarray:
    """A side view (x, z) drawn across ``width``; above ``waist`` it is narrower."""
    side = np.array([(x, 0.5 * width * (narrow if z > waist else 1.0), z) for x, z in profile])
    return skin(np.stack((side * [1, -1, 1], side)))


def rod(start: tuple[float, float, float], end: tuple[float, float, float], r: float, sides: int = 5) -> np.ndarray:
    """A stick between two points."""
    a, b = np.array(start, float), np.array(end, float)
    w = (b - a) / np.linalg.norm(b - a)
    u = np.cross(w, [0.0, 1.0, 0.0] if abs(w[1]) < 0.9 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[:, None]
    ring = r * (np.cos(angle) * u + np.sin(angle) * np.cross(w, u))
    return skin(np.stack((a + ring, b + ring)))


def wheel(x: float, y: float, r: float, thick: float, open_: bool = False) -> np.ndarray:
    """A wheel on the ground in the x-z plane; ``open_``: its rim alone."""
    if not open_:
        return rod((x, y - thick / 2, r), (x, y + thick / 2, r), r, 9)
    angle = np.linspace(0, 2 * np.pi, 10)
    at = [(x + r * np.cos(t), y, r + r * np.sin(t)) for t in angle]
    return np.concatenate([rod(p, q, 0.022, 3) for p, q in pairwise(at)])
