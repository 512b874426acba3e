"""Cells over threshold -> one detection per body, with sub-bin range and velocity.

A walker's limbs spread over many Doppler cells and a near body over several range cells: the strongest peak stands for
the body and takes the weaker peaks around it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from services.radar_pi.cfar import Hits
from services.radar_pi.config import DetectionConfig

_BESIDE = np.array([-1, 0, 1])


@dataclass(frozen=True)
class Peaks:
    """Local maxima over threshold, strongest first; arrays of equal length."""

    row: np.ndarray
    column: np.ndarray
    row_exact: np.ndarray  # with sub-bin part
    column_exact: np.ndarray
    power_db: np.ndarray
    snr_db: np.ndarray

    def take(self, keep: np.ndarray) -> Peaks:
        """Those where ``keep`` (N,) bool says so."""
        return Peaks(*(getattr(self, field.name)[keep] for field in fields(self)))


@dataclass(frozen=True)
class Echo:
    """A body's strongest peak, all of the same place: a detection takes its range from the nearest part."""

    range_m: float
    velocity_mps: float
    elevation_rad: float | None = None  # None = not to tell


@dataclass(frozen=True)
class Detection:
    """One body in one frame."""

    range_m: float
    velocity_mps: float  # closing is negative
    azimuth_rad: float | None
    snr_db: float
    strongest: Echo | None = None


class Measured(NamedTuple):
    """What was measured of each peak, (N,) each; NaN = not to tell."""

    range_m: np.ndarray
    velocity_mps: np.ndarray
    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray


def find_peaks(power: np.ndarray, hits: Hits, first_row: int, limit: int) -> Peaks:
    """Local maxima among the hits of an (R, D) map, at most ``limit``.

    Rows before ``first_row`` are not looked at, but for the interpolation of a peak beside them.
    """
    rows, columns = power.shape
    row = np.minimum(np.maximum(hits.row + _BESIDE[:, None], 0), rows - 1)
    column = (hits.column + _BESIDE[:, None]) % columns
    around = power[row[:, None], column]  # (3, 3, hits)
    rivals = np.where((row < first_row)[:, None], 0.0, around).max(axis=(0, 1))
    here = around[1, 1]
    keep = np.flatnonzero(here >= rivals)
    keep = keep[np.argsort(-here[keep], kind="stable")][:limit]
    row, column = hits.row[keep], hits.column[keep]
    around_db = 10 * np.log10(np.maximum(around.reshape(9, -1)[:, keep], 1e-30))
    top_db = around_db[4]
    part = _vertex(around_db[1:4:2], top_db, around_db[7:4:-2])  # 1, 4, 7 lie along range; 3, 4, 5 along Doppler
    inner = (row > 0) & (row < rows - 1)
    return Peaks(
        row,
        column,
        row + inner * part[0],
        column + part[1],
        top_db,
        top_db - 10 * np.log10(np.maximum(hits.noise[keep], 1e-30)),
    )


def group(peaks: Peaks, measured: Measured, v_max_mps: float, config: DetectionConfig) -> list[Detection]:
    """One detection per body, nearest first; ``measured`` holds each peak's values, strongest first.

    Velocity and direction are those of the strongest peak (the trunk), range is that of the nearest strong part: when
    a foot touches a low radar, the trunk is still a metre away. Moving peaks choose first: a moving body takes what
    stands near it, but what stands (clutter that the body shadows, for example) never takes a moving body.
    """
    range_m, velocity_mps, azimuth_rad, elevation_rad = measured
    known_rad = np.where(np.isnan(azimuth_rad), 0.0, azimuth_rad)
    moving = np.abs(velocity_mps) >= config.moving_mps
    free = np.argsort(~moving, kind="stable")  # what belongs to no body yet: the moving ones, then the others
    bodies: list[Detection] = []
    while free.size and len(bodies) < config.max_detections:
        i, others = free[0], free[1:]
        apart_mps = np.abs(velocity_mps[others] - velocity_mps[i])
        below_db = peaks.power_db[i] - peaks.power_db[others]
        body = (
            (np.abs(range_m[others] - range_m[i]) <= config.body_range_m)
            & (np.minimum(apart_mps, 2 * v_max_mps - apart_mps) <= config.body_velocity_mps)
            & (np.abs(known_rad[others] - known_rad[i]) <= config.body_azimuth_rad)
        )
        part = others[body & (moving[others] == moving[i]) & (below_db <= config.part_db)]
        nearest_m = min(float(range_m[i]), float(range_m[part].min(initial=np.inf)))
        strongest = Echo(float(range_m[i]), float(velocity_mps[i]), _known(elevation_rad[i]))
        bodies.append(
            Detection(nearest_m, strongest.velocity_mps, _known(azimuth_rad[i]), float(peaks.snr_db[i]), strongest)
        )
        beside = (
            np.minimum(np.abs(peaks.row[others] - peaks.row[i]), np.abs(peaks.column[others] - peaks.column[i])) <= 1
        )
        free = others[~(body | (beside & (below_db > config.sidelobe_db)))]
    return _join_long(bodies, config)


def _known(angle_rad: float) -> float | None:
    return None if np.isnan(angle_rad) else float(angle_rad)


def _join_long(bodies: list[Detection], config: DetectionConfig) -> list[Detection]:
    """A vehicle reflects at several places along its length: same velocity and direction, one behind the other.

    The nearest stands for all, because the nearest is what one collides with.
    """
    joined: list[Detection] = []
    for body in sorted(bodies, key=lambda b: b.range_m):
        if not any(_is_behind(body, nearer, config) for nearer in joined):
            joined.append(body)
    return joined


def _is_behind(body: Detection, nearer: Detection, config: DetectionConfig) -> bool:
    turned_rad = abs((body.azimuth_rad or 0.0) - (nearer.azimuth_rad or 0.0))
    return (
        abs(body.velocity_mps) >= config.moving_mps
        and body.range_m - nearer.range_m <= config.vehicle_length_m
        and abs(body.velocity_mps - nearer.velocity_mps) <= config.vehicle_velocity_mps
        and turned_rad <= config.vehicle_azimuth_rad
    )


def _vertex(before_db: np.ndarray, top_db: np.ndarray, after_db: np.ndarray) -> np.ndarray:
    """Offset of the top of a parabola through three levels in dB, within half a bin either way."""
    curvature = np.minimum(before_db - 2 * top_db + after_db, -1e-9)
    return np.minimum(np.maximum(0.5 * (before_db - after_db) / curvature, -0.5), 0.5)
