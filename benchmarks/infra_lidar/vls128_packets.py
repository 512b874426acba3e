"""A simulated revolution as the packets a VLS-128 would send: what ``services/infra_lidar/input/velodyne.py`` reads."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.input.velodyne import (
    _DELAY_S,
    _ELEVATION_DEG,
    _OFFSET_DEG,
    CYCLE_US,
    DISTANCE_STEP_M,
    PACKET_BYTES,
    PRODUCT_VLS128,
)
from spotter_sim.lidar128 import RINGS, Scan

FIRINGS = 3  # firing sequences of all lasers in a packet
LOWEST_DEG, SPAN_DEG = -25.0, 40.0  # elevations of the simulated sensor, evenly spread
STRONGEST = 0x37
SAME_SURFACE = 0.1  # two ranges that differ by less are of one surface


def revolution_packets(scan: Scan, columns: int) -> np.ndarray:
    """(P, 1206) uint8: the packets of a revolution of ``columns`` (a multiple of three) firing sequences, clockwise.

    The lasers of a VLS-128 look elsewhere than the simulated ones: between two simulated ranges of one surface the
    inverse range is interpolated (exact on a plane), elsewhere the nearer beam counts. Time stamps are left 0.
    """
    head_deg = np.arange(columns) * 360.0 / columns
    turned_deg = 360.0 / (columns * CYCLE_US * 1e-6) * _DELAY_S - _OFFSET_DEG
    column = np.round(-(head_deg[:, None] + turned_deg) / 360.0 * columns).astype(int) % columns
    steps = _ranges(_image(scan, columns), column) / DISTANCE_STEP_M
    raw = np.zeros((columns // FIRINGS, PACKET_BYTES), np.uint8)
    blocks = raw[:, :1200].reshape(-1, FIRINGS, 4, 100)
    blocks[..., 0], blocks[..., 1] = 0xFF, [0xEE, 0xDD, 0xCC, 0xBB]
    azimuth = np.round(head_deg * 100.0).astype("<u2").reshape(-1, FIRINGS, 1)
    blocks[..., 2], blocks[..., 3] = azimuth & 255, azimuth >> 8
    returns = blocks[..., 4:].reshape(-1, FIRINGS, 4, 32, 3)
    distance = np.round(steps).astype(np.uint16).reshape(returns.shape[:-1])
    returns[..., 0], returns[..., 1], returns[..., 2] = distance & 255, distance >> 8, 50
    raw[:, 1204], raw[:, 1205] = STRONGEST, PRODUCT_VLS128
    return raw


def _image(scan: Scan, columns: int) -> np.ndarray:
    """(columns, RINGS) ranges in metres by direction, counter-clockwise from x; 0 = no return."""
    direction = np.arctan2(scan.xyz[:, 1], scan.xyz[:, 0]) / (2 * np.pi) * columns
    image = np.zeros((columns, RINGS))
    image[np.round(direction).astype(int) % columns, scan.ring] = np.linalg.norm(scan.xyz, axis=1)
    return image


def _ranges(image: np.ndarray, column: np.ndarray) -> np.ndarray:
    """(columns, 128) ranges in the directions of the lasers."""
    beam = (_ELEVATION_DEG - LOWEST_DEG) / SPAN_DEG * (RINGS - 1)
    lower = np.minimum(beam.astype(int), RINGS - 2)
    share = beam - lower
    below, above = image[column, lower], image[column, lower + 1]
    same = (below > 0) & (above > 0) & (np.abs(below - above) < SAME_SURFACE * np.minimum(below, above))
    safe_below, safe_above = np.where(same, below, 1.0), np.where(same, above, 1.0)
    between = 1.0 / ((1.0 - share) / safe_below + share / safe_above)
    return np.asarray(np.where(same, between, np.where(share < 0.5, below, above)))
