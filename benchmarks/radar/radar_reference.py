"""The radar's steps once more, as one would write them first: numpy, double precision, a loop over the cells.

Slow and easy to check by eye. The tests hold the fast steps against it; the benchmark divides by its time.
"""

from __future__ import annotations

import numpy as np

from services.radar_pi.cfar import MIN_TRAINING
from services.radar_pi.cfar_design import os_mean_ratio
from services.radar_pi.config import CfarConfig
from services.radar_pi.noise import QUANTILE


def hann(length: int) -> np.ndarray:
    """Periodic Hann window of unit energy, (length,) float64."""
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    return window / np.sqrt(np.sum(window**2))


def range_profiles(frame: np.ndarray, bins: int) -> np.ndarray:
    """(rx, chirp, sample) -> (rx, chirp, bin) complex128."""
    signal = frame.astype(float)
    signal = signal - signal.mean(axis=2, keepdims=True)
    return np.fft.fft(signal * hann(frame.shape[2]), axis=2)[:, :, :bins]


def remove_background(profiles: np.ndarray, background: np.ndarray, memory: float) -> tuple[np.ndarray, np.ndarray]:
    """(moving profiles, new background); the background is (rx, bin)."""
    moving = profiles - background[:, None, :]
    return moving, memory * background + (1 - memory) * profiles.mean(axis=1)


def power_map(moving: np.ndarray) -> np.ndarray:
    """(rx, chirp, bin) -> (bin, doppler), the mean power over the receivers."""
    spectrum = np.fft.fftshift(np.fft.fft(moving * hann(moving.shape[1])[:, None], axis=1), axes=1)
    return (np.abs(spectrum) ** 2).mean(axis=0).T


def training_cells(map_: np.ndarray, row: int, column: int, config: CfarConfig) -> np.ndarray:
    """The training cells of one cell of a map: range ends, Doppler goes round."""
    reach = (config.guard_range + config.train_range, config.guard_doppler + config.train_doppler)
    d_row = np.arange(-reach[0], reach[0] + 1)
    d_column = np.arange(-reach[1], reach[1] + 1)
    d_row = d_row[(row + d_row >= 0) & (row + d_row < len(map_))]
    block = map_[row + d_row][:, (column + d_column) % map_.shape[1]]
    guard = np.outer(np.abs(d_row) <= config.guard_range, np.abs(d_column) <= config.guard_doppler)
    return block[~guard]


def cfar_hits(power: np.ndarray, config: CfarConfig, looks: int) -> list[tuple[int, int]]:
    """Cells above the threshold over the mean of their training cells, without those far above their row's level."""
    rows, columns = power.shape
    rank = max(1, round(QUANTILE * columns))
    levels = [np.sort(row)[rank - 1] / os_mean_ratio(rank, columns, looks) for row in power]
    limits = np.repeat(np.array(levels)[:, None], columns, axis=1) * 10 ** (config.excise_db / 10)
    hits = []
    for row in range(rows):
        for column in range(columns):
            cells = training_cells(power, row, column, config)
            if config.excise_db:
                left = cells[cells <= training_cells(limits, row, column, config)]
                noise = left.mean() if len(left) > MIN_TRAINING * len(cells) else limits[row, column]
            else:
                noise = cells.mean()
            if power[row, column] > 10 ** (config.threshold_db / 10) * noise:
                hits.append((row, column))
    return hits


def os_hits(power: np.ndarray, config: CfarConfig, looks: int) -> list[tuple[int, int]]:
    """Cells above the threshold over the noise that the ordered statistic of their training cells stands for."""
    hits = []
    for row, column in np.ndindex(*power.shape):
        cells = np.sort(training_cells(power, row, column, config))
        rank = max(1, round(config.os_fraction * len(cells)))
        noise = cells[rank - 1] / os_mean_ratio(rank, len(cells), looks)
        if power[row, column] > 10 ** (config.threshold_db / 10) * noise:
            hits.append((row, column))
    return hits
