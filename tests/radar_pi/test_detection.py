"""Peaks, sub-bin interpolation, one detection per body, azimuth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.radar_pi.azimuth import PairAzimuth
from services.radar_pi.cfar import Hits
from services.radar_pi.config import AzimuthConfig, DetectionConfig
from services.radar_pi.detection import Detection, Measured, Peaks, find_peaks, group
from services.radar_pi.spectrum import unit_window

CONFIG = DetectionConfig()
V_MAX_MPS = 5.0


def all_over(power: np.ndarray, threshold: float) -> Hits:
    row, column = np.nonzero(power > threshold)
    return Hits(row, column, np.ones(len(row)))


def hann_map(row: float, column: float, rows: int = 30, columns: int = 32) -> np.ndarray:
    """Power of a tone at a fractional cell, Hann in both directions."""

    def response(position: float, length: int) -> np.ndarray:
        tone = np.exp(2j * np.pi * position * np.arange(64) / 64)
        return np.abs(np.fft.fft(tone * unit_window("hann", 64))[:length]) ** 2

    return np.outer(response(row, rows), response(column, columns)).astype(np.float32)


@given(st.floats(5.0, 25.0), st.floats(5.0, 25.0))
def test_interpolation_finds_the_fractional_cell(row: float, column: float) -> None:
    power = hann_map(row, column)
    peaks = find_peaks(power, all_over(power, 0.1 * power.max()), 0, 10)
    assert peaks.row_exact[0] == pytest.approx(row, abs=0.04)
    assert peaks.column_exact[0] == pytest.approx(column, abs=0.04)


def test_a_peak_on_the_doppler_edge_goes_round() -> None:
    power = np.ones((10, 8), np.float32)
    power[5, 0], power[5, 7], power[5, 1] = 100.0, 60.0, 20.0
    peaks = find_peaks(power, all_over(power, 50.0), 0, 10)
    assert peaks.column.tolist() == [0]
    assert -0.5 < peaks.column_exact[0] < 0.0


def test_a_peak_at_the_first_row_may_lean_out_of_it() -> None:
    power = np.ones((10, 8), np.float32)
    power[1, 4], power[2, 4], power[3, 4] = 90.0, 100.0, 10.0
    peaks = find_peaks(power, all_over(power[2:], 50.0).shifted(2), 2, 10)
    assert peaks.row.tolist() == [2]
    assert 1.5 <= peaks.row_exact[0] < 2.0


def test_only_the_strongest_peaks_are_kept() -> None:
    power = np.ones((20, 16), np.float32)
    power[2, 2], power[9, 9], power[15, 3] = 50.0, 70.0, 60.0
    assert find_peaks(power, all_over(power, 10.0), 0, 2).row.tolist() == [9, 15]


def peaks_at(values: list[tuple[float, float, float]], azimuth_rad: float = 0.0) -> list[Detection]:
    """Group peaks given as (range, velocity, dB), strongest first."""
    ordered = sorted(values, key=lambda value: -value[2])
    range_m, velocity_mps, power_db = (np.array(column) for column in zip(*ordered, strict=True))
    rows, columns = np.round(range_m / 0.1).astype(int), np.round(velocity_mps / 0.16).astype(int)
    peaks = Peaks(rows, columns, rows.astype(float), columns.astype(float), power_db, power_db)
    unknown = np.full(len(range_m), np.nan)
    measured = Measured(range_m, velocity_mps, np.full(len(range_m), azimuth_rad), unknown)
    return group(peaks, measured, V_MAX_MPS, CONFIG)


def test_trunk_and_limbs_are_one_body() -> None:
    bodies = peaks_at([(2.0, -1.4, 40), (2.2, -2.6, 25), (1.8, -0.3, 22), (2.1, 0.0, 20)])
    assert [(b.range_m, b.velocity_mps) for b in bodies] == [(2.0, -1.4)]


def test_what_stands_never_takes_what_moves() -> None:
    bodies = peaks_at([(0.6, 0.0, 50), (0.5, -0.9, 30)])
    assert [b.velocity_mps for b in bodies] == [-0.9]


def test_two_people_apart_are_two_bodies() -> None:
    assert len(peaks_at([(2.0, -1.4, 40), (3.5, 1.0, 38)])) == 2


def test_front_and_rear_of_a_car_are_one_and_the_nearest_counts() -> None:
    bodies = peaks_at([(2.0, -1.5, 40), (3.3, -1.45, 50), (4.6, -1.5, 35)])
    assert [b.range_m for b in bodies] == [2.0]


def test_sidelobes_of_a_strong_body_are_dropped_and_a_weak_body_elsewhere_is_not() -> None:
    assert len(peaks_at([(2.0, -1.4, 80), (4.0, -1.4, 30)])) == 1
    assert len(peaks_at([(2.0, -1.4, 80), (4.0, 2.0, 30)])) == 2


def test_velocity_distance_goes_round() -> None:
    assert len(peaks_at([(2.0, -4.9, 40), (2.1, 4.9, 30)])) == 1


def test_unknown_azimuth_is_none() -> None:
    assert peaks_at([(2.0, -1.4, 40)], azimuth_rad=np.nan)[0].azimuth_rad is None


@given(st.floats(-1.2, 1.2), st.floats(0.0, 6.28), st.floats(-0.5, 0.5))
def test_azimuth_from_the_phase_difference(azimuth: float, phase: float, offset: float) -> None:
    """The beat phase grows with the path: a target on the left is farther from the right receiver."""
    wavelength_m, spacing_m = 4.94e-3, 2.5e-3
    lag = 2 * np.pi * spacing_m / wavelength_m * np.sin(azimuth)
    if abs(lag) > 3.1:
        return
    pair = PairAzimuth(AzimuthConfig(phase_offset_rad=offset), (1, 2, 3), wavelength_m)
    spectrum = np.zeros((3, 8, 4), np.complex64)
    spectrum[:, 5, 2] = np.exp(1j * phase) * np.array([1.0, 1.0, np.exp(1j * (lag + offset))])
    assert pair.measure(spectrum, np.array([2]), np.array([5]))[0] == pytest.approx(azimuth, abs=0.02)


def test_without_the_pair_there_is_no_azimuth() -> None:
    pair = PairAzimuth(AzimuthConfig(), (2, 3), 5e-3)
    assert not pair.available
    assert np.isnan(pair.measure(np.zeros((2, 8, 4), np.complex64), np.array([1, 2]), np.array([0, 1]))).all()
