"""Flat ground with a ramp on it: a way up, a level top and a way down, in the height field and as solids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.geometry import rotation_rpy
from spotter_sim.scene import Ground
from spotter_sim.solids import BOX, Solids, box, join, solid

_THICK_M = 0.5
_APRON_M = 60.0  # flat ground around the map's origin that rays can hit


@dataclass(frozen=True)
class Ramp:
    """Along x from ``start_m``: ``slope_m`` up, ``top_m`` level, ``slope_m`` down; between two y."""

    start_m: float
    slope_m: float
    top_m: float
    rise_m: float
    y_m: tuple[float, float]

    @property
    def knots(self) -> tuple[list[float], list[float]]:
        """x and z of the four edges."""
        x = self.start_m
        up, down = x + self.slope_m, x + self.slope_m + self.top_m
        return [x, up, down, down + self.slope_m], [0.0, self.rise_m, self.rise_m, 0.0]


@dataclass(frozen=True)
class RampedGround(Ground):
    """Level but for the ramp."""

    ramp: Ramp = Ramp(0.0, 1.0, 1.0, 0.0, (0.0, 0.0))

    def height(self, x_m: np.ndarray | float, y_m: np.ndarray | float) -> np.ndarray | float:
        """z in map metres."""
        low, high = self.ramp.y_m
        inside = (np.asarray(y_m) >= low) & (np.asarray(y_m) <= high)
        return np.where(inside, np.interp(x_m, *self.ramp.knots, left=0.0, right=0.0), 0.0)

    def gradient(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Rise per metre along x and along y at a place."""
        step_m = 0.01
        rise = float(self.height(x_m + step_m, y_m)) - float(self.height(x_m - step_m, y_m))
        return rise / (2 * step_m), 0.0

    @property
    def solids(self) -> Solids:
        """The surfaces, for rays: a lidar on a vehicle that pitches hits the ground."""
        xs, zs = self.ramp.knots
        flat = box((-_APRON_M, _APRON_M), (-_APRON_M, _APRON_M), (-_THICK_M, 0.0), "ground", "concrete")
        slabs = [self._slab((xs[i], zs[i]), (xs[i + 1], zs[i + 1])) for i in range(3)]
        return join([flat, *slabs])

    def _slab(self, start: tuple[float, float], end: tuple[float, float]) -> Solids:
        """A slab whose upper face runs from one edge to the next."""
        (x0, z0), (x1, z1) = start, end
        tilt = np.arctan2(z1 - z0, x1 - x0)
        turn = rotation_rpy(0.0, -tilt, 0.0)
        low, high = self.ramp.y_m
        middle = np.array([0.5 * (x0 + x1), 0.5 * (low + high), 0.5 * (z0 + z1)]) - 0.5 * _THICK_M * turn[:, 2]
        half = (0.5 * float(np.hypot(x1 - x0, z1 - z0)), 0.5 * (high - low), 0.5 * _THICK_M)
        return solid(BOX, (middle[0], middle[1], middle[2]), half, "ground", "concrete", turn)
