"""The ground of a street: carriageway with crown or crossfall, gutters, kerbs, footways, verges, islands and ramps.

Upright it is the highest of some sloping rectangles over a gentle base (slope and bend). Sizes, from design guides:

- crossfall 2 to 3 %: TxDOT Roadway Design Manual 9.2.4 (2 %, at most 3 %); Wakefield Design Code G4.23 (1 in 40);
  two planes that meet at a crown line: AASHTO, A Policy on Geometric Design of Highways and Streets, ch. 4
- kerb 75 to 150 mm: Buckinghamshire technical design information (125 mm); AS 2876 kerb and gutter (150 mm)
- gutter 0.3 to 0.6 m wide, 5 to 8 %: FHWA HEC-22, Urban Drainage Design Manual, ch. 5
- crossing ramp at most 1 in 12: Hampshire, dropped kerbs; upstand at a ramp 0 to 6 mm (Buckinghamshire);
  flared sides at most 1 in 10: ADA Standards 406.3
- verge 2 to 8 % (AASHTO ch. 4: unpaved 2 to 6 %, steeper behind)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spotter_sim.scene import Ground

_FACE_M = 0.01  # from the top of a kerb to its foot
_FAR_M = 300.0


class Patch(NamedTuple):
    """A sloping rectangle: rise over the base = ``rise_m`` + ``x_slope`` x + ``y_slope`` y, map metres."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    rise_m: float
    x_slope: float = 0.0
    y_slope: float = 0.0


@dataclass(frozen=True)
class Ramp:
    """A dropped kerb for a crossing: a slope of 1 in ``one_in`` down to the carriageway between two flared sides."""

    y_m: float
    width_m: float = 1.8
    one_in: float = 12.0
    flare_one_in: float = 10.0


@dataclass(frozen=True)
class CrossSection:
    """A street along y. Its carriageway lies between two kerbs; the crown line is at rise 0, kerbs are lower."""

    kerbs_x_m: tuple[float, float]
    crown_x_m: float  # at a kerb: one crossfall from side to side
    crossfall: float = 0.025
    kerb_m: float = 0.125
    gutter_m: float = 0.0  # width at each kerb
    gutter_slope: float = 0.06
    footway_m: tuple[float, float] = (2.5, 2.5)  # widths; verges begin behind
    footway_slope: float = 0.02  # down to the kerb
    verge_slope: float = 0.04  # up, away from the street
    ramps: tuple[Ramp, ...] = ()  # through both kerbs
    island: tuple[float, float, float, float] | None = None  # x from, to, y from, to: kerbed all round

    def patches(self) -> Iterator[Patch]:
        """The rectangles of the whole street."""
        yield from self._side(-1)
        yield from self._side(+1)
        if self.island is not None:
            yield from self._kerbed_island(*self.island)

    def carriageway(self, side: int) -> Patch:
        """The plane from the crown line to the kerb (gutter not counted) on the side of lower (-1) or greater x."""
        kerb = self.kerbs_x_m[side > 0]
        x_m = (kerb + self.gutter_m, self.crown_x_m) if side < 0 else (self.crown_x_m, kerb - self.gutter_m)
        fall = self.crossfall
        return Patch(x_m, (-_FAR_M, _FAR_M), side * fall * self.crown_x_m, -side * fall)

    def _side(self, side: int) -> Iterator[Patch]:
        """Everything from the crown line outwards, with u the distance from the kerb, outwards positive."""
        kerb = self.kerbs_x_m[side > 0]
        width_m = side * (kerb - self.crown_x_m)
        edge_m = -self.crossfall * (width_m - self.gutter_m) if width_m > 0 else 0.0  # the crown line is this kerb
        foot_m = edge_m - self.gutter_slope * self.gutter_m if width_m > 0 else edge_m
        if width_m > 0:
            yield self.carriageway(side)
        if self.gutter_m and width_m > 0:
            yield self._strip(side, (-self.gutter_m, 0.0), (foot_m, -self.gutter_slope))
        yield from self._behind_the_kerb(side, foot_m)

    def _behind_the_kerb(self, side: int, foot_m: float) -> Iterator[Patch]:
        """Kerb face, footway with its ramps, verge."""
        top_m, wide_m, low_m = foot_m + self.kerb_m, self.footway_m[side > 0], -_FAR_M
        for ramp in sorted(self.ramps, key=lambda ramp: ramp.y_m):
            half = 0.5 * ramp.width_m
            flare_m = self.kerb_m * ramp.flare_one_in
            outer = (ramp.y_m - half - flare_m, ramp.y_m + half + flare_m)
            yield from self._footway(side, (low_m, outer[0]), (top_m, wide_m))
            yield from self._ramp(side, ramp, foot_m)
            low_m = outer[1]
        yield from self._footway(side, (low_m, _FAR_M), (top_m, wide_m))
        back_m = top_m + self.footway_slope * wide_m
        yield self._strip(side, (wide_m, _FAR_M), (back_m - self.verge_slope * wide_m, self.verge_slope))

    def _footway(self, side: int, y_m: tuple[float, float], kerb_top: tuple[float, float]) -> Iterator[Patch]:
        top_m, wide_m = kerb_top
        yield self._strip(side, (0.0, wide_m), (top_m, self.footway_slope), y_m)
        yield self._strip(side, (-_FACE_M, 0.0), (top_m, self.kerb_m / _FACE_M), y_m)

    def _ramp(self, side: int, ramp: Ramp, foot_m: float) -> Iterator[Patch]:
        """The slope, the footway behind it, and the flares, which rise to the full kerb to either side."""
        half, wide_m = 0.5 * ramp.width_m, self.footway_m[side > 0]
        flare_m, flare = self.kerb_m * ramp.flare_one_in, 1.0 / ramp.flare_one_in
        outer = (ramp.y_m - half - flare_m, ramp.y_m + half + flare_m)
        steep, top_m = 1.0 / ramp.one_in + self.footway_slope, foot_m + self.kerb_m
        landing_m = min(self.kerb_m * ramp.one_in, wide_m)  # where slope and footway meet
        yield self._strip(side, (0.0, landing_m), (foot_m, steep), outer)
        yield self._strip(side, (landing_m, wide_m), (top_m, self.footway_slope), outer)
        for sign, y_m in ((-1, (outer[0], ramp.y_m - half)), (+1, (ramp.y_m + half, outer[1]))):
            at_zero = foot_m - sign * flare * (ramp.y_m + sign * half)
            for u_m, rise in (((0.0, landing_m), self.footway_slope), ((-_FACE_M, 0.0), self.kerb_m / _FACE_M)):
                patch = self._strip(side, u_m, (at_zero, rise), y_m)
                yield patch._replace(y_slope=sign * flare)

    def _strip(
        self,
        side: int,
        u_m: tuple[float, float],
        line: tuple[float, float],
        y_m: tuple[float, float] = (-_FAR_M, _FAR_M),
    ) -> Patch:
        """A strip along the kerb: rise = line[0] + line[1] u, u metres outwards from the kerb."""
        kerb, (at_kerb_m, slope) = self.kerbs_x_m[side > 0], line
        x_m = (kerb + u_m[0], kerb + u_m[1]) if side > 0 else (kerb - u_m[1], kerb - u_m[0])
        return Patch(x_m, y_m, at_kerb_m - side * slope * kerb, side * slope)

    def _kerbed_island(self, x0: float, x1: float, y0: float, y1: float) -> Iterator[Patch]:
        """A level top a kerb higher than the crown line, with steep faces that end below the carriageway."""
        steep, deep = 1.0 / _FACE_M, 2 * _FACE_M
        top_m = self.kerb_m
        yield Patch((x0, x1), (y0, y1), top_m)
        yield Patch((x0 - deep, x0), (y0, y1), top_m - steep * x0, steep)
        yield Patch((x1, x1 + deep), (y0, y1), top_m + steep * x1, -steep)
        yield Patch((x0, x1), (y0 - deep, y0), top_m - steep * y0, 0.0, steep)
        yield Patch((x0, x1), (y1, y1 + deep), top_m + steep * y1, 0.0, -steep)


@dataclass(frozen=True)
class StreetGround(Ground):
    """A cross section on the slope and bend of the base."""

    section: CrossSection = CrossSection((2.0, 9.0), 5.5)

    @property
    def patches(self) -> np.ndarray:
        """(M, 7) float64: x from, to, y from, to, rise, slope along x, slope along y."""
        return np.array([[*p.x_m, *p.y_m, p.rise_m, p.x_slope, p.y_slope] for p in self.section.patches()])

    def height(self, x_m: np.ndarray | float, y_m: np.ndarray | float) -> np.ndarray | float:
        """z in map metres."""
        x, y = np.asarray(x_m, float)[..., None], np.asarray(y_m, float)[..., None]
        x0, x1, y0, y1, rise, along_x, along_y = self.patches.T
        on = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        return super().height(x_m, y_m) + np.where(on, rise + along_x * x + along_y * y, -np.inf).max(axis=-1)

    def gradient(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Rise per metre along x and along y at a place; a kerb's face counts as its top."""
        step_m = 0.05
        along_x, along_y = super().gradient(x_m, y_m)
        near = self._rise(np.array([x_m - step_m, x_m + step_m, x_m, x_m]), y_m + np.array([0, 0, -step_m, step_m]))
        slope_x, slope_y = (near[1] - near[0]) / (2 * step_m), (near[3] - near[2]) / (2 * step_m)
        limit = 0.1  # on a kerb nobody climbs at the slope of its face
        return along_x + float(np.clip(slope_x, -limit, limit)), along_y + float(np.clip(slope_y, -limit, limit))

    def _rise(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.asarray(self.height(x, y)) - np.asarray(super().height(x, y))

    def road_plane(self, x_m: float, y_m: float) -> tuple[np.ndarray, np.ndarray]:
        """(point, unit normal) of the carriageway where it is nearest to a place beside it or on it."""
        section = self.section
        side = -1 if x_m < section.crown_x_m else 1
        patch = section.carriageway(side)
        if patch.x_m[0] >= patch.x_m[1]:  # one crossfall: the crown line is the kerb of this side
            patch = section.carriageway(-side)
        x = float(np.clip(x_m, *patch.x_m))
        along_x, along_y = super().gradient(x, y_m)
        z = float(super().height(x, y_m)) + patch.rise_m + patch.x_slope * x
        normal = np.array([-along_x - patch.x_slope, -along_y, 1.0])
        return np.array([x, y_m, z]), normal / np.linalg.norm(normal)
