"""What the radar measures, against what was simulated: accuracy, detection probability, false alarms.

Every number is seeded; the tests use the same functions with fewer trials.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from scipy.stats import chi2, ncx2

from common.messages import RadarTracks
from services.radar_pi.axes import C_MPS, derive_axes
from services.radar_pi.cfar import build_cfar
from services.radar_pi.config import CfarConfig, RadarConfig, WaveformConfig
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.spectrum import RangeDoppler, mean_power, unit_window
from spotter_sim.bgt60 import LEAKAGE, NOISE_LSB, simulate


@dataclass(frozen=True)
class Truth:
    """A body that moves at constant velocity straight at the radar or away from it."""

    range_m: float  # in the last frame
    velocity_mps: float
    azimuth_rad: float
    snr_db: float


def draw(rng: np.random.Generator, trials: int) -> Iterator[Truth]:
    """Range 0.3 to 6 m, speed 0.3 to 4 m/s either way, azimuth +-40 degrees, cell SNR 20 to 45 dB."""
    for _ in range(trials):
        yield Truth(
            rng.uniform(0.3, 6.0),
            rng.uniform(0.3, 4.0) * rng.choice([-1.0, 1.0]),
            rng.uniform(-1.0, 1.0) * np.radians(40.0),
            rng.uniform(20.0, 45.0),
        )


def exact_frame(truth: Truth, waveform: WaveformConfig, noise_lsb: float, rng: np.random.Generator) -> np.ndarray:
    """ADC samples of a point that moves during chirp and frame: the FMCW equation, evaluated sample by sample.

    ``truth`` holds at the first sample of the frame. The phase is that of emitted times received wave for the delay of
    that very sample, 2 pi (f t_d + slope tau t_d - slope t_d^2 / 2): nothing of the pipeline's (or of the simulator's)
    approximations is in it. Amplitude: the cell SNR of one receiver on a cell's centre.
    """
    axes = derive_axes(waveform)
    gain = (unit_window("hann", waveform.samples).sum() * unit_window("hann", waveform.chirps).sum()) ** 2 / 4
    amplitude = noise_lsb * np.sqrt(10 ** (truth.snr_db / 10) / gain)
    tau_s = np.arange(waveform.samples) / waveform.sample_rate_hz
    time_s = np.arange(waveform.chirps)[:, None] * waveform.chirp_period_s + tau_s
    path_m = 2 * (truth.range_m + truth.velocity_mps * time_s)
    frame = noise_lsb * rng.standard_normal((len(waveform.rx), waveform.chirps, waveform.samples))
    frame += simulate(LEAKAGE, simulator_waveform(waveform), noise_lsb=0.0)
    for i, rx in enumerate(waveform.rx):
        detour_m = 2.5e-3 * np.sin(truth.azimuth_rad) if rx in (2, 3) else 0.0
        delay_s = (path_m + detour_m) / C_MPS
        turns = (axes.first_sample_hz + axes.slope_hz_per_s * (tau_s - delay_s / 2)) * delay_s
        frame[i] += amplitude * np.cos(2 * np.pi * turns)
    return np.clip(np.rint(frame), 0, 4095).astype(np.uint16)


def settled_pipeline(config: RadarConfig) -> tuple[RadarPipeline, int]:
    """A pipeline that has seen its settling frames of an empty scene, and the next stamp."""
    pipeline = RadarPipeline(config)
    shape = simulator_waveform(config.waveform)
    period_ns = round(config.waveform.frame_period_s * 1e9)
    for i in range(config.processing.settling_frames):
        pipeline.process(i * period_ns, simulate(LEAKAGE, shape, seed=i))
    return pipeline, config.processing.settling_frames * period_ns


def approach(pipeline: RadarPipeline, start_ns: int, truth: Truth, frames: int, seed: int) -> list[RadarTracks]:
    """The messages of so many frames that end with the truth."""
    waveform = pipeline.config.waveform
    rng = np.random.default_rng(seed)
    messages = []
    for i in range(frames):
        before_s = (frames - 1 - i) * waveform.frame_period_s
        then = replace(truth, range_m=truth.range_m - truth.velocity_mps * before_s)
        frame = exact_frame(then, waveform, NOISE_LSB, rng)
        messages.append(pipeline.process(start_ns + round(i * waveform.frame_period_s * 1e9), frame))
    return messages


FRAMES = 6


def accuracy(trials: int, seed: int, config: RadarConfig | None = None) -> dict[str, np.ndarray]:
    """Errors of the track after six frames, one row per trial in which the whole path lies in the radar's view.

    Keys: range_m, velocity_mps, azimuth_deg, ttc_s (closing bodies), ttc_fraction; wrong_sign, tracks (how many).
    """
    config = config or RadarConfig()
    fresh, start_ns = settled_pipeline(config)
    rows: dict[str, list[float]] = {key: [] for key in ERRORS}
    for number, truth in enumerate(draw(np.random.default_rng(seed), trials)):
        first_m = truth.range_m - truth.velocity_mps * (FRAMES - 1) * config.waveform.frame_period_s
        if not 0.3 <= first_m <= 6.0:
            continue
        newest = approach(deepcopy(fresh), start_ns, truth, FRAMES, seed * 100_000 + number)[-1]
        rows["tracks"].append(len(newest.tracks))
        if not newest.tracks:
            continue
        track = min(newest.tracks, key=lambda t: abs(t.range_m - truth.range_m))
        rows["range_m"].append(track.range_m - truth.range_m)
        rows["velocity_mps"].append(track.velocity_mps - truth.velocity_mps)
        rows["wrong_sign"].append(track.velocity_mps * truth.velocity_mps < 0)
        if track.azimuth_rad is not None:
            rows["azimuth_deg"].append(np.degrees(track.azimuth_rad - truth.azimuth_rad))
        if truth.velocity_mps < 0:
            true_s = truth.range_m / -truth.velocity_mps
            told_s = np.inf if track.ttc_s is None else track.ttc_s
            rows["ttc_s"].append(told_s - true_s)
            rows["ttc_fraction"].append((told_s - true_s) / true_s)
    return {key: np.array(values, float) for key, values in rows.items()}


ERRORS = ("range_m", "velocity_mps", "azimuth_deg", "ttc_s", "ttc_fraction", "wrong_sign", "tracks")


def detection_theory(snr_db: float, threshold_db: float, looks: int) -> float:
    """Non-fluctuating target, square-law sum of ``looks`` receivers, known noise (Marcum's Q of order ``looks``)."""
    threshold, snr = 10 ** (threshold_db / 10), 10 ** (snr_db / 10)
    return float(ncx2.sf(2 * looks * threshold, 2 * looks, 2 * looks * snr))


def detection_rate(snr_db: float, trials: int, seed: int, kind: str = "ca") -> float:
    """Measured share of detected cells: bin-centred bodies in white noise, through both FFTs and the CFAR."""
    config = RadarConfig(cfar=CfarConfig(kind=kind))  # type: ignore[arg-type]
    waveform = config.waveform
    rng = np.random.default_rng(seed)
    rows, receivers = waveform.samples // 2 - 2, len(waveform.rx)
    transform = RangeDoppler(waveform, "hann", rows + 2)
    cfar = build_cfar(config.cfar, rows, waveform.chirps, receivers)
    cells = [(12, 10), (12, 42), (32, 26), (32, 58), (52, 10), (52, 42)]  # out of each other's training
    found = count = 0
    while count < trials:
        frame = rng.standard_normal((receivers, waveform.chirps, waveform.samples), np.float32)
        for row, column in cells:
            frame += _tone(row, column - waveform.chirps // 2, snr_db, frame.shape, rng)
        power = mean_power(transform.doppler(transform.profiles(frame)))[2:]
        hits = cfar.detect(power)
        over = set(zip(hits.row.tolist(), hits.column.tolist(), strict=True))
        found += sum((row - 2, column) in over for row, column in cells)
        count += len(cells)
    return found / count


def _tone(row: int, doppler: int, snr_db: float, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """A beat signal on a cell's centre with this cell SNR in noise of variance 1, phases at random per receiver."""
    receivers, chirps, samples = shape
    gain = (unit_window("hann", samples).sum() * unit_window("hann", chirps).sum()) ** 2 / 4
    phase = rng.uniform(0, 2 * np.pi, (receivers, 1, 1))
    slow, fast = doppler * np.arange(chirps) / chirps, row * np.arange(samples) / samples
    signal = np.cos(phase + 2 * np.pi * (slow[:, None] + fast[None, :]))
    return (np.sqrt(10 ** (snr_db / 10) / gain) * signal).astype(np.float32)


@dataclass(frozen=True)
class Rate:
    """A measured rate with its 99 % confidence interval."""

    measured: float
    low: float
    high: float
    cells: int


def false_alarm_rate(
    p_fa: float, kind: str, receivers: int, frames: int, seed: int, window: str = "rectangular"
) -> Rate:
    """Measured rate on white noise, through both FFTs, with the threshold set for ``p_fa``."""
    config = CfarConfig(kind=kind, p_fa=p_fa, excise_db=0.0)  # type: ignore[arg-type]
    waveform = msgspec.structs.replace(WaveformConfig(), rx_mask={1: 1, 3: 7}[receivers])
    axes = derive_axes(waveform)
    transform = RangeDoppler(waveform, window, axes.far_bin)
    cfar = build_cfar(config, axes.far_bin - axes.near_bin, waveform.chirps, receivers)
    rng = np.random.default_rng(seed)
    counts = np.empty(frames)
    for i in range(frames):
        frame = rng.standard_normal((receivers, waveform.chirps, waveform.samples), np.float32)
        power = mean_power(transform.doppler(transform.profiles(frame)))[axes.near_bin :]
        counts[i] = len(cfar.detect(power).row)
    cells = frames * (axes.far_bin - axes.near_bin) * waveform.chirps
    return _interval(counts, cells)


def _interval(counts: np.ndarray, cells: int) -> Rate:
    """99 %: exact Poisson, widened by the counts' over-dispersion, because neighbours share their training cells."""
    total = float(counts.sum())
    spread = max(1.0, float(np.sqrt(counts.var(ddof=1) / counts.mean()))) if total > 30 else 1.0
    low = chi2.ppf(0.005, 2 * total) / 2 if total else 0.0
    high = chi2.ppf(0.995, 2 * total + 2) / 2
    low, high = total + spread * (low - total), total + spread * (high - total)
    return Rate(total / cells, max(0.0, low) / cells, high / cells, cells)


def tracks_on_noise(frames: int, seed: int) -> tuple[int, int]:
    """(reported tracks, detections) on frames of noise and leakage, through the whole pipeline at the default 16 dB."""
    config = RadarConfig()
    pipeline = RadarPipeline(config)
    shape = simulator_waveform(config.waveform)
    still = simulate(LEAKAGE, shape, noise_lsb=0.0).astype(np.float32)
    rng = np.random.default_rng(seed)
    tracks = detections = 0
    for i in range(frames):
        noise = NOISE_LSB * rng.standard_normal(still.shape, np.float32)
        frame = np.clip(np.rint(still + noise), 0, 4095).astype(np.uint16)
        message = pipeline.process(round(i * config.waveform.frame_period_s * 1e9), frame)
        tracks += len(message.tracks)
        detections += len(pipeline.detections().detections)
    return tracks, detections
