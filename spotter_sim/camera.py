"""The camera's picture of the world, drawn with OpenCV: the same bodies that lidar and radar see.

Painter's algorithm: sky, ground and everything far that stands still are drawn once and kept; bodies and the near
walls are drawn over them, far to near, each solid as its shaded silhouette.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from common.geometry import invert
from spotter_sim.backdrop import backdrop, fixtures_in_view
from spotter_sim.model import Actor, DeviceUnplugged, Scenario, WorldState, noise_rng
from spotter_sim.solids import BOX, PARTS, SCENE_ID, Solids, join
from spotter_sim.view import F_Y_PX, FACE_NORMALS, FACES, NEAR_M, SIZE_PX, Lens, far_to_near, lens_of, outline_points
from spotter_sim.world import scenario_named, world_at

LABELS = {"pedestrian": "person", "cyclist": "bicycle", "car": "car", "bus": "bus", "truck": "truck"}
_FAR_M = 9.0  # fixtures beyond are background
_SUN = np.array([-0.55, 0.35, 0.76])
_PAINT = {
    "concrete": (150, 158, 165),
    "wood": (50, 75, 100),
    "leaves": (60, 120, 70),
    "metal": (120, 120, 125),
    "glass": (70, 55, 45),
    "rubber": (30, 30, 30),
    "lamp": (215, 245, 250),
    "dark": (24, 22, 22),
    "clear": (190, 185, 175),
}
_CLOTHES = ((60, 60, 200), (190, 90, 40), (70, 150, 60), (40, 170, 210), (120, 60, 130), (205, 200, 195), (45, 45, 50))
_TROUSERS = ((90, 60, 45), (50, 50, 50), (70, 90, 110), (120, 95, 70))
_SKIN = ((150, 180, 225), (95, 130, 180), (60, 85, 130))
_CARS = ((45, 45, 190), (200, 200, 205), (150, 80, 40), (60, 60, 65), (60, 140, 200), (120, 130, 90))


@dataclass(frozen=True)
class TrueBox:
    """One actor as the picture shows it."""

    actor_id: int
    label: str  # COCO name
    box_xyxy_px: tuple[float, float, float, float]  # clipped to the picture
    distance_m: float  # along the optical axis, to the nearest point of the body
    truncated: bool  # the picture's edge cuts it
    visible: float  # share of its own silhouette inside the picture that nothing hides, 0 to 1


def image(name: str | Scenario, t_s: float, width: int = SIZE_PX[0], height: int = SIZE_PX[1]) -> np.ndarray:
    """The picture at a time: (height, width, 3) uint8 BGR.

    Raises:
        DeviceUnplugged: fault ``camera_unplugged``.
    """
    world = world_at(name, t_s)
    if "camera_unplugged" in world.faults:
        raise DeviceUnplugged("simulated camera is unplugged")
    lens = lens_of(world, width, height)
    if world.drives:
        picture = backdrop(world, lens)
        _draw(picture, _on_stage(world, fixtures_in_view(world)), lens)
    else:
        background, near = _background(scenario_named(name), width, height)
        picture = background.copy()
        _draw(picture, _on_stage(world, near), lens)
    picture = cv2.GaussianBlur(picture, (3, 3), 0)
    gain = 0.07 if "camera_dark" in world.faults else world.weather.light
    return _expose(picture, noise_rng(world.scenario, world.t_s, "camera"), gain)


def boxes(name: str | Scenario, t_s: float, width: int = SIZE_PX[0], height: int = SIZE_PX[1]) -> list[TrueBox]:
    """The true boxes of all actors that have at least a pixel in the picture, hidden ones with ``visible`` = 0."""
    world = world_at(name, t_s)
    lens = lens_of(world, width, height)
    near = fixtures_in_view(world) if world.drives else _background(scenario_named(name), width, height)[1]
    stage = _on_stage(world, near)
    owners = np.full((height // 2, width // 2), SCENE_ID, np.int32)
    for i in far_to_near(stage, lens):
        _fill(owners, _silhouette(stage, i, lens) / 2, int(stage.owner[i]))
    found = (_true_box(actor, lens, owners) for actor in world.actors)
    return [box for box in found if box is not None]


def _true_box(actor: Actor, lens: Lens, owners: np.ndarray) -> TrueBox | None:
    """The box of an actor, or None when it is outside the picture."""
    points = np.vstack([outline_points(actor.solids, i) for i in range(len(actor.solids))])
    pixels, depth_m = lens.project(points)
    if depth_m.min() < NEAR_M:
        return None
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    size = np.array([lens.width_px, lens.height_px], float)
    clipped_low, clipped_high = np.clip(low, 0, size), np.clip(high, 0, size)
    if np.any(clipped_high - clipped_low < 1.0):
        return None
    own = np.zeros_like(owners, np.uint8)
    for i in range(len(actor.solids)):
        _fill(own, _silhouette(actor.solids, i, lens) / 2, 1)
    shown = int(np.count_nonzero((owners == actor.actor_id) & (own > 0))) / max(1, int(np.count_nonzero(own)))
    box = (float(clipped_low[0]), float(clipped_low[1]), float(clipped_high[0]), float(clipped_high[1]))
    truncated = bool(np.any(low < 0) or np.any(high > size))
    return TrueBox(actor.actor_id, LABELS[actor.kind], box, float(depth_m.min()), truncated, shown)


def _on_stage(world: WorldState, near_fixtures: Solids) -> Solids:
    return join([near_fixtures, *(actor.solids for actor in world.actors)])


@lru_cache(maxsize=4)
def _background(scenario: Scenario, width: int, height: int) -> tuple[np.ndarray, Solids]:
    """Sky, ground and far fixtures as a picture, and the near fixtures that are drawn with the bodies."""
    world = scenario.at(0.0)
    lens = lens_of(world, width, height)
    fixtures = scenario.scene.fixtures
    origin = invert(lens.T_camera_map)[:3, 3]
    far = np.linalg.norm(fixtures.centre_m - origin, axis=1) > _FAR_M
    picture = _sky_and_ground(lens)
    _draw(picture, fixtures.take(far), lens)
    return picture, fixtures.take(~far)


def _sky_and_ground(lens: Lens) -> np.ndarray:
    """A bright sky, paving with joints every metre that run away to the horizon, grain on both."""
    rng = np.random.default_rng(11)
    horizon = lens.height_px // 2
    picture = np.empty((lens.height_px, lens.width_px, 3), np.uint8)
    picture[:horizon] = np.linspace((235, 205, 170), (240, 235, 225), horizon)[:, None].astype(np.uint8)
    rows = lens.height_px - horizon
    picture[horizon:] = np.linspace((135, 140, 142), (98, 103, 106), rows)[:, None].astype(np.uint8)
    for metre in range(-12, 13):
        for line in (
            ((0.5, metre, 0.0), (40.0, metre, 0.0)),
            ((1.0 + metre % 13, -14.0, 0.0), (1.0 + metre % 13, 14.0, 0.0)),
        ):
            pixels, _ = lens.project(np.array(line))
            start, end = (tuple(int(c) for c in p) for p in pixels)
            cv2.line(picture, start, end, (88, 92, 95), 1, cv2.LINE_AA)
    coarse = rng.normal(0, 7, (lens.height_px // 4, lens.width_px // 4)).astype(np.float32)
    grain = cv2.resize(coarse, (lens.width_px, lens.height_px))
    return np.clip(picture + grain[..., None], 0, 255).astype(np.uint8)


def _draw(picture: np.ndarray, solids: Solids, lens: Lens) -> None:
    """Paint the solids over the picture, the farthest first."""
    eye = invert(lens.T_camera_map)[:3, 3]
    for i in far_to_near(solids, lens):
        colour = _colour(solids, i)
        if solids.shape[i] == BOX:
            _draw_box(picture, solids, i, colour, lens, eye)
        else:
            hull = _silhouette(solids, i, lens)
            _fill(picture, hull, _shaded(colour, 0.72))
            middle = hull.mean(axis=0)
            _fill(picture, middle + 0.62 * (hull - middle) + 0.12 * (hull[0] - middle), _shaded(colour, 1.0))


def _draw_box(picture: np.ndarray, solids: Solids, i: int, colour: np.ndarray, lens: Lens, eye: np.ndarray) -> None:
    """The faces of a box that look at the camera, each lit by the sun."""
    corners, depth_m = lens.project(outline_points(solids, i))
    axes = solids.from_unit[i]
    for face, unit_normal in zip(FACES, FACE_NORMALS, strict=True):
        outward = axes @ unit_normal
        if depth_m[face].max() > NEAR_M and outward @ (eye - solids.centre_m[i] - outward) > 0:
            light = 0.62 + 0.42 * max(0.0, float(outward @ _SUN) / float(np.linalg.norm(outward)))
            _fill(picture, corners[face], _shaded(colour, light))


def _silhouette(solids: Solids, i: int, lens: Lens) -> np.ndarray:
    """(K, 2) convex outline in pixels."""
    pixels, _ = lens.project(outline_points(solids, i))
    return np.asarray(cv2.convexHull(pixels.astype(np.float32)))[:, 0]


def _fill(picture: np.ndarray, outline: np.ndarray, value: tuple[int, ...] | int) -> None:
    """Fill a convex outline given in pixels (three binary places are kept)."""
    cv2.fillConvexPoly(picture, np.round(outline * 8).astype(np.int32), value, shift=3)


def _shaded(colour: np.ndarray, light: float) -> tuple[int, ...]:
    return tuple(int(c) for c in np.minimum(colour * light, 255))


def _colour(solids: Solids, i: int) -> np.ndarray:
    """Paint by part, clothes and cars by actor, house fronts by place."""
    part, owner = PARTS[solids.part[i]], int(solids.owner[i])
    choices = {"cloth": _CLOTHES, "trousers": _TROUSERS, "skin": _SKIN, "paint": _CARS}.get(part)
    if choices is not None:
        return np.array(choices[owner % len(choices)], float)
    tint = 1.0 + 0.12 * np.sin(37.0 * float(solids.centre_m[i].sum())) if owner == SCENE_ID else 1.0
    return np.array(_PAINT[part], float) * tint


@lru_cache(maxsize=1)
def _noise_bank() -> np.ndarray:
    """Sensor noise about 16, larger than a picture: every frame cuts another window from it."""
    return np.clip(np.random.default_rng(5).normal(16, 4, (1400, 1400, 3)), 0, 32).astype(np.uint8)


def _expose(picture: np.ndarray, rng: np.random.Generator, light: float) -> np.ndarray:
    """Exposure that wavers by a few per cent, and noise; in the dark next to nothing is left."""
    height, width = picture.shape[:2]
    bank = _noise_bank()
    row, column = rng.integers(0, bank.shape[0] - height), rng.integers(0, bank.shape[1] - width)
    gain = light * rng.uniform(0.97, 1.03)
    return cv2.addWeighted(picture, gain, bank[row : row + height, column : column + width], 1.0, -16.0)


__all__ = ["F_Y_PX", "LABELS", "TrueBox", "boxes", "image"]
