"""The radar's raw chirps, read back by a plain FFT: range, sign and size of the velocity, side of the azimuth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spotter_sim.bgt60 import C_MPS, MID_SCALE, RX_SPACING_M, Target, Waveform, echoes, frame, scatterers, simulate
from spotter_sim.model import DeviceUnplugged
from spotter_sim.solids import box
from spotter_sim.world import world_at

WAVE = Waveform()
RANGE_BIN_M = C_MPS / (2 * WAVE.sampled_bandwidth_hz)
SPEED_BIN_MPS = WAVE.wavelength_m / (2 * WAVE.chirps * WAVE.chirp_period_s)


def spectrum(cube: np.ndarray, static: bool = False) -> np.ndarray:
    """(rx, doppler, range) complex: windowed FFTs over samples and chirps, without the chirps' mean unless static."""
    x = cube.astype(float) - MID_SCALE
    if not static:
        x = x - x.mean(axis=1, keepdims=True)
    chirps, samples = x.shape[1:]
    fast = np.fft.fft(x * np.hanning(samples), axis=2)[:, :, : samples // 2]
    return np.fft.fftshift(np.fft.fft(fast * np.hanning(chirps)[:, None], axis=1), axes=1)


def strongest(cube: np.ndarray, static: bool = False) -> tuple[float, float, float, float]:
    """(range, velocity, azimuth, elevation) of the strongest cell beyond the leakage."""
    s = spectrum(cube, static)
    power = np.sum(np.abs(s) ** 2, axis=0)
    power[:, :2] = 0
    row, column = np.unravel_index(power.argmax(), power.shape)
    turn = 2 * np.pi * RX_SPACING_M / WAVE.wavelength_m
    azimuth = np.arcsin(np.angle(s[2, row, column] / s[0, row, column]) / turn)
    elevation = np.arcsin(np.angle(s[2, row, column] / s[1, row, column]) / turn)
    return column * RANGE_BIN_M, (row - cube.shape[1] // 2) * SPEED_BIN_MPS, azimuth, elevation


@settings(max_examples=40, deadline=None)
@given(st.floats(0.6, 5.5), st.floats(0.5, 4.0), st.booleans(), st.floats(-0.7, 0.7), st.integers(0, 2**31))
def test_a_target_is_where_a_plain_fft_finds_it(range_m, speed_mps, closing, azimuth_rad, seed):
    velocity = -speed_mps if closing else speed_mps
    cube = simulate([Target(range_m, velocity, azimuth_rad, amplitude_lsb=600.0)], WAVE, noise_lsb=1.0, seed=seed)
    got = strongest(cube)
    assert got[0] == pytest.approx(range_m, abs=1.1 * RANGE_BIN_M)
    assert got[1] == pytest.approx(velocity, abs=1.1 * SPEED_BIN_MPS)
    assert got[2] == pytest.approx(azimuth_rad, abs=0.1)


def test_closing_is_negative_and_left_is_positive():
    got = strongest(simulate([Target(2.0, -1.3, 0.4)], WAVE, seed=1))
    assert got[1] < -1.0
    assert got[2] > 0.3


def test_a_target_above_is_nearer_to_rx2():
    assert strongest(simulate([Target(2.0, -1.3, 0.0, elevation_rad=0.3)], WAVE, seed=1))[3] == pytest.approx(
        0.3, abs=0.05
    )


def test_beat_phase_of_a_standing_target():
    """The first sample's phase and the beat frequency as the FMCW equation says."""
    wave = Waveform(hp_cutoff_hz=1e-3, lp_cutoff_hz=1e12)
    cube = simulate([Target(1.5, amplitude_lsb=1000.0)], wave, noise_lsb=0.0).astype(float) - MID_SCALE
    beat_hz = 2 * wave.slope_hz_per_s * 1.5 / C_MPS
    phase = 4 * np.pi * wave.start_frequency_hz * 1.5 / C_MPS
    expected = 1000.0 / 1.5**2 * np.cos(phase + 2 * np.pi * beat_hz * np.arange(wave.samples) / wave.sample_rate_hz)
    np.testing.assert_allclose(cube[0, 0], expected, atol=1.5)
    np.testing.assert_array_equal(cube[0, 0], cube[0, -1])


def test_amplitude_falls_with_the_range_squared():
    wave = Waveform(hp_cutoff_hz=1.0, lp_cutoff_hz=1e12)
    peaks = []
    for range_m in (1.0, 2.0, 4.0):
        cube = simulate([Target(range_m, amplitude_lsb=1600.0)], wave, noise_lsb=0.0).astype(float)
        peaks.append(np.abs(cube - MID_SCALE).max())
    assert peaks[0] / peaks[1] == pytest.approx(4.0, rel=0.05)
    assert peaks[1] / peaks[2] == pytest.approx(4.0, rel=0.05)


def test_filters_take_the_very_near_and_the_far():
    def level(range_m):
        cube = simulate([Target(range_m, amplitude_lsb=100.0 * range_m**2)], WAVE, noise_lsb=0.0)
        return np.abs(cube.astype(float) - MID_SCALE).max()

    assert level(0.05) < 0.5 * level(2.0)  # below the high-pass corner
    assert level(9.0) < 0.3 * level(2.0)  # beyond the low-pass corner


def test_adc_is_twelve_bits_and_clips():
    cube = simulate([Target(0.4, amplitude_lsb=5000.0)], WAVE)
    assert cube.dtype == np.uint16
    assert (cube.min(), cube.max()) == (0, 4095)


def test_noise_is_white_and_of_the_given_size():
    cube = simulate([], WAVE, noise_lsb=6.0, seed=3).astype(float)
    assert cube.std() == pytest.approx(6.0, rel=0.03)
    assert cube.mean() == pytest.approx(MID_SCALE, abs=0.2)


@pytest.mark.parametrize("wave", [WAVE, Waveform(samples=64, chirps=32, rx=(1, 3)), Waveform(rx=(2,))])
def test_shape_follows_the_waveform(wave):
    assert frame("crossing", 1.0, wave).shape == (len(wave.rx), wave.chirps, wave.samples)


def test_receivers_keep_their_numbers():
    both, third = (
        simulate([Target(2.0, 0.0, 0.5)], WAVE, 0.0),
        simulate([Target(2.0, 0.0, 0.5)], Waveform(rx=(3,)), 0.0),
    )
    np.testing.assert_array_equal(both[2], third[0])


def test_frames_repeat_exactly_and_differ_from_each_other():
    np.testing.assert_array_equal(frame("crossing", 4.0), frame("crossing", 4.0))
    assert np.any(frame("crossing", 4.0) != frame("crossing", 4.1))
    assert np.any(frame("crossing", 5.3) != frame("faults", 5.3))


@pytest.mark.parametrize("t_s", [3.0, 3.5, 4.0, 9.5, 10.0, 10.5])
def test_the_approaching_body_is_the_strongest_moving_echo(t_s):
    world = world_at("crossing", t_s)
    person, car = world.actors[:2]
    body = person if t_s < 6 else car
    got = strongest(frame("crossing", t_s))
    nearest = min(s[0] for s in scatterers(world) if abs(s[1] - got[1]) < 0.6)
    assert got[0] == pytest.approx(nearest, abs=0.8)  # torso and limbs, front and rear reflect
    assert got[1] == pytest.approx(-np.linalg.norm(body.velocity_mps), abs=0.4)


def test_empty_yard_has_static_clutter_only():
    cube = frame("empty", 2.0)
    moving = np.abs(spectrum(cube)) ** 2
    noise = np.median(moving)
    assert moving[:, :, 3:].max() < 60 * noise
    static = np.abs(spectrum(cube, static=True)[:, 32, 3:]) ** 2
    assert static.max() > 1000 * noise


def test_faults():
    with pytest.raises(TimeoutError):
        frame("faults", 41.0)
    with pytest.raises(DeviceUnplugged):
        frame("faults", 50.0)
    assert frame("faults", 46.0).any()


def test_a_large_plate_echoes_as_a_mirror_when_near():
    """Twice as far, half the echo: what fills the beam reflects with 1 / range (a point: 1 / range^2)."""
    strength = {}
    for range_m in (0.5, 1.0):
        plate = box((range_m, range_m + 0.1), (-1.0, 1.0), (-1.0, 1.0), "car", "paint")
        strength[range_m] = float(echoes(plate, np.eye(4))[0, 4]) / range_m**2
    assert strength[0.5] / strength[1.0] == pytest.approx(2.0)


def test_nothing_in_the_demonstration_saturates_the_converter():
    """Neither the person nor the car at arm's length: they are near, not out of the radar's reach."""
    for t_s in np.arange(0.0, 15.0, 0.2):
        samples = frame("crossing", float(t_s))
        assert 0 < samples.min() < samples.max() < 4095, f"at {t_s:.1f} s"
