"""How far: from a box, the lens, real sizes by class and, when the camera's place is known, the ground.

Depth d along the optical axis to the middle of the object, for a pinhole with focal length f_y and the horizon at
row v0; L is how deep a vehicle is, judged from the box's aspect (0 for people and small things):

* height   d = f_y * H / (bottom - top) + L / 4    the bottom belongs to the near side, the top to the middle
* ground   d = f_y * C / (bottom - v0) + 0.3 L     the near wheels touch the ground, C below the camera
* top      d = f_y * (H - C) / (v0 - top)          for objects clearly taller than the camera stands
* width    d = f_x * W / (right - left)            only when the height is cut off

Each cue has a relative uncertainty (spread of sizes, placement of the box, nodding and slope); cues are averaged in
1/d with inverse variances. A cue whose edge is cut off by the picture still bounds the distance: a cut box says "at
most".
Single-view geometry of this kind: Hoiem, Efros and Hebert, Putting Objects in Perspective, 2006.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from services.jetson.camera.config import ClassSize, DistanceConfig, LensConfig, MountConfig

AGREE_SIGMAS = 3.0  # cues further apart contradict each other: the nearer is believed
TALLER_SIGMAS = 3.0  # the top cue needs an object that is taller than the camera by this many spreads
MIN_MOUNT_M = 0.01  # a camera lower than this has no place: it was not told
AXLE = 0.3  # of a vehicle's length: from its middle to an axle
CLEAR_SIGMAS = 2.0  # ... and a row that differs from the horizon by this many uncertainties


class Distance(NamedTuple):
    """Metres along the optical axis. ``truncated``: the box is cut off and the object may be nearer."""

    distance_m: float  # to the object's middle
    sigma_m: float
    near_m: float  # to its nearest side
    truncated: bool


class Cue(NamedTuple):
    """One measurement, or one upper bound, of the distance to the object's middle."""

    distance_m: float
    relative_sigma: float


class Cut(NamedTuple):
    """Which edges of the picture a box touches."""

    left: bool
    top: bool
    right: bool
    bottom: bool


def scaled(lens: LensConfig, width_px: int, height_px: int) -> LensConfig:
    """The lens for another picture size that shows the same view, squeezed or not: rows and columns scale apart."""
    across, down = width_px / lens.width_px, height_px / lens.height_px
    return LensConfig(
        width_px=width_px,
        height_px=height_px,
        f_x_px=lens.f_x_px * across,
        f_y_px=lens.f_y_px * down,
        c_x_px=lens.c_x_px * across,
        c_y_px=lens.c_y_px * down,
    )


def estimate(box: np.ndarray, label: str, lens: LensConfig, mount: MountConfig, config: DistanceConfig) -> Distance:
    """Distance of one box (x1, y1, x2, y2) in pixels of a picture of the lens's size.

    A class without a known size is given the smallest one: the nearest it could be.
    """
    size = config.sizes.get(label) or min(config.sizes.values(), key=lambda known: known.height_m)
    cut = edges_cut(box, lens, config.edge)
    measured: list[Cue] = []
    bounds: list[Cue] = []
    for cue, is_bound in (*_vertical_cues(box, size, cut, lens, mount, config), *_width_cues(box, size, cut, lens)):
        (bounds if is_bound else measured).append(cue)
    best = min([*bounds, *([_fuse(measured)] if measured else [])], key=lambda cue: cue.distance_m)
    near_m = max(best.distance_m - reach_m(box, size, cut), 0.0)
    return Distance(best.distance_m, best.distance_m * best.relative_sigma, near_m, any(cut))


def edges_cut(box: np.ndarray, lens: LensConfig, edge: float) -> Cut:
    """Sides within ``edge`` (a fraction of the picture's height) of the picture's border."""
    left, top, right, bottom = (float(value) for value in box)
    margin_px = edge * lens.height_px
    return Cut(
        left <= margin_px,
        top <= margin_px,
        right >= lens.width_px - margin_px,
        bottom >= lens.height_px - margin_px,
    )


def depth_m(box: np.ndarray, size: ClassSize, cut: Cut) -> float:
    """How deep the object is along the view: its end is seen narrow and long, its side wide and short."""
    if size.length_m == 0 or any(cut):
        return 0.0
    seen_width_m = float(box[2] - box[0]) / max(float(box[3] - box[1]), 1.0) * size.height_m
    return float(np.clip(size.length_m + size.width_m - seen_width_m, size.width_m, size.length_m))


def reach_m(box: np.ndarray, size: ClassSize, cut: Cut) -> float:
    """How much nearer the nearest side is than the distance: half the depth; of a vehicle that is cut off only the
    overhang before the wheels, because nothing is known of the rest; a person is half as deep as broad.
    """
    if size.length_m == 0:
        return size.width_m / 4
    if any(cut):
        return (0.5 - AXLE) * (size.length_m + size.width_m) / 2
    return depth_m(box, size, cut) / 2


def _vertical_cues(
    box: np.ndarray, size: ClassSize, cut: Cut, lens: LensConfig, mount: MountConfig, config: DistanceConfig
) -> list[tuple[Cue, bool]]:
    """Height, ground and top cues, each with whether it is only a bound."""
    top, bottom = float(box[1]), float(box[3])
    height_px, deep_m = max(bottom - top, 1.0), depth_m(box, size, cut)
    relative = math.hypot(size.height_sigma_m / size.height_m, math.sqrt(2) * config.box_sigma_px / height_px)
    height = Cue(lens.f_y_px * size.height_m / height_px + deep_m / 4, relative)
    found = [(height, cut.top or cut.bottom)]
    if mount.height_m < MIN_MOUNT_M:
        return found

    horizon_px = lens.c_y_px + lens.f_y_px * math.tan(mount.pitch_rad)
    row_sigma_px = math.hypot(lens.f_y_px * mount.pitch_sigma_rad, config.box_sigma_px)
    below_px = bottom - horizon_px
    if below_px > CLEAR_SIGMAS * row_sigma_px:
        relative = math.hypot(mount.height_sigma_m / mount.height_m, row_sigma_px / below_px)
        found.append((Cue(lens.f_y_px * mount.height_m / below_px + AXLE * deep_m, relative), cut.bottom))

    above_px, taller_m = horizon_px - top, size.height_m - mount.height_m
    stands_out = above_px > CLEAR_SIGMAS * row_sigma_px and taller_m > TALLER_SIGMAS * size.height_sigma_m
    if cut.bottom and not cut.top and stands_out:
        relative = math.hypot(size.height_sigma_m / taller_m, row_sigma_px / above_px)
        found.append((Cue(lens.f_y_px * taller_m / above_px, relative), False))
    return found


def _width_cues(box: np.ndarray, size: ClassSize, cut: Cut, lens: LensConfig) -> list[tuple[Cue, bool]]:
    """The width, for want of a height: between the object's narrow side and its long one."""
    if not (cut.top or cut.bottom):
        return []
    width_px, widest_m = max(float(box[2] - box[0]), 1.0), max(size.length_m, size.width_m)
    mean_m, spread_m = (size.width_m + widest_m) / 2, (widest_m - size.width_m) / 4 + 0.2 * size.width_m
    bound_m = mean_m + 2 * spread_m
    found = [(Cue(lens.f_x_px * bound_m / width_px, spread_m / bound_m), True)]
    if not (cut.left or cut.right):
        found.append((Cue(lens.f_x_px * mean_m / width_px, spread_m / mean_m), False))
    return found


def _fuse(measured: list[Cue]) -> Cue:
    """Inverse-variance mean in 1/d, where rows are linear; of contradicting cues the nearer is believed."""
    nearest = min(measured, key=lambda cue: cue.distance_m)
    agreeing = [cue for cue in measured if _agree(cue, nearest)]
    nearness = np.array([1.0 / cue.distance_m for cue in agreeing])
    weights = np.array([(cue.distance_m / max(cue.relative_sigma, 1e-3)) ** 2 for cue in agreeing])
    mean = float((weights * nearness).sum() / weights.sum())
    return Cue(1.0 / mean, float(1.0 / math.sqrt(weights.sum())) / mean)


def _agree(one: Cue, other: Cue) -> bool:
    apart = abs(1.0 / one.distance_m - 1.0 / other.distance_m)
    sigma = math.hypot(one.relative_sigma / one.distance_m, other.relative_sigma / other.distance_m)
    return apart <= AGREE_SIGMAS * sigma
