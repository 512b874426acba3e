"""Where the road is: the plane at the foot of the pole, from the first frames (RANSAC, then a robust refit).

Method: the best of many planes (``hypotheses.py``) in a cloud thinned to one point per voxel, so that a facade beside
the pole counts by its area only. It is refitted by iteratively reweighted least squares (Tukey's weight); where the
cross section shows kerbs or a crown line (``carriageway.py``) only by the carriageway at the foot. Its plane there is
the answer. The error is estimated by leaving out one direction after another (jackknife over sectors), and grows with
the distance of the road that was seen and with what a second look from the plane that was found makes of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from common.geometry import rotation_between, transform
from services.infra_lidar.calibration.carriageway import find_carriageway
from services.infra_lidar.calibration.hypotheses import best_hypothesis
from services.infra_lidar.config import CalibrationConfig

VOXEL_M = 0.25
MAX_POINTS = 6000
REACHES = (1.0, 1.5, 2.25)  # of the radius: what is tried in turn
REACH_HEIGHTS = 2.2  # the carriageway is looked for this many heights away at least: 20 m from a mast of 10 m
LANE_SCALES = (10.0, 2.0, 1.0, 0.5, 0.4)  # of the band in which the carriageway is fitted, one fit after the other
MAX_LOSS = 0.4  # of a street's profile: streets have 0.1 to 0.3, recorded open places 0.46 to 0.58
DOUBTFUL_LOSS = 0.45  # up to here it may still be a street: the plane it would give counts to the stated error
GROUND_M, GROUND_SLOPE = 0.3, 0.05  # what may be ground beside the rough plane, and more with distance
NEAR_M = 8.0  # at this distance from the foot a point of the road weighs half
ERROR_FACTOR = 2.5  # the stated error is this many jackknife errors ...
BEND_PER_M = 2e-4  # ... and that of a road that bends with a radius of 5 km
SECTORS = 8
MIN_AREA_CELLS = 60  # square metres of road, at least
# Places of the sums of 1, x, y, z, xx, xy, yy, xz, yz in the normal equations of a plane
_NORMAL, _RIGHT, _RIDGE = np.array([[0, 1, 2], [1, 4, 5], [2, 5, 6]]), np.array([3, 7, 8]), 1e-9 * np.eye(3)


@dataclass(frozen=True)
class Calibration:
    """A plane and how well it is known.

    T_level_sensor: (4, 4) float64, sensor frame to level frame: z up along the road's normal, road at the foot at
    z = 0, x as the sensor's own. error_deg: the tilt is off by less on 95 of 100 streets. refused: empty, or why not to
    use it.
    """

    T_level_sensor: np.ndarray
    height_m: float
    tilt_deg: float  # of the sensor's z axis against the normal
    error_deg: float
    frames: int
    refused: str = ""
    baseline: tuple[float, float, float] | None = None  # the first check of the road: m, slope x, slope y

    @property
    def normal(self) -> np.ndarray:
        """(3,) the road's normal in the sensor frame."""
        return np.asarray(self.T_level_sensor[2, :3])


class Calibrator:
    """Pools frames until there are enough; every call gives the best answer so far."""

    def __init__(self, config: CalibrationConfig) -> None:
        self._config = config
        self._clouds: list[np.ndarray] = []

    @property
    def complete(self) -> bool:
        """True when the configured number of frames has been pooled."""
        return len(self._clouds) >= self._config.frames

    def add(self, points: np.ndarray) -> Calibration:
        """Add a frame, (N, 3+) float32 metres in the sensor frame, and calibrate from all so far."""
        self._clouds.append(near_points(points, self._config))
        return calibrate(np.concatenate(self._clouds), self._config, len(self._clouds))


def near_points(points: np.ndarray, config: CalibrationConfig) -> np.ndarray:
    """(M, 3) float64: finite points within the radius, one per voxel, then those of the widest reach beyond it."""
    xyz = points[:, :3]
    squared_m2 = np.einsum("ij,ij->i", xyz, xyz)
    edges_m2 = 0.25, config.radius_m**2, (REACHES[-1] * config.radius_m) ** 2
    return np.concatenate([_thinned(xyz[(squared_m2 > a) & (squared_m2 < b)]) for a, b in pairwise(edges_m2)])


def _thinned(xyz: np.ndarray) -> np.ndarray:
    """The first point of each voxel, in their order."""
    near = xyz.astype(np.float64)
    _, keep = np.unique(np.floor(near / VOXEL_M).astype(np.int64) @ np.array([1, 4096, 4096**2]), return_index=True)
    return np.asarray(near[np.sort(keep)])


def calibrate(near: np.ndarray, config: CalibrationConfig, frames: int = 1) -> Calibration:
    """The plane in a thinned cloud (M, 3), from a wider circle where the radius has too little road (a tall mast).

    ``refused`` says why it should not be used.
    """
    distance_m = np.linalg.norm(near, axis=1)
    found = _refusal("")
    for reach in REACHES:
        found = _calibrate_within(near, distance_m, reach * config.radius_m, config)
        if not found.refused:
            break
    return replace(found, frames=frames)


def _calibrate_within(
    near: np.ndarray, distance_m: np.ndarray, radius_m: float, config: CalibrationConfig
) -> Calibration:
    """A rough plane of everything within the radius, then the plane of the carriageway."""
    cloud = near[distance_m < radius_m]
    if len(cloud) < MIN_AREA_CELLS:
        return _refusal(f"only {len(cloud)} points within {radius_m:g} m")
    generator = np.random.default_rng(config.seed)
    if len(cloud) > MAX_POINTS:
        cloud = cloud[generator.choice(len(cloud), MAX_POINTS, replace=False)]
    plane = best_hypothesis(cloud, config, generator)
    if isinstance(plane, str):
        return _refusal(plane)
    normal, offset, road = _refit(cloud, *plane, (2.0, 1.0, 0.6, 0.6), config.inlier_m)
    wide = near[distance_m < max(radius_m, REACH_HEIGHTS * offset)]
    lane, loss = _lane(wide, normal, offset)
    if lane is not None and loss < MAX_LOSS:
        cloud = lane
        normal, offset, road = _refit(cloud, normal, offset, LANE_SCALES, config.inlier_m)
        lane, loss = _lane(wide, normal, offset)  # a wide verge can hide the near half of the road from the first look
    doubt_deg = 0.0
    if lane is not None and loss < DOUBTFUL_LOSS:
        other, _, _ = _refit(lane, normal, offset, LANE_SCALES, config.inlier_m)
        doubt_deg = float(np.degrees(np.arccos(np.clip(normal @ other, -1.0, 1.0))))
    return _calibration(cloud[road], normal, offset, doubt_deg, config)


def _lane(wide: np.ndarray, normal: np.ndarray, offset: float) -> tuple[np.ndarray | None, float]:
    """Points of the carriageway at the foot in the sensor frame, None where all ground is road, and the loss."""
    level = wide @ rotation_between(normal, np.array([0.0, 0.0, 1.0])).T + np.array([0.0, 0.0, offset])
    low = np.abs(level[:, 2]) < GROUND_M + GROUND_SLOPE * np.hypot(level[:, 0], level[:, 1])
    lane, loss = find_carriageway(level[low]) if low.any() else (None, 1.0)
    return None if lane is None else wide[low][lane], loss


def _refit(
    near: np.ndarray, normal: np.ndarray, offset: float, scales: tuple[float, ...], band_m: float
) -> tuple[np.ndarray, float, np.ndarray]:
    """Normal and offset at the foot after robust refits, the band scaled in turn, and the mask of road points."""
    road = np.zeros(len(near), bool)
    for scale_m in (scale * band_m for scale in scales):
        rotation = rotation_between(normal, np.array([0.0, 0.0, 1.0]))
        local = near @ rotation.T + np.array([0.0, 0.0, offset])
        coefficients, road = fit_level_surface(local, scale_m)
        slope = np.array([-coefficients[1], -coefficients[2], 1.0])
        unit = slope / np.linalg.norm(slope)
        normal = rotation.T @ unit
        offset = offset - float(coefficients[0]) * unit[2]
    return normal, offset, road


def fit_level_surface(local: np.ndarray, scale_m: float) -> tuple[np.ndarray, np.ndarray]:
    """One reweighted fit z = c0 + c1 x + c2 y about the current plane, Tukey's weight of half width ``scale_m``."""
    x, y, z = np.ascontiguousarray(local.T)
    one, xx, yy = np.ones_like(x), x * x, y * y
    products = np.stack([one, x, y, z, xx, x * y, yy, x * z, y * z])  # a fit needs only their weighted sums
    nearness, misfit = 1.0 / (1.0 + (xx + yy) / NEAR_M**2), np.array([0.0, 0.0, 0.0, 1.0])  # z less the plane
    for _ in range(4):
        weight = misfit / scale_m @ products[:4]
        weight *= weight
        np.subtract(1.0, weight, out=weight)
        np.maximum(weight, 0.0, out=weight)
        weight *= weight
        weight *= nearness
        sums = products @ weight
        misfit[:3] = -np.linalg.solve(sums[_NORMAL] + _RIDGE, sums[_RIGHT])
    return -misfit[:3], np.abs(misfit @ products[:4]) < scale_m


def _calibration(
    road: np.ndarray, normal: np.ndarray, offset: float, doubt_deg: float, config: CalibrationConfig
) -> Calibration:
    """The calibration with its error; refused where the road is too small or the tilt too uncertain."""
    rotation = rotation_between(normal, np.array([0.0, 0.0, 1.0]))
    on_road = road @ rotation.T + np.array([0.0, 0.0, offset])
    distance_m = np.hypot(on_road[:, 0], on_road[:, 1])
    nearness = 1.0 / (1.0 + (distance_m / NEAR_M) ** 2)
    bend_deg = np.degrees(BEND_PER_M * float(nearness @ distance_m / max(float(nearness.sum()), 1e-9)))
    fit_deg = ERROR_FACTOR * _jackknife_deg(on_road, config.inlier_m)
    error_deg = float(np.linalg.norm([fit_deg, bend_deg, doubt_deg]))
    area = len(np.unique(np.floor(on_road[:, :2]).astype(np.int64) @ np.array([1, 4096])))
    refused = ""
    if area < MIN_AREA_CELLS:
        refused = f"only {area} square metres of road near the pole, {MIN_AREA_CELLS} are needed"
    elif error_deg > config.max_error_deg:
        refused = f"tilt is uncertain by {error_deg:.2f} deg, {config.max_error_deg:g} are allowed"
    return Calibration(
        T_level_sensor=transform(rotation, np.array([0.0, 0.0, offset])),
        height_m=offset,
        tilt_deg=float(np.degrees(np.arccos(np.clip(normal[2], -1.0, 1.0)))),
        error_deg=error_deg,
        frames=0,
        refused=refused,
    )


def _jackknife_deg(on_road: np.ndarray, band_m: float) -> float:
    """Standard error of the tilt from fits that each leave out one sector of directions (Efron 1982)."""
    order = np.argsort(np.arctan2(on_road[:, 1], on_road[:, 0]), kind="stable")
    sector = np.empty(len(on_road), int)
    sector[order] = np.arange(len(on_road)) * SECTORS // max(len(on_road), 1)
    slopes = []
    for s in range(SECTORS):
        kept = on_road[sector != s]
        if len(kept) < len(on_road) and len(kept) > 20:
            slopes.append(fit_level_surface(kept, band_m)[0][1:3])
    if len(slopes) < 2:
        return 90.0
    spread = np.var(np.array(slopes), axis=0).sum() * (len(slopes) - 1)
    return float(np.degrees(np.arctan(np.sqrt(spread))))


def _refusal(reason: str) -> Calibration:
    return Calibration(
        T_level_sensor=np.eye(4), height_m=0.0, tilt_deg=0.0, error_deg=90.0, frames=0, refused=reason,
    )  # fmt: skip
