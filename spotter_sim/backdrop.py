"""What the camera of a driving vehicle has behind the bodies: sky, and paving whose joints stay where they are."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from common.geometry import invert, transform_points
from spotter_sim.model import WorldState
from spotter_sim.scene import Scene
from spotter_sim.solids import BOX, KINDS, PARTS, Solids, join
from spotter_sim.view import NEAR_M, Lens

_IN_VIEW_M = 40.0
_JOINTS_M = 14  # joints are drawn so far around the vehicle
_NEW_VIEW_M = 2.0  # what is near is looked up anew after so long a way
_PLINTH_M = 0.45
_GROUND, _WALL = KINDS.index("ground"), KINDS.index("wall")


def fixtures_in_view(world: WorldState) -> Solids:
    """Fixtures near enough to be drawn; the road itself is the backdrop."""
    x, y, z = (world.T_map_vehicle @ world.chassis.T_vehicle_camera)[:3, 3].tolist()
    return _painted(world.scene, round(x / _NEW_VIEW_M), round(y / _NEW_VIEW_M), round(z / _NEW_VIEW_M))


@lru_cache(maxsize=32)
def _painted(scene: Scene, column: int, row: int, level: int) -> Solids:
    """The fixtures around a place; walls have a dark plinth, so that one that fills the picture is not a fog."""
    place = _NEW_VIEW_M * np.array([column, row, level], float)
    near = scene.fixtures.near(place, _IN_VIEW_M)
    near = near.take(near.kind != _GROUND)
    up = near.from_unit[:, 2, 2]
    tall = (near.shape == BOX) & (near.kind == _WALL) & (up > _PLINTH_M)
    walls = near.take(tall)
    foot = walls.centre_m[:, 2] - up[tall]
    half = 0.5 * (_PLINTH_M - foot)  # the plinth ends so high above the map's ground
    plinth = _resized(walls, foot + half, half)
    plinth = replace(plinth, part=np.full(len(plinth), PARTS.index("wood"), np.uint8))
    top_half = up[tall] - half
    return join([near.take(~tall), plinth, _resized(walls, foot + 2.0 * half + top_half, top_half)])


def _resized(walls: Solids, middle_m: np.ndarray, half_m: np.ndarray) -> Solids:
    """The same upright boxes between other heights."""
    centre, from_unit = walls.centre_m.copy(), walls.from_unit.copy()
    centre[:, 2], from_unit[:, 2, 2] = middle_m, half_m
    return replace(walls, centre_m=centre, from_unit=from_unit)


def backdrop(world: WorldState, lens: Lens) -> np.ndarray:
    """(height, width, 3) uint8 BGR: a bright sky and paving with joints every metre of the map, grain on both."""
    horizon = int(np.clip(_horizon_row(lens), 0, lens.height_px))
    picture = _sky_and_ground(lens.width_px, lens.height_px, horizon).copy()
    for start, end in _joints(world, lens).tolist():
        cv2.line(picture, start, end, (88, 92, 95), 1, cv2.LINE_AA)
    return picture


@lru_cache(maxsize=32)
def _sky_and_ground(width: int, height: int, horizon: int) -> np.ndarray:
    rows = np.empty((height, 3))
    rows[:horizon] = np.linspace((235, 205, 170), (240, 235, 225), horizon)
    rows[horizon:] = np.linspace((135, 140, 142), (98, 103, 106), height - horizon)
    coarse = np.random.default_rng(11).normal(0, 7, (height // 4, width // 4)).astype(np.float32)
    grain = cv2.resize(coarse, (width, height))
    return np.clip(rows[:, None] + grain[..., None], 0, 255).astype(np.uint8)


def _horizon_row(lens: Lens) -> float:
    """The row of what is straight ahead at the camera's own height, far away."""
    T_map_camera = invert(lens.T_camera_map)
    ahead = T_map_camera[:3, 0] * [1.0, 1.0, 0.0]
    pixels, _ = lens.project(T_map_camera[:3, 3] + 1e5 * ahead / np.linalg.norm(ahead))
    return float(pixels[1])


def _joints(world: WorldState, lens: Lens) -> np.ndarray:
    """(J, 2, 2) ends in pixels of the lines along both axes of the map, as far as they are in front of the camera."""
    x, y = np.round(world.T_map_vehicle[:2, 3])
    metre = np.arange(-_JOINTS_M, _JOINTS_M + 1.0)
    far = np.full_like(metre, _JOINTS_M)
    along_x = np.stack([np.stack([x - far, y + metre], 1), np.stack([x + far, y + metre], 1)], 1)
    along_y = np.stack([np.stack([x + metre, y - far], 1), np.stack([x + metre, y + far], 1)], 1)
    ends = np.concatenate([along_x, along_y])
    ground = np.asarray(world.scene.ground.height(ends[..., 0], ends[..., 1]))
    return _in_front(np.concatenate([ends, np.broadcast_to(ground, ends.shape[:2])[..., None]], axis=2), lens)


def _in_front(lines_m: np.ndarray, lens: Lens) -> np.ndarray:
    """Lines (J, 2, 3) cut at the plane in front of the camera, then projected to whole pixels."""
    cut_m = 2 * NEAR_M
    depth_m = transform_points(lens.T_camera_map, lines_m)[..., 0]
    ahead = depth_m.max(axis=1) > cut_m
    lines_m, depth_m = lines_m[ahead], depth_m[ahead]
    share = (cut_m - depth_m) / (depth_m[:, ::-1] - depth_m + 1e-12)
    share = np.where(depth_m < cut_m, np.clip(share, 0.0, 1.0), 0.0)
    cut = lines_m + share[..., None] * (lines_m[:, ::-1] - lines_m)
    return np.clip(lens.project(cut)[0], -2e4, 2e4).astype(int)
