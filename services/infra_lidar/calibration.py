"""Where the road is: the plane at the foot of the pole, from the first frames (RANSAC, then a robust refit).

Method: hypotheses through three points each (Fischler and Bolles 1981), drawn with a fixed seed from a cloud thinned to
one point per voxel, so that a facade beside the pole has no more say than its area. A hypothesis needs a normal within
the mounting cone; it is scored by the points near it minus those below it, because nothing lies under a road. The best
one is refitted by iteratively reweighted least squares (Tukey's weight) with a slowly curved surface, whose tangent at
the foot is the answer. The error is estimated by leaving out one direction after another (jackknife over sectors).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.geometry import rotation_between, rotation_rpy, transform
from services.infra_lidar.config import CalibrationConfig

VOXEL_M = 0.25
MAX_POINTS = 6000
SCORED_POINTS = 2000  # enough to choose a hypothesis; the refit takes all
BELOW_COST = 3.0  # how much a point under the plane counts against one on it
SECTORS = 8
MIN_AREA_CELLS = 60  # square metres of road, at least
# Where the sums of 1, x, y, z, xx, xy, yy, xz, yz stand in the normal equations of a plane
_NORMAL, _RIGHT, _RIDGE = np.array([[0, 1, 2], [1, 4, 5], [2, 5, 6]]), np.array([3, 7, 8]), 1e-9 * np.eye(3)


@dataclass(frozen=True)
class Calibration:
    """A plane and how well it is known.

    T_level_sensor: (4, 4) float64, sensor frame to level frame: z up along the road's normal, road at the foot at
    z = 0, x as the sensor's own. error_deg: one standard deviation of the tilt. refused: empty, or why not to use it.
    """

    T_level_sensor: np.ndarray
    height_m: float
    tilt_deg: float  # of the sensor's z axis against the normal
    error_deg: float
    residual_m: float  # median distance of the road's points
    road_points: int
    frames: int
    refused: str = ""
    baseline: tuple[float, float, float] | None = None  # what the nudge watch measured right after: m, slope x, slope y

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
    """(M, 3) float64: finite points within the radius, one per voxel."""
    xyz = points[:, :3]
    squared_m2 = np.einsum("ij,ij->i", xyz, xyz)
    near = xyz[(squared_m2 < config.radius_m**2) & (squared_m2 > 0.25)].astype(np.float64)
    _, keep = np.unique(np.floor(near / VOXEL_M).astype(np.int64) @ np.array([1, 4096, 4096**2]), return_index=True)
    return np.asarray(near[np.sort(keep)])


def calibrate(near: np.ndarray, config: CalibrationConfig, frames: int = 1) -> Calibration:
    """The plane in a thinned cloud (M, 3); ``refused`` says why when it should not be used."""
    if len(near) < MIN_AREA_CELLS:
        return _refusal(f"only {len(near)} points within {config.radius_m:g} m")
    generator = np.random.default_rng(config.seed)
    if len(near) > MAX_POINTS:
        near = near[generator.choice(len(near), MAX_POINTS, replace=False)]
    plane = _best_hypothesis(near, config, generator)
    if plane is None:
        return _refusal("no plane within the mounting cone")
    normal, offset, road = _refit(near, *plane, config.inlier_m)
    return _judge(near, road, normal, offset, config, frames)


def _best_hypothesis(
    near: np.ndarray, config: CalibrationConfig, generator: np.random.Generator
) -> tuple[np.ndarray, float] | None:
    """(normal, offset) with normal . p + offset = 0 on the road, or None."""
    prior = rotation_rpy(np.radians(config.prior_roll_deg), np.radians(config.prior_pitch_deg), 0.0).T[:, 2]
    a, b, c = near[generator.integers(0, len(near), (3, config.hypotheses))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 0.5  # a sliver of a triangle says nothing
    normals, a = normals[usable] / lengths[usable, None], a[usable]
    normals *= np.sign(normals @ prior)[:, None]
    offsets = -np.einsum("ij,ij->i", normals, a)
    fits = (normals @ prior >= np.cos(np.radians(config.max_tilt_deg))) & (
        (offsets >= config.height_min_m) & (offsets <= config.height_max_m)
    )
    if not fits.any():
        return None
    normals, offsets = normals[fits], offsets[fits]
    judges = near[:: max(1, len(near) // SCORED_POINTS)]
    weight = 1.0 / (1.0 + np.einsum("ij,ij->i", judges, judges) / 10.0**2)
    scores = np.empty(len(normals))
    for start in range(0, len(normals), 128):  # blocks that stay in cache
        block = slice(start, start + 128)
        height = normals[block] @ judges.T + offsets[block, None]
        on = np.abs(height) < config.inlier_m
        under = height < -3.0 * config.inlier_m
        scores[block] = on @ weight - BELOW_COST * (under @ weight)
    best = int(np.argmax(scores))
    return normals[best], float(offsets[best])


def _refit(near: np.ndarray, normal: np.ndarray, offset: float, band_m: float) -> tuple[np.ndarray, float, np.ndarray]:
    """Normal and offset at the foot after robust refits, and the mask of road points."""
    road = np.zeros(len(near), bool)
    for scale_m in (2.0 * band_m, band_m, 0.6 * band_m, 0.6 * band_m):
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
    products = np.stack([one, x, y, z, xx, x * y, yy, x * z, y * z])  # their weighted sums are all that a fit needs
    nearness, misfit = 1.0 / (1.0 + (xx + yy) / 8.0**2), np.array([0.0, 0.0, 0.0, 1.0])  # z less the plane
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


def _judge(
    near: np.ndarray, road: np.ndarray, normal: np.ndarray, offset: float, config: CalibrationConfig, frames: int
) -> Calibration:
    """Put the answer together with its error, and refuse it where it cannot be trusted."""
    rotation = rotation_between(normal, np.array([0.0, 0.0, 1.0]))
    local = near @ rotation.T + np.array([0.0, 0.0, offset])
    on_road = local[road]
    error_deg = _jackknife_deg(on_road, config.inlier_m)
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
        residual_m=float(np.median(np.abs(on_road[:, 2]))) if len(on_road) else 0.0,
        road_points=len(on_road),
        frames=frames,
        refused=refused,
    )


def _jackknife_deg(on_road: np.ndarray, band_m: float) -> float:
    """Standard error of the tilt from fits that each leave out one sector of directions (Efron 1982)."""
    sector = ((np.arctan2(on_road[:, 1], on_road[:, 0]) / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
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
        T_level_sensor=np.eye(4), height_m=0.0, tilt_deg=0.0, error_deg=90.0, residual_m=0.0, road_points=0, frames=0,
        refused=reason,
    )  # fmt: skip
