"""What the emulated chip measures: nothing, noise, or the simulated world."""

from __future__ import annotations

import numpy as np

from services.radar_pi.axes import derive_axes
from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulator.emulated_fifo import SignalSource
from spotter_sim import bgt60
from spotter_sim.world import scenario_time

MID_SCALE = 2048


def silence(t_s: float, waveform: WaveformConfig) -> np.ndarray:
    """Mid-scale: an ideal receiver in an empty room."""
    return np.full((len(waveform.rx), waveform.chirps, waveform.samples), MID_SCALE, np.uint16)


def noise(sigma_lsb: float = 20.0, seed: int = 0) -> SignalSource:
    """White noise about mid-scale."""
    rng = np.random.default_rng(seed)

    def signal(t_s: float, waveform: WaveformConfig) -> np.ndarray:
        shape = (len(waveform.rx), waveform.chirps, waveform.samples)
        samples = rng.normal(MID_SCALE, sigma_lsb, shape)
        return np.clip(np.rint(samples), 0, 4095).astype(np.uint16)

    return signal


def world(scenario: str) -> SignalSource:
    """The simulated world (``spotter_sim``) at scenario time = UTC modulo the scenario's length.

    Raises:
        ValueError: no such scenario.
    """
    scenario_time(scenario, 0)

    def signal(t_s: float, waveform: WaveformConfig) -> np.ndarray:
        return bgt60.frame(scenario, scenario_time(scenario, round(t_s * 1e9)), simulator_waveform(waveform))

    return signal


def simulator_waveform(waveform: WaveformConfig) -> bgt60.Waveform:
    """The part of the waveform that is sampled, as the simulator wants it."""
    axes = derive_axes(waveform)
    return bgt60.Waveform(
        start_frequency_hz=axes.first_sample_hz,
        sampled_bandwidth_hz=axes.sampled_bandwidth_hz,
        samples=waveform.samples,
        chirps=waveform.chirps,
        sample_rate_hz=waveform.sample_rate_hz,
        chirp_period_s=waveform.chirp_period_s,
        rx=waveform.rx,
        hp_cutoff_hz=waveform.hp_cutoff_hz,
        lp_cutoff_hz=waveform.lp_cutoff_hz,
    )
