"""Axes against the data sheet's formulas and the published figures of two exported configurations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import ConfigError, load
from services.radar_pi.axes import C_MPS, derive_axes
from services.radar_pi.config import ProcessingConfig, RadarConfig, WaveformConfig

BENCH = load(RadarConfig, Path(__file__).parents[2] / "services" / "radar_pi" / "config_3rx_5m.toml")


def test_bench_configuration_matches_its_published_figures() -> None:
    axes = derive_axes(BENCH.waveform, BENCH.processing)
    assert axes.sampled_bandwidth_hz == pytest.approx(1.906e9, rel=1e-3)
    assert axes.slope_hz_per_s == pytest.approx(29.785e12, rel=1e-3)
    assert axes.first_sample_hz == pytest.approx(58.093e9, rel=1e-4)
    assert axes.range_bin_m == pytest.approx(0.0786, abs=1e-4)
    assert axes.v_max_mps == pytest.approx(1.27, abs=0.005)
    assert axes.velocity_bin_mps == pytest.approx(0.0397, abs=1e-4)
    assert axes.if_corner_m == pytest.approx(2.5, abs=0.05)
    assert axes.fold_m == pytest.approx(5.03, abs=0.01)


def test_tracking_configuration_matches_its_published_figures() -> None:
    waveform = WaveformConfig(
        start_frequency_hz=58e9, end_frequency_hz=63e9, samples=512, chirps=16, sample_rate_hz=1e6,
        chirp_period_s=1.99925e-3, frame_period_s=0.2003145, rx_mask=5,
    )  # fmt: skip
    axes = derive_axes(waveform)
    assert axes.range_bin_m == pytest.approx(0.030, abs=0.0003)
    assert axes.v_max_mps == pytest.approx(0.62, abs=0.005)
    assert axes.velocity_bin_mps == pytest.approx(0.077, abs=0.001)


def test_the_default_fits_walkers_and_a_small_car() -> None:
    config = RadarConfig()
    axes = derive_axes(config.waveform, config.processing)
    assert config.waveform.chirp_period_s <= 0.25e-3
    assert axes.v_max_mps >= 5.0
    assert axes.range_bin_m <= 0.12
    assert axes.range_min_m <= 0.3
    assert axes.range_max_m >= 6.0
    assert axes.if_corner_m >= 6.0
    assert axes.fold_m > axes.range_max_m


def test_closing_is_the_lower_half_of_the_velocity_axis() -> None:
    axes = derive_axes(WaveformConfig(chirps=64))
    assert axes.velocity_mps[32] == 0.0
    assert axes.velocity_mps[0] == pytest.approx(-axes.v_max_mps)
    assert np.all(np.diff(axes.velocity_mps) > 0)


@given(
    samples=st.integers(32, 1024),
    chirps=st.integers(2, 256),
    bandwidth_hz=st.floats(0.5e9, 3.0e9),
    idle_s=st.floats(1e-5, 1e-3),
)
def test_axes_agree_with_first_principles(samples: int, chirps: int, bandwidth_hz: float, idle_s: float) -> None:
    sampling_s = samples / 1e6
    waveform = WaveformConfig(
        start_frequency_hz=58e9, end_frequency_hz=58e9 + bandwidth_hz, samples=samples, chirps=chirps,
        sample_rate_hz=1e6, chirp_period_s=sampling_s + idle_s, frame_period_s=chirps * (sampling_s + idle_s) + 0.01,
    )  # fmt: skip
    axes = derive_axes(waveform, ProcessingConfig(range_min_m=0.0, range_max_m=1e6))
    delay_s = 2 * axes.range_m[5] / C_MPS
    assert axes.slope_hz_per_s * delay_s == pytest.approx(5 / sampling_s)  # bin 5 = five beats in the sampled time
    turn_m = axes.wavelength_m / 2  # one turn of phase from chirp to chirp
    assert 2 * axes.v_max_mps * waveform.chirp_period_s == pytest.approx(turn_m)
    assert axes.velocity_bin_mps * chirps == pytest.approx(2 * axes.v_max_mps)


def test_limits_that_leave_nothing_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"range_max_m = 1.2: expected at least 1\.42, 4 range bins"):
        derive_axes(WaveformConfig(), ProcessingConfig(range_min_m=1.0, range_max_m=1.2))


def test_range_offset_moves_the_axis() -> None:
    plain = derive_axes(WaveformConfig())
    moved = derive_axes(WaveformConfig(), ProcessingConfig(range_offset_m=0.05))
    assert moved.range_m[10] == pytest.approx(plain.range_m[10] - 0.05)
    assert moved.to_range_m(np.array([10.0]), np.array([0.0]))[0] == pytest.approx(moved.range_m[10])
