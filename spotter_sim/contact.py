"""How near the vehicle's outline is to anything, and when it will touch: plain geometry, what no sensor knows.

Seen from above. The gap between two convex shapes is the greatest separation along any direction (separating axis
theorem; Ericson, Real-Time Collision Detection, 2005, ch. 5), here along directions every two degrees: exact within
0.02 %. Only what reaches into the height of the vehicle counts, and no ground.
"""

from __future__ import annotations

import numpy as np

from common.geometry import invert
from spotter_sim.model import WorldState
from spotter_sim.solids import BOX, KINDS, Solids
from spotter_sim.view import outline_points

CLEARANCE_M = 0.02  # what lies flatter is driven over
SEEN_M = 3.0  # gaps beyond are reported as this
STEP_S = 0.1
_GROUND = KINDS.index("ground")


def _directions(step_deg: float) -> np.ndarray:
    angle = np.radians(np.arange(0.0, 360.0, step_deg))
    return np.stack([np.cos(angle), np.sin(angle)])


_FINE, _COARSE = _directions(2.0), _directions(10.0)


def gap_m(world: WorldState, within_m: float = SEEN_M) -> float:
    """From the outline to the nearest part of a body or fixture; 0 or less: they touch. At most ``within_m``."""
    points = _planforms(world, _obstacles(world, within_m))
    return min(within_m, float(_separations(points, world, _FINE).min(initial=within_m)))


def contact_s(world: WorldState, horizon_s: float) -> float | None:
    """When the outline will touch something if all go on as they do: speed and yaw rate, and the others' velocity.

    Returns:
        Seconds from now, to ``STEP_S``; None = not within ``horizon_s``.
    """
    reach_m = abs(world.vehicle_speed_mps) * horizon_s + 6.0 * horizon_s
    solids = _obstacles(world, min(reach_m, 30.0))
    if not len(solids):
        return None
    seconds = np.arange(0.0, horizon_s + 1e-9, STEP_S)
    poses = world.vehicle.T_map_vehicle_after(seconds)
    moving = np.stack([_corners(solids, i) for i in range(len(solids))])  # (P, 24, 3)
    for later_s, pose in zip(seconds, poses, strict=True):
        inverse = invert(pose)
        points = (moving + later_s * solids.velocity_mps[:, None]) @ inverse[:2, :3].T + inverse[:2, 3]
        if _separations(points, world, _COARSE).min() <= 0.0:
            return float(later_s)
    return None


def _corners(solids: Solids, index: int) -> np.ndarray:
    """(24, 3) points whose hull is the solid; the eight of a box come three times."""
    return np.resize(outline_points(solids, index), (24, 3))


def _obstacles(world: WorldState, within_m: float) -> Solids:
    """What could be touched: in the height of the vehicle."""
    T = world.T_map_vehicle
    near = world.solids_near(T[:3, 3], within_m + world.chassis.size_m[0])
    rows = np.abs(near.from_unit[:, 2, :])
    half_m = np.where(near.shape == BOX, rows.sum(axis=1), np.linalg.norm(rows, axis=1))
    above_m = near.centre_m[:, 2] - T[2, 3]
    low = above_m - half_m < world.chassis.size_m[2]
    return near.take(low & (above_m + half_m > CLEARANCE_M) & (near.kind != _GROUND))


def _planforms(world: WorldState, solids: Solids) -> np.ndarray:
    """(P, 24, 2) corners of the solids seen from above, vehicle frame."""
    if not len(solids):
        return np.empty((0, 24, 2))
    inverse = invert(world.T_map_vehicle)
    points = np.stack([_corners(solids, i) for i in range(len(solids))])
    return np.asarray(points @ inverse[:2, :3].T + inverse[:2, 3])


def _separations(points: np.ndarray, world: WorldState, directions: np.ndarray) -> np.ndarray:
    """(P,) gaps between the vehicle's rectangle about its origin and convex shapes given by their corners."""
    length, width, _ = world.chassis.size_m
    own = 0.5 * length * np.abs(directions[0]) + 0.5 * width * np.abs(directions[1])
    nearest = (points @ directions).min(axis=1, initial=np.inf)  # (P, D)
    return np.asarray((nearest - own).max(axis=1, initial=-np.inf))
