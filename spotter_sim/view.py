"""Pinhole projection of solids: outlines in pixels, far to near. No drawing here.

Camera frame as the vehicle's: x is the optical axis, y left, z up. u = c_u - f y / x, v = c_v - f z / x, so that left
in the world is left in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.geometry import invert, transform_points
from spotter_sim.model import WorldState
from spotter_sim.solids import BOX, CYLINDER, PARTS, Solids

SIZE_PX = (640, 480)  # width, height the focal length is given for
F_Y_PX = 397.0  # IMX477 with a 3.9 mm lens, full sensor scaled to 640 x 480
NEAR_M = 0.2  # nearer than this is clamped: the picture plane
_CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
# The six faces: corners in order round the face, and the outward axis.
FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
FACE_NORMALS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], float)


def _rims() -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)])
    up = np.array([0.0, 0.0, 1.0])
    return np.vstack([ring - up, ring + up])


def _globe() -> np.ndarray:
    """24 points spread evenly over the unit sphere (golden spiral), a little outside so that the hull covers it."""
    k = np.arange(24) + 0.5
    polar, turn = np.arccos(1 - 2 * k / 24), np.pi * (1 + np.sqrt(5)) * k
    return 1.04 * np.column_stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)])


_RIMS, _GLOBE = _rims(), _globe()


@dataclass(frozen=True)
class Lens:
    """A pinhole at a place, for a picture size; ``f_px`` scales with the height of the picture."""

    T_camera_map: np.ndarray
    width_px: int
    height_px: int

    @property
    def f_px(self) -> tuple[float, float]:
        """(f_u, f_v)."""
        return F_Y_PX * self.width_px / SIZE_PX[0], F_Y_PX * self.height_px / SIZE_PX[1]

    def project(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Map points (..., 3) to pixels (..., 2) and depths (...,); points behind the picture plane are clamped."""
        p = transform_points(self.T_camera_map, points_m)
        depth_m = p[..., 0]
        x = np.maximum(depth_m, NEAR_M)
        f_u, f_v = self.f_px
        u = 0.5 * self.width_px - f_u * p[..., 1] / x
        v = 0.5 * self.height_px - f_v * p[..., 2] / x
        return np.stack([u, v], axis=-1), depth_m


def lens_of(world: WorldState, width_px: int = SIZE_PX[0], height_px: int = SIZE_PX[1]) -> Lens:
    """The vehicle's camera in this world."""
    return Lens(invert(world.T_map_vehicle @ world.chassis.T_vehicle_camera), width_px, height_px)


def outline_points(solids: Solids, index: int) -> np.ndarray:
    """(K, 3) map points whose convex hull is the solid (cubes: the eight corners in the order FACES names)."""
    shape = solids.shape[index]
    unit = _CUBE if shape == BOX else _RIMS if shape == CYLINDER else _GLOBE
    return solids.centre_m[index] + unit @ solids.from_unit[index].T


def far_to_near(solids: Solids, lens: Lens) -> np.ndarray:
    """Indices of the solids that may be in the picture, in painting order.

    Bodies go as a whole by the distance of their middle; within a body the wheels come first, since the body covers
    them, then its solids by distance.
    """
    place = transform_points(lens.T_camera_map, solids.centre_m)
    distance = np.linalg.norm(place, axis=1)
    whole = distance.copy()
    for owner in np.unique(solids.owner[solids.owner >= 0]):
        own = solids.owner == owner
        whole[own] = distance[own].mean()
    slope = 0.5 * lens.width_px / lens.f_px[0]
    inside = np.abs(place[:, 1]) < slope * np.maximum(place[:, 0], 0.0) + 1.2 * solids.radius_m
    reach = np.sum(np.abs(lens.T_camera_map[0, :3] @ solids.from_unit), axis=1)  # along the optical axis
    order = np.lexsort((-distance, solids.part != PARTS.index("rubber"), -whole))
    return order[(inside & (place[:, 0] + reach > NEAR_M))[order]]
