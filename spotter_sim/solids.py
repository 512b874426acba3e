"""Solids that rays can hit: the unit sphere, cylinder and cube, each under an affine map.

Every sensor looks at the same solids: the 2-D lidar cuts them, the 128-beam lidar casts rays at them, the radar takes
its scatterers from them, the camera projects them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

SPHERE, CYLINDER, BOX, FOLIAGE = range(4)  # the cylinder stands on z; foliage is a sphere that lets some rays through

# What a point belongs to; `Solids.kind` and the labels of a scan index this tuple.
KINDS = ("ground", "wall", "tree", "pole", "bush", "pedestrian", "cyclist", "car", "bus", "truck")
# What a solid is made of: reflectivity at 905 nm and the camera's paint.
PARTS = (
    "concrete",
    "wood",
    "leaves",
    "metal",
    "cloth",
    "trousers",
    "skin",
    "paint",
    "glass",
    "rubber",
    "lamp",
    "dark",
    "clear",
)
_PART_INDEX = {part: index for index, part in enumerate(PARTS)}
REFLECTIVITY = np.array(
    [0.45, 0.25, 0.5, 0.4, 0.4, 0.25, 0.5, 0.6, 0.1, 0.06, 0.9, 0.03, 0.0]
)  # dark: black cloth; clear: a pane that lets the laser through
SCENE_ID = -1
GROUND_ID = -2


@dataclass(frozen=True, eq=False, repr=False)
class Solids:
    """P solids in one frame. A point u of the unit shape lies at ``centre_m + from_unit @ u``."""

    shape: np.ndarray  # (P,) uint8: SPHERE, CYLINDER, BOX, FOLIAGE
    centre_m: np.ndarray  # (P, 3) float64
    from_unit: np.ndarray  # (P, 3, 3) float64: orthogonal columns, their lengths are the half sizes in metres
    kind: np.ndarray  # (P,) uint8 index into KINDS
    part: np.ndarray  # (P,) uint8 index into PARTS
    owner: np.ndarray  # (P,) int32 actor id, SCENE_ID for what stands there
    velocity_mps: np.ndarray  # (P, 3) float64

    def __len__(self) -> int:
        return len(self.shape)

    def __repr__(self) -> str:
        return f"Solids({len(self)})"

    @property
    def to_unit(self) -> np.ndarray:
        """(P, 3, 3) the inverse of ``from_unit``: scaled transpose, because the columns are orthogonal."""
        return self.from_unit.transpose(0, 2, 1) / np.sum(self.from_unit**2, axis=1)[:, :, None]

    @property
    def radius_m(self) -> np.ndarray:
        """(P,) radius of a ball about the centre that holds the solid."""
        half = np.sqrt(np.sum(self.from_unit**2, axis=1))
        round_m = half.max(axis=1)
        drum_m = np.hypot(np.maximum(half[:, 0], half[:, 1]), half[:, 2])
        box_m = np.sqrt(np.sum(half**2, axis=1))
        return np.select([self.shape == CYLINDER, self.shape == BOX], [drum_m, box_m], round_m)

    def take(self, index: np.ndarray) -> Solids:
        """Those at ``index``."""
        return Solids(*(getattr(self, name)[index] for name in _FIELDS))

    def near(self, point_m: np.ndarray, within_m: float) -> Solids:
        """Those with a part within ``within_m`` of a point."""
        return self.take(np.linalg.norm(self.centre_m - point_m, axis=1) - self.radius_m <= within_m)

    def placed(self, T_map_body: np.ndarray, owner: int, velocity_mps: np.ndarray) -> Solids:
        """The same solids carried from the body's frame into the map by a rigid transform."""
        rotation = T_map_body[:3, :3]
        return Solids(
            self.shape,
            self.centre_m @ rotation.T + T_map_body[:3, 3],
            rotation @ self.from_unit,
            self.kind,
            self.part,
            np.full(len(self), owner, np.int32),
            np.broadcast_to(velocity_mps, (len(self), 3)),
        )


_FIELDS = tuple(Solids.__dataclass_fields__)


def join(parts: list[Solids]) -> Solids:
    """All solids of the list as one; the list is not empty."""
    return Solids(*(np.concatenate([getattr(p, name) for p in parts]) for name in _FIELDS))


def solid(
    shape: int,
    centre_m: tuple[float, float, float],
    half_m: tuple[float, float, float],
    kind: str,
    part: str,
    rotation: np.ndarray | None = None,
) -> Solids:
    """One solid with the given half sizes, turned by ``rotation`` (3, 3)."""
    turn = np.eye(3) if rotation is None else rotation
    return Solids(
        np.array([shape], np.uint8),
        np.array([centre_m], float),
        (turn * np.asarray(half_m, float))[None],
        np.array([KINDS.index(kind)], np.uint8),
        np.array([PARTS.index(part)], np.uint8),
        np.array([SCENE_ID], np.int32),
        np.zeros((1, 3)),
    )


def limbs(start_m: ArrayLike, end_m: ArrayLike, radius_m: ArrayLike, kind: str, parts: Sequence[str]) -> Solids:
    """P straight cylinders from one point to another: legs, arms, the tubes of a bicycle, wheels.

    Args:
        start_m: (P, 3) and end_m: (P, 3), the middles of the two ends.
        radius_m: (P,)
        parts: P names of PARTS.
    """
    start, end = np.asarray(start_m, float), np.asarray(end_m, float)
    along = end - start
    length = np.sqrt(np.sum(along * along, axis=1))
    x, y, z = w = (along / length[:, None]).T
    level, zero = np.abs(y) < 0.9, np.zeros_like(x)
    u = np.where(level, [z, zero, -x], [zero, -z, y])  # w crossed with y, or with x where w is nearly y
    u /= np.sqrt(np.sum(u * u, axis=0))
    v = np.array([y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]])
    radius, count = np.asarray(radius_m, float), len(start)
    return Solids(
        np.full(count, CYLINDER, np.uint8),
        0.5 * (start + end),
        np.stack([u * radius, v * radius, w * (0.5 * length)]).transpose(2, 1, 0),
        np.full(count, KINDS.index(kind), np.uint8),
        np.array([_PART_INDEX[part] for part in parts], np.uint8),
        np.full(count, SCENE_ID, np.int32),
        np.zeros((count, 3)),
    )


def box(x_m: tuple[float, float], y_m: tuple[float, float], z_m: tuple[float, float], kind: str, part: str) -> Solids:
    """An upright box between two coordinates on each axis."""
    low, high = np.array([x_m[0], y_m[0], z_m[0]]), np.array([x_m[1], y_m[1], z_m[1]])
    (cx, cy, cz), (hx, hy, hz) = 0.5 * (low + high), 0.5 * (high - low)
    return solid(BOX, (cx, cy, cz), (hx, hy, hz), kind, part)
