"""Cells over threshold -> one detection per body, with sub-bin range and velocity.

A walker's limbs spread over many Doppler cells and a near body over several range cells: the strongest peak stands for
the body and takes the weaker peaks around it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.radar_pi.cfar import Hits
from services.radar_pi.config import DetectionConfig


@dataclass(frozen=True)
class Peaks:
    """Local maxima over threshold, strongest first; arrays of equal length."""

    row: np.ndarray
    column: np.ndarray
    row_exact: np.ndarray  # with sub-bin part
    column_exact: np.ndarray
    power_db: np.ndarray
    snr_db: np.ndarray


@dataclass(frozen=True)
class Detection:
    """One body in one frame."""

    range_m: float
    velocity_mps: float  # closing is negative
    azimuth_rad: float | None
    snr_db: float


def find_peaks(power: np.ndarray, hits: Hits, first_row: int, limit: int) -> Peaks:
    """Local maxima among the hits of an (R, D) map, at most ``limit``.

    Rows before ``first_row`` are not looked at, but for the interpolation of a peak beside them.
    """
    rows, columns = power.shape
    up, down = np.maximum(hits.row - 1, first_row), np.minimum(hits.row + 1, rows - 1)
    left, right = (hits.column - 1) % columns, (hits.column + 1) % columns
    here = power[hits.row, hits.column]
    around = power[np.stack([up, hits.row, down])[:, None], np.stack([left, hits.column, right])[None, :]]
    top = here >= around.max(axis=(0, 1))
    keep = np.flatnonzero(top)
    keep = keep[np.argsort(-here[keep], kind="stable")][:limit]
    row, column, here = hits.row[keep], hits.column[keep], here[keep]
    inner = (row > 0) & (row < rows - 1)
    before, after = power[np.maximum(row - 1, 0), column], power[down[keep], column]
    return Peaks(
        row,
        column,
        row + np.where(inner, _vertex(before, here, after), 0.0),
        column + _vertex(power[row, left[keep]], here, power[row, right[keep]]),
        10 * np.log10(here),
        10 * np.log10(here / hits.noise[keep]),
    )


def group(
    peaks: Peaks,
    range_m: np.ndarray,
    velocity_mps: np.ndarray,
    azimuth_rad: np.ndarray,
    v_max_mps: float,
    config: DetectionConfig,
) -> list[Detection]:
    """One detection per body, nearest first; the arrays hold each peak's measured values, strongest first.

    Velocity and direction are those of the strongest peak (the trunk), range is that of the nearest strong part: when
    a foot touches a low radar, the trunk is still a metre away. Moving peaks choose first: a moving body takes what
    stands near it, but what stands (clutter that the body shadows, for example) never takes a moving body.
    """
    free = np.ones(len(range_m), bool)
    moving = np.abs(velocity_mps) >= config.moving_mps
    bodies: list[Detection] = []
    for i in np.concatenate([np.flatnonzero(moving), np.flatnonzero(~moving)]):
        if not free[i] or len(bodies) == config.max_detections:
            continue
        apart_mps = np.abs(velocity_mps - velocity_mps[i])
        body = (
            (np.abs(range_m - range_m[i]) <= config.body_range_m)
            & (np.minimum(apart_mps, 2 * v_max_mps - apart_mps) <= config.body_velocity_mps)
            & (np.nan_to_num(np.abs(azimuth_rad - azimuth_rad[i])) <= config.body_azimuth_rad)
        )
        part = body & free & (moving == moving[i]) & (peaks.power_db >= peaks.power_db[i] - config.part_db)
        azimuth = None if np.isnan(azimuth_rad[i]) else float(azimuth_rad[i])
        bodies.append(Detection(float(range_m[part].min()), float(velocity_mps[i]), azimuth, float(peaks.snr_db[i])))
        beside = (np.abs(peaks.row - peaks.row[i]) <= 1) | (np.abs(peaks.column - peaks.column[i]) <= 1)
        free &= ~(body | (beside & (peaks.power_db < peaks.power_db[i] - config.sidelobe_db)))
    return _join_long(bodies, config)


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


def _vertex(before: np.ndarray, top: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Offset of the top of a parabola through three log powers, within half a bin either way."""
    a, b, c = (np.log(np.maximum(value, 1e-30)) for value in (before, top, after))
    curvature = a - 2 * b + c
    offset = 0.5 * (a - c) / np.where(curvature < 0, curvature, -1.0)
    return np.clip(np.where(curvature < 0, offset, 0.0), -0.5, 0.5)
