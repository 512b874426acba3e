"""Chirps -> range profiles -> range-Doppler spectrum, both by windowed FFT in single precision.

Windows have unit energy, so white noise of variance s^2 per ADC sample has mean power s^2 in every cell.
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from services.radar_pi.config import WaveformConfig


class RangeDoppler:
    """The two transforms of one waveform; holds the windows and nothing else."""

    def __init__(self, waveform: WaveformConfig, window: str, bins: int) -> None:
        self._shape = (len(waveform.rx), waveform.chirps, waveform.samples)
        self._bins = bins
        self._range_window = unit_window(window, waveform.samples)
        self._ones = np.ones(waveform.samples, np.float32)
        self._doppler_window = _shifting(unit_window(window, waveform.chirps))[:, None]

    def profiles(self, frame: np.ndarray) -> np.ndarray:
        """Range profile of every chirp.

        Args:
            frame: (rx, chirp, sample) ADC samples, any real dtype.

        Returns:
            (rx, chirp, bin) complex64, range bins from 0. Phase grows with distance.

        Raises:
            ValueError: the frame has another shape than the waveform says.
        """
        if frame.shape != self._shape:
            raise ValueError(f"radar frame: expected (rx, chirp, sample) = {self._shape}, got {frame.shape}")
        samples = frame.astype(np.float32)
        samples -= (samples @ self._ones / len(self._ones))[
            :, :, None
        ]  # the mean, exact, five times faster than mean()
        samples *= self._range_window
        profiles: np.ndarray = scipy.fft.rfft(samples, axis=2, overwrite_x=True)[:, :, : self._bins]
        return profiles

    def doppler(self, profiles: np.ndarray) -> np.ndarray:
        """Doppler spectrum of every range bin: (rx, chirp, bin) -> (rx, doppler, bin) complex64.

        Doppler rows rise from -v_max; a receding target's phase grows from chirp to chirp, so it lies above the middle.
        """
        spectrum: np.ndarray = scipy.fft.fft(profiles * self._doppler_window, axis=1, overwrite_x=True)
        return spectrum


def mean_power(spectrum: np.ndarray) -> np.ndarray:
    """Non-coherent integration: the mean of |.|^2 over the receivers, (rx, doppler, bin) -> (bin, doppler) float32."""
    parts = spectrum.view(np.float32)
    squares = np.einsum("rdk,rdk->dk", parts, parts)
    power = squares[:, ::2] + squares[:, 1::2]
    power *= 1.0 / len(spectrum)
    return np.ascontiguousarray(power.T)


def unit_window(name: str, length: int) -> np.ndarray:
    """A periodic window of unit energy, (length,) float32."""
    angle = 2 * np.pi * np.arange(length) / length
    shape = {
        "hann": 0.5 - 0.5 * np.cos(angle),
        "hamming": 0.54 - 0.46 * np.cos(angle),
        "rectangular": np.ones(length),
    }[name]
    return (shape / np.sqrt((shape**2).sum())).astype(np.float32)


def _shifting(window: np.ndarray) -> np.ndarray:
    """The window times a phase ramp, so that zero Doppler comes out in the middle without an fftshift."""
    length = len(window)
    ramp = np.exp(2j * np.pi * (length // 2) / length * np.arange(length))
    return (window * (ramp.real if length % 2 == 0 else ramp)).astype(np.float32 if length % 2 == 0 else np.complex64)
