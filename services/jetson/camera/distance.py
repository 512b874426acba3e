"""How far: from a box, the lens, real sizes by class and, when the camera's place is known, the ground.

Depth d along the optical axis to the middle of the object, for a pinhole with focal length f_y and the horizon at
row v0; L is how deep a vehicle is, judged from the box's aspect (0 for people and small things):

* height   d = f_y * H / (bottom - top) + L/4 * (1 + C/H)   the bottom belongs to the near side, the top to the roof
* ground   d = f_y * C / (bottom - v0) + 0.3 L     the near wheels touch the ground, C below the camera
* top      d = f_y * (H - C) / (v0 - top)          for objects clearly taller than the camera stands
* width    d = f_x * W / (right - left)            only when the height is cut off

Each cue has a relative uncertainty (spread of sizes, placement of the box, nodding and slope); cues are averaged in
1/d with inverse variances. A cue whose edge is cut off by the picture still bounds the distance: a cut box says "at
most".

The height's second term is how much nearer its edges are: bottom - top = f_y * (C / (d - L/2) + (H - C) / (d - L/4)),
the near side on the ground and the front edge of the roof; C is 0 where it is not known.
Single-view geometry of this kind: Hoiem, Efros and Hebert, Putting Objects in Perspective, 2006.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from services.jetson.camera.config import ClassSize, DistanceConfig, LensConfig, MountConfig

NEAR_SIGMAS = 1.64  # below the distance: nearer than that is one in twenty
LOW_MOUNT_M = 0.25  # of a camera whose height is unknown: on a small vehicle
AGREE_SIGMAS_OF_ANY_SIZE = 1.5  # of a class with small members (children): the foot point tells more than the height
AGREE_SIGMAS = 3.0  # cues further apart contradict each other: the nearer is believed
TALLER_SIGMAS = 3.0  # the top cue needs an object that is taller than the camera by this many spreads
MIN_MOUNT_M = 0.01  # a camera lower than this has no place: it was not told
AXLE = 0.3  # of a vehicle's length: from its middle to an axle
CLEAR_SIGMAS = 2.0  # ... and a row that differs from the horizon by this many uncertainties


class Distance(NamedTuple):
    """Metres along the optical axis. ``truncated``: the box is cut off and the object may be nearer."""

    distance_m: float  # to the object's middle
    sigma_m: float
    near_m: float  # to its nearest side, the near end of what is possible
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
    """The lens for another picture size. Pixels stay square: another shape is the same view, cut around its middle.

    A sensor's 16:9 mode is its 4:3 picture without the upper and lower rows, as wide as before; narrower shapes lose
    columns instead.
    """
    wider = width_px * lens.height_px >= height_px * lens.width_px
    scale = width_px / lens.width_px if wider else height_px / lens.height_px
    return LensConfig(
        width_px=width_px,
        height_px=height_px,
        f_x_px=lens.f_x_px * scale,
        f_y_px=lens.f_y_px * scale,
        c_x_px=width_px / 2 + (lens.c_x_px - lens.width_px / 2) * scale,
        c_y_px=height_px / 2 + (lens.c_y_px - lens.height_px / 2) * scale,
        distortion=lens.distortion,
    )


def undistorted(box: np.ndarray, lens: LensConfig) -> np.ndarray:
    """The box (x1, y1, x2, y2) as a lens without distortion would show it: the middle of each edge is moved."""
    if not any(lens.distortion):
        return box
    left, top, right, bottom = (float(value) for value in box)
    across, down = (left + right) / 2, (top + bottom) / 2
    edges = np.array([[[left, down]], [[right, down]], [[across, top]], [[across, bottom]]])
    matrix = np.array([[lens.f_x_px, 0, lens.c_x_px], [0, lens.f_y_px, lens.c_y_px], [0, 0, 1.0]])
    moved = cv2.undistortPoints(edges, matrix, np.array(lens.distortion), P=matrix)[:, 0]
    return np.array([moved[0, 0], moved[2, 1], moved[1, 0], moved[3, 1]])


def estimate(box: np.ndarray, label: str, lens: LensConfig, mount: MountConfig, config: DistanceConfig) -> Distance:
    """Distance of one box (x1, y1, x2, y2) in pixels of a picture of the lens's size.

    A class without a known size is given the smallest one: the nearest it could be.
    """
    size = config.size_of(label) or smallest(config)
    cut, box = edges_cut(box, lens, config.edge), undistorted(box, lens)
    measured: list[Cue] = []
    bounds: list[Cue] = []
    for cue, is_bound in (*_vertical_cues(box, size, cut, lens, mount, config), *_width_cues(box, size, cut, lens)):
        (bounds if is_bound else measured).append(cue)
    agree = AGREE_SIGMAS_OF_ANY_SIZE if size.height_min_m else AGREE_SIGMAS
    best = min([*bounds, *([_fuse(measured, agree)] if measured else [])], key=lambda cue: cue.distance_m)
    near_m = _near_end_m(best, box, size, cut, lens, mount)
    if not measured and mount.height_m >= MIN_MOUNT_M:
        near_m = min(near_m, best.distance_m / 2)  # only "at most": as much again is taken to be out of view
    near_m = max(near_m - reach_m(box, size, cut), 0.0)
    return Distance(best.distance_m, best.distance_m * best.relative_sigma, near_m, any(cut))


def smallest(config: DistanceConfig) -> ClassSize:
    """What a class without a known size is taken for."""
    return min(config.sizes.values(), key=lambda known: known.height_m)


def _near_end_m(best: Cue, box: np.ndarray, size: ClassSize, cut: Cut, lens: LensConfig, mount: MountConfig) -> float:
    """The near end of what is possible, to the object's middle.

    With the mount known: of the interval of the cues. Otherwise of the class's smallest member; of a thing that reaches
    below the picture as near as the ground is there for a low camera; of one that reaches above it, as much again is
    taken to be out of view.
    """
    near_m = best.distance_m * max(1.0 - NEAR_SIGMAS * best.relative_sigma, 0.0)
    if mount.height_m >= MIN_MOUNT_M:
        return near_m
    height_px = max(float(box[3] - box[1]), 1.0)
    near_m = min(near_m, lens.f_y_px * size.lowest_m / height_px)
    if cut.bottom:
        return min(near_m, lens.f_y_px * LOW_MOUNT_M / max(lens.height_px - lens.c_y_px, 1.0))
    return min(near_m, best.distance_m / 2) if cut.top else near_m


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
    nearer_m = deep_m / 4 * (1.0 + min(mount.height_m / size.height_m, 1.0))
    height = Cue(lens.f_y_px * size.height_m / height_px + nearer_m, relative)
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


def _fuse(measured: list[Cue], agree_sigmas: float) -> Cue:
    """Inverse-variance mean in 1/d, where rows are linear; of contradicting cues the nearer is believed."""
    nearest = min(measured, key=lambda cue: cue.distance_m)
    agreeing = [cue for cue in measured if _agree(cue, nearest, agree_sigmas)]
    nearness = np.array([1.0 / cue.distance_m for cue in agreeing])
    weights = np.array([(cue.distance_m / max(cue.relative_sigma, 1e-3)) ** 2 for cue in agreeing])
    mean = float((weights * nearness).sum() / weights.sum())
    return Cue(1.0 / mean, float(1.0 / math.sqrt(weights.sum())) / mean)


def _agree(one: Cue, other: Cue, sigmas: float) -> bool:
    apart = abs(1.0 / one.distance_m - 1.0 / other.distance_m)
    sigma = math.hypot(one.relative_sigma / one.distance_m, other.relative_sigma / other.distance_m)
    return apart <= sigmas * sigma
