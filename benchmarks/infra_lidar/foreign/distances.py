"""Bodies as signed distances, and rays traced through them (sphere tracing: Hart, The Visual Computer 1996)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

_STEPS, _CLOSE_M = 28, 0.01


@dataclass
class Body:
    """Rows of capsules (ends and radius: 7), of boxes (centre, half sizes, rounding: 7) and of rings about y (centre,
    radius, thickness: 5); ``loose``: the body is foliage, a ray may go this deep before it returns (m)."""

    capsules: list[Sequence[float]] = field(default_factory=list)
    boxes: list[Sequence[float]] = field(default_factory=list)
    rings: list[Sequence[float]] = field(default_factory=list)
    loose: float = 0.0

    def distance(self, p: np.ndarray) -> np.ndarray:
        """(n,) metres from points (n, 3) to the nearest surface, negative inside."""
        least = np.full(len(p), np.inf)
        for ax, ay, az, bx, by, bz, r in self.capsules:
            a, ab = np.array([ax, ay, az]), np.array([bx - ax, by - ay, bz - az])
            t = np.clip((p - a) @ ab / max(ab @ ab, 1e-9), 0.0, 1.0)
            least = np.minimum(least, np.linalg.norm(p - a - t[:, None] * ab, axis=1) - r)
        for x, y, z, hx, hy, hz, r in self.boxes:
            q = np.abs(p - [x, y, z]) - np.array([hx, hy, hz]) + r
            out = np.linalg.norm(np.maximum(q, 0.0), axis=1)
            least = np.minimum(least, out + np.minimum(q.max(axis=1), 0.0) - r)
        for x, y, z, radius, thick in self.rings:
            around = np.hypot(p[:, 0] - x, p[:, 2] - z) - radius
            least = np.minimum(least, np.hypot(around, p[:, 1] - y) - thick)
        return least

    def reach(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) of all of it."""
        low, high = [], []
        for c in self.capsules:
            ends = np.array([c[:3], c[3:6]])
            low.append(ends.min(axis=0) - c[6])
            high.append(ends.max(axis=0) + c[6])
        for b in self.boxes:
            low.append(np.array(b[:3]) - b[3:6])
            high.append(np.array(b[:3]) + b[3:6])
        for x, y, z, radius, thick in self.rings:
            half = np.array([radius + thick, thick, radius + thick])
            low.append(np.array([x, y, z]) - half)
            high.append(np.array([x, y, z]) + half)
        return np.min(low, axis=0), np.max(high, axis=0)


def trace(rng: np.random.Generator, body: Body, eye: np.ndarray, rays: np.ndarray, away: float) -> np.ndarray:
    """(n,) range of each ray, inf where it misses; in foliage a ray returns somewhere behind the first leaf."""
    low, high = body.reach()
    start = max(away - float(np.linalg.norm(np.maximum(abs(low), abs(high)))), 0.5)
    t, live = np.full(len(rays), start), np.ones(len(rays), bool)
    far = away + float(np.linalg.norm(np.maximum(abs(low), abs(high))))
    gap = np.full(len(rays), np.inf)
    for _ in range(_STEPS):
        gap[live] = body.distance(eye + t[live, None] * rays[live])
        t[live] += gap[live]
        live &= (gap > _CLOSE_M) & (t < far)
        if not live.any():
            break
    hit = (gap < 3 * _CLOSE_M) & (t < far)
    deep = rng.exponential(body.loose, len(t)) if body.loose else 0.0
    return np.where(hit & (deep < 6 * body.loose + 1e-9), t + deep, np.inf)
