"""The two transforms: against plain numpy, on tones with known bins, on noise of known power."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.radar.radar_reference import hann, power_map, range_profiles, remove_background
from services.radar_pi.clutter import Clutter
from services.radar_pi.config import WaveformConfig
from services.radar_pi.spectrum import RangeDoppler, mean_power, unit_window


def small(chirps: int = 16, samples: int = 32, rx_mask: int = 7) -> WaveformConfig:
    return WaveformConfig(chirps=chirps, samples=samples, rx_mask=rx_mask)


def tone(row: float, doppler: float, chirps: int, samples: int) -> np.ndarray:
    """(1, chirp, sample): ``row`` beats in the sampled time, ``doppler`` turns of phase over the frame."""
    slow, fast = doppler * np.arange(chirps) / chirps, row * np.arange(samples) / samples
    return np.cos(2 * np.pi * (slow[:, None] + fast[None, :]))[None]


@pytest.mark.parametrize(("chirps", "samples"), [(16, 32), (15, 48), (64, 128)])
def test_agrees_with_plain_numpy(chirps: int, samples: int) -> None:
    waveform = small(chirps, samples)
    frame = np.random.default_rng(1).integers(0, 4096, (3, chirps, samples)).astype(np.uint16)
    transform = RangeDoppler(waveform, "hann", samples // 2)
    profiles = transform.profiles(frame)
    plain = range_profiles(frame, samples // 2)
    assert profiles.dtype == np.complex64
    assert np.allclose(profiles, plain, atol=1e-3 * np.abs(plain).max())
    clutter = Clutter(0.92, 15)
    clutter.remove(profiles)
    moving = clutter.remove(profiles * np.float32(0.5))
    plain_moving, _ = remove_background(plain * 0.5, plain.mean(axis=1), 0.92)
    power = mean_power(transform.doppler(moving))
    assert power.shape == (samples // 2, chirps)
    assert np.allclose(power, power_map(plain_moving), rtol=1e-3, atol=1e-4 * power.max())


@pytest.mark.parametrize("chirps", [16, 15])
@pytest.mark.parametrize(("row", "doppler"), [(5, -4), (9, 0), (12, 6)])
def test_a_tone_is_where_it_belongs(chirps: int, row: int, doppler: int) -> None:
    transform = RangeDoppler(small(chirps, 32, rx_mask=1), "hann", 16)
    power = mean_power(transform.doppler(transform.profiles(tone(row, doppler, chirps, 32))))
    assert np.unravel_index(power.argmax(), power.shape) == (row, chirps // 2 + doppler)


def test_a_closing_target_lies_below_the_middle() -> None:
    """Path gets shorter, phase falls from chirp to chirp: negative Doppler in the positive half of the spectrum."""
    transform = RangeDoppler(small(rx_mask=1), "hann", 16)
    power = mean_power(transform.doppler(transform.profiles(tone(6, -3, 16, 32))))
    assert power.argmax() % 16 < 8


@pytest.mark.parametrize("window", ["hann", "hamming", "rectangular"])
def test_white_noise_has_its_variance_in_every_cell(window: str) -> None:
    transform = RangeDoppler(small(64, 128), window, 60)
    noise = 7.0 * np.random.default_rng(2).standard_normal((40, 3, 64, 128)).astype(np.float32)
    power = np.mean([mean_power(transform.doppler(transform.profiles(frame))) for frame in noise], axis=0)
    assert power[3:].mean() == pytest.approx(49.0, rel=0.02)
    assert power[3:].std() < 0.15 * 49.0


@pytest.mark.parametrize("window", ["hann", "hamming", "rectangular"])
def test_windows_have_unit_energy(window: str) -> None:
    assert (unit_window(window, 64) ** 2).sum() == pytest.approx(1.0, rel=1e-5)


def test_the_window_is_the_periodic_hann() -> None:
    assert np.allclose(unit_window("hann", 32), hann(32), atol=1e-6)


def test_another_shape_is_refused_with_both_shapes() -> None:
    with pytest.raises(ValueError, match=r"expected \(rx, chirp, sample\) = \(3, 16, 32\), got \(3, 16, 31\)"):
        RangeDoppler(small(), "hann", 16).profiles(np.zeros((3, 16, 31), np.uint16))
