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


def find_peaks(power: np.ndarray, hits: Hits, limit: int) -> Peaks:
    """Local maxima among the hits of an (R, D) map, at most ``limit``."""
    rows, columns = power.shape
    up, down = np.maximum(hits.row - 1, 0), np.minimum(hits.row + 1, rows - 1)
    left, right = (hits.column - 1) % columns, (hits.column + 1) % columns
    here = power[hits.row, hits.column]
    top = np.ones(len(here), bool)
    for row in (up, hits.row, down):
        for column in (left, hits.column, right):
            top &= here >= power[row, column]
    keep = np.flatnonzero(top)
    keep = keep[np.argsort(-here[keep], kind="stable")][:limit]
    row, column = hits.row[keep], hits.column[keep]
    inner = (row > 0) & (row < rows - 1)
    return Peaks(
        row,
        column,
        row + np.where(inner, _vertex(power[up[keep], column], here[keep], power[down[keep], column]), 0.0),
        column + _vertex(power[row, left[keep]], here[keep], power[row, right[keep]]),
        10 * np.log10(here[keep]),
        10 * np.log10(here[keep] / hits.noise[keep]),
    )


def group(
    peaks: Peaks,
    range_m: np.ndarray,
    velocity_mps: np.ndarray,
    azimuth_rad: np.ndarray,
    v_max_mps: float,
    config: DetectionConfig,
) -> list[Detection]:
    """One detection per body, strongest first; the arrays hold each peak's measured values."""
    free = np.ones(len(range_m), bool)
    bodies: list[Detection] = []
    for i in range(len(range_m)):
        if not free[i]:
            continue
        azimuth = float(azimuth_rad[i])
        bodies.append(
            Detection(
                float(range_m[i]),
                float(velocity_mps[i]),
                None if np.isnan(azimuth) else azimuth,
                float(peaks.snr_db[i]),
            )
        )
        if len(bodies) == config.max_detections:
            break
        apart_m = np.abs(range_m - range_m[i])
        apart_mps = np.abs(velocity_mps - velocity_mps[i])
        apart_mps = np.minimum(apart_mps, 2 * v_max_mps - apart_mps)
        apart_rad = np.nan_to_num(np.abs(azimuth_rad - azimuth))
        body = (
            (apart_m <= config.body_range_m)
            & (apart_mps <= config.body_velocity_mps)
            & (apart_rad <= config.body_azimuth_rad)
        )
        beside = (np.abs(peaks.row - peaks.row[i]) <= 1) | (np.abs(peaks.column - peaks.column[i]) <= 1)
        sidelobe = beside & (peaks.power_db < peaks.power_db[i] - config.sidelobe_db)
        free &= ~(body | sidelobe)
    return bodies


def _vertex(before: np.ndarray, top: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Offset of the top of a parabola through three log powers, within half a bin either way."""
    a, b, c = (np.log(np.maximum(value, 1e-30)) for value in (before, top, after))
    curvature = a - 2 * b + c
    offset = 0.5 * (a - c) / np.where(curvature < 0, curvature, -1.0)
    return np.clip(np.where(curvature < 0, offset, 0.0), -0.5, 0.5)
