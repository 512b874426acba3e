"""The physical axes of a waveform: the one place where range bins, speeds and limits are computed.

The sweep that counts is the one *sampled*: the ramp runs ``sample_delay_s`` before the first sample, so the emitted
bandwidth would make every range 3 to 9 % short (BGT60TR13C data sheet, ramp timing; Avian SDK documentation).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.config import ConfigError
from services.radar_pi.config import ProcessingConfig, WaveformConfig

LEAST_BINS = 4  # that are looked at
C_MPS = 299_792_458.0


@dataclass(frozen=True)
class Axes:
    """Bins to metres and metres per second. Closing is negative."""

    sampled_bandwidth_hz: float
    slope_hz_per_s: float
    wavelength_m: float  # at the middle of the sampled sweep
    range_bin_m: float
    velocity_bin_mps: float
    v_max_mps: float  # unambiguous: +- this
    range_offset_m: float
    range_lead_s: float  # a bin shows the range that the target has so much after the first chirp
    first_sample_hz: float  # frequency at the first sample
    range_m: np.ndarray  # (samples / 2,) float64, bins from 0
    velocity_mps: np.ndarray  # (chirps,) float64, rising from -v_max
    near_bin: int  # first and one past the last bin that is looked at
    far_bin: int
    if_corner_m: float  # range at the anti-alias corner: farther is attenuated
    fold_m: float  # range at half the sampling rate: farther folds back, with its velocity mirrored

    def to_range_m(self, range_bin: np.ndarray, velocity_mps: np.ndarray) -> np.ndarray:
        """Range at the first chirp from the (fractional) bin that the whole frame peaks in.

        The frame shows its middle, and a moving target's beat frequency holds its Doppler frequency too.
        """
        return np.asarray(range_bin * self.range_bin_m - self.range_offset_m - velocity_mps * self.range_lead_s)

    @property
    def range_min_m(self) -> float:
        """Range of the first bin that is looked at."""
        return float(self.range_m[self.near_bin])

    @property
    def range_max_m(self) -> float:
        """Range of the last bin that is looked at."""
        return float(self.range_m[self.far_bin - 1])


def derive_axes(waveform: WaveformConfig, processing: ProcessingConfig | None = None) -> Axes:
    """All axes of a configuration.

    Raises:
        ConfigError: the range limits leave fewer than four bins.
    """
    processing = processing or ProcessingConfig()
    sampling_s = waveform.samples / waveform.sample_rate_hz
    slope = (waveform.end_frequency_hz - waveform.start_frequency_hz) / (sampling_s + waveform.sample_delay_s)
    bandwidth_hz = slope * sampling_s
    wavelength_m = C_MPS / (waveform.end_frequency_hz - bandwidth_hz / 2)
    range_bin_m = C_MPS / (2 * bandwidth_hz)
    v_max_mps = wavelength_m / (4 * waveform.chirp_period_s)
    velocity_bin_mps = 2 * v_max_mps / waveform.chirps
    range_m = np.arange(waveform.samples // 2) * range_bin_m - processing.range_offset_m
    near = max(1, int(np.searchsorted(range_m, processing.range_min_m)))
    far = int(np.searchsorted(range_m, processing.range_max_m, side="right"))
    if far - near < LEAST_BINS:
        raise ConfigError(_too_few_bins(processing, range_m, near))
    return Axes(
        sampled_bandwidth_hz=bandwidth_hz,
        slope_hz_per_s=slope,
        wavelength_m=wavelength_m,
        range_bin_m=range_bin_m,
        velocity_bin_mps=velocity_bin_mps,
        v_max_mps=v_max_mps,
        range_offset_m=processing.range_offset_m,
        range_lead_s=C_MPS / wavelength_m / slope + (waveform.chirps - 1) / 2 * waveform.chirp_period_s,
        first_sample_hz=waveform.end_frequency_hz - bandwidth_hz,
        range_m=range_m,
        velocity_mps=(np.arange(waveform.chirps) - waveform.chirps // 2) * velocity_bin_mps,
        near_bin=near,
        far_bin=far,
        if_corner_m=waveform.lp_cutoff_hz * C_MPS / (2 * slope),
        fold_m=waveform.sample_rate_hz / 2 * C_MPS / (2 * slope),
    )


def _too_few_bins(processing: ProcessingConfig, range_m: np.ndarray, near: int) -> str:
    """Which of the limits leaves too few of the bins at ``range_m`` (M,), and what is allowed; near: the first one."""
    least = f"{LEAST_BINS} range bins of {range_m[1] - range_m[0]:.3f} m"
    if near + LEAST_BINS <= len(range_m):
        allowed_m = math.ceil(100 * range_m[near + LEAST_BINS - 1]) / 100
        return (
            f"[processing] range_max_m = {processing.range_max_m}: expected at least {allowed_m:.2f}, "
            f"{least} from range_min_m = {processing.range_min_m} on"
        )
    most_m, offset_m = range_m[-LEAST_BINS], processing.range_offset_m
    key, value = "range_min_m", processing.range_min_m
    if most_m < 0.0:  # no range_min_m would do
        key, value, most_m = "range_offset_m", offset_m, most_m + offset_m
    allowed = f"expected at most {math.floor(100 * most_m) / 100:.2f}"
    return f"[processing] {key} = {value}: {allowed}, {least} before this waveform's {range_m[-1] + offset_m:.2f} m"
