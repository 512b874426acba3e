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
    around = power[np.array([[up], [hits.row], [down]]), np.array([left, hits.column, right])]
    keep = np.flatnonzero(here >= around.max(axis=(0, 1)))
    keep = keep[np.argsort(-here[keep], kind="stable")][:limit]
    row, column, left, right = hits.row[keep], hits.column[keep], left[keep], right[keep]
    before, after = np.maximum(row - 1, 0), np.minimum(row + 1, rows - 1)
    cells = np.array([power[before, column], power[row, left], here[keep], power[after, column], power[row, right]])
    nearer, slower, top, farther, faster = 10 * np.log10(np.maximum(cells, 1e-30))
    inner = (row > 0) & (row < rows - 1)
    return Peaks(
        row,
        column,
        row + np.where(inner, _vertex(nearer, top, farther), 0.0),
        column + _vertex(slower, top, faster),
        top,
        top - 10 * np.log10(hits.noise[keep]),
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
    known_rad = np.where(np.isnan(azimuth_rad), 0.0, azimuth_rad)
    moving = np.abs(velocity_mps) >= config.moving_mps
    bodies: list[Detection] = []
    for i in np.concatenate([np.flatnonzero(moving), np.flatnonzero(~moving)]):
        if not free[i] or len(bodies) == config.max_detections:
            continue
        apart_mps = np.abs(velocity_mps - velocity_mps[i])
        body = (
            (np.abs(range_m - range_m[i]) <= config.body_range_m)
            & (np.minimum(apart_mps, 2 * v_max_mps - apart_mps) <= config.body_velocity_mps)
            & (np.abs(known_rad - known_rad[i]) <= config.body_azimuth_rad)
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


def _vertex(before_db: np.ndarray, top_db: np.ndarray, after_db: np.ndarray) -> np.ndarray:
    """Offset of the top of a parabola through three levels in dB, within half a bin either way."""
    curvature = np.minimum(before_db - 2 * top_db + after_db, -1e-9)
    return np.clip(0.5 * (before_db - after_db) / curvature, -0.5, 0.5)
