"""What the emulated chip measures: nothing, noise, or the simulated world."""

from __future__ import annotations

import numpy as np

from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulated_fifo import SignalSource

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
    """The simulated world (``common/sim``) at scenario time = UTC modulo the scenario's length.

    Raises:
        ValueError: no such scenario.
    """
    from common.sim import bgt60
    from common.sim.world import scenario_time

    scenario_time(scenario, 0)

    def signal(t_s: float, waveform: WaveformConfig) -> np.ndarray:
        sampling_s = waveform.samples / waveform.sample_rate_hz
        ramp_s = sampling_s + waveform.sample_delay_s
        slope = (waveform.end_frequency_hz - waveform.start_frequency_hz) / ramp_s
        sampled = bgt60.Waveform(
            start_frequency_hz=waveform.start_frequency_hz + slope * waveform.sample_delay_s,
            sampled_bandwidth_hz=slope * sampling_s,
            samples=waveform.samples,
            chirps=waveform.chirps,
            sample_rate_hz=waveform.sample_rate_hz,
            chirp_period_s=waveform.chirp_period_s,
            rx=waveform.rx,
            hp_cutoff_hz=waveform.hp_cutoff_hz,
            lp_cutoff_hz=waveform.lp_cutoff_hz,
        )
        return bgt60.frame(scenario, scenario_time(scenario, round(t_s * 1e9)), sampled)

    return signal
