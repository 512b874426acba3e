"""Radar: speed against a plain numpy version, accuracy, detection probability, false alarms.

python -m benchmarks.radar.radar            about a minute
python -m benchmarks.radar.radar speed      one part: speed, accuracy, detection, noise, recorded
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.radar import radar_accuracy as measure
from benchmarks.radar import radar_reference as plain
from common.codec import encode
from services.radar_pi.chip.packing import Layout, pack_frame, unpack_frame
from services.radar_pi.config import CfarConfig, RadarConfig
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.recording import open_recording

REPEATS = 300


def timed(work: Callable[[int], object], repeats: int) -> tuple[float, float]:
    """(median, best) milliseconds of processor time of ``work(i)``: other processes may interrupt it."""
    times_ms = []
    for i in range(repeats):
        start_s = time.process_time()
        work(i)
        times_ms.append((time.process_time() - start_s) * 1e3)
    return float(np.median(times_ms)), min(times_ms)


def words_of_a_walk(config: RadarConfig, frames: int) -> list[np.ndarray]:
    """FIFO bytes of a body that walks towards the radar."""
    truth = [measure.Truth(5.5 - 0.14 * i, -1.4, 0.2, 30.0) for i in range(frames)]
    rng = np.random.default_rng(1)
    return [pack_frame(measure.exact_frame(t, config.waveform, 6.0, rng), i) for i, t in enumerate(truth)]


def speed() -> None:
    """One 3 x 64 x 128 frame from FIFO words to the encoded message."""
    config = RadarConfig()
    waveform = config.waveform
    layout = Layout(len(waveform.rx), waveform.chirps, waveform.samples)
    words = words_of_a_walk(config, 35)
    pipeline = RadarPipeline(config)

    def fast(i: int) -> bytes:
        frame = unpack_frame(words[i % len(words)], layout)
        return encode(pipeline.process(i * 100_000_000, frame))

    fast_ms, best_ms = timed(fast, REPEATS)
    background = np.zeros((3, pipeline.axes.far_bin), complex)
    frames = [unpack_frame(packed, layout) for packed in words]

    def reference(i: int) -> object:
        profiles = plain.range_profiles(frames[i], pipeline.axes.far_bin)
        moving, _ = plain.remove_background(profiles, background, 0.92)
        return plain.cfar_hits(plain.power_map(moving)[pipeline.axes.near_bin :], config.cfar, 3)

    plain_ms, _ = timed(reference, 2)
    print(f"one 3 x 64 x 128 frame, words to message: median {fast_ms:.2f} ms, best {best_ms:.2f} ms")
    print(f"plain numpy to the same CFAR cells:       median {plain_ms:.0f} ms, ratio {plain_ms / fast_ms:.0f}")
    print(f"at 20 Hz: {fast_ms * 20 / 10:.1f} % of one core of this machine")
    stages = pipeline.process(10**12, frames[20]).stage_ms
    print("stages: " + ", ".join(f"{name} {ms:.2f} ms" for name, ms in stages.items()))


def accuracy() -> None:
    """Errors of range, velocity (and its sign), azimuth and time to collision against the simulated truth."""
    errors = measure.accuracy(400, seed=1)
    print(f"{len(errors['tracks'])} bodies, 0.3 to 6 m, +-4 m/s, +-40 degrees, cell SNR 20 to 45 dB, six frames each")
    print(f"{'error':14s}{'median':>10s}{'p95':>10s}{'bias':>10s}")
    for key, unit in (("range_m", "m"), ("velocity_mps", "m/s"), ("azimuth_deg", "deg"), ("ttc_s", "s")):
        values = errors[key]
        median, p95 = np.percentile(np.abs(values), [50, 95])
        print(f"{key.rsplit('_', 1)[0] + ', ' + unit:14s}{median:10.4f}{p95:10.4f}{values.mean():10.4f}")
    print(f"TTC relative: p95 {np.percentile(np.abs(errors['ttc_fraction']), 95):.1%}")
    wrong, tracks = int(errors["wrong_sign"].sum()), errors["tracks"]
    print(f"wrong sign: {wrong}; not exactly one track: {np.count_nonzero(tracks != 1)}")


def detection() -> None:
    """Share of detected cells by cell SNR in dB, both detectors, beside theory."""
    print(f"{'cell SNR, dB':>12s}{'CA':>8s}{'OS':>8s}{'theory':>8s}   16 dB, 3 receivers, 900 trials each")
    for snr_db in (8.0, 12.0, 14.0, 15.0, 16.0, 17.0, 18.0, 20.0, 25.0):
        ca, os_ = (measure.detection_rate(snr_db, 900, int(snr_db), kind) for kind in ("ca", "os"))
        print(f"{snr_db:12.0f}{ca:8.3f}{os_:8.3f}{measure.detection_theory(snr_db, 16.0, 3):8.3f}")


def noise() -> None:
    """Measured false alarm rates with their confidence intervals, and tracks reported on noise."""
    print(f"{'':10s}{'set':>9s}{'measured':>12s}{'99 % interval':>24s}{'windowed':>12s}   white noise cells")
    for kind in ("ca", "os"):
        for receivers in (1, 3):
            for p_fa, frames in ((1e-2, 60), (1e-3, 200), (1e-4, 400), (1e-5, 1000)):
                rate = measure.false_alarm_rate(p_fa, kind, receivers, frames, seed=5)
                windowed = measure.false_alarm_rate(p_fa, kind, receivers, frames // 2, seed=6, window="hann")
                verdict = "" if rate.low <= p_fa <= rate.high else "  OUTSIDE"
                interval = f"{rate.low:.2e} .. {rate.high:.2e}"
                label = f"{kind.upper()}, {receivers} RX"
                print(f"{label:10s}{p_fa:9.0e}{rate.measured:12.2e}{interval:>24s}{windowed.measured:12.2e}{verdict}")
    tracks, detections = measure.tracks_on_noise(10_000, seed=6)
    print(
        f"10,000 noise frames at {CfarConfig().threshold_db:.0f} dB: {tracks} tracks reported, {detections} detections"
    )


def recorded() -> None:
    """Real chirps: cells over threshold where nothing moves, tracks where somebody only breathes."""
    folder = Path(os.environ.get("SPOTTER_DATA", "../shared/data")) / "radar-bgt60tr13c"
    if not folder.is_dir():
        print(f"no recordings in {folder}; set SPOTTER_DATA")
        return
    for name, first, last in (
        ("two_reflectors", 15, 128), ("moving_hand_first_half", 0, 12), ("seated_person_breathing", 15, 256),
    ):  # fmt: skip
        recording = open_recording(folder / name)
        pipeline = RadarPipeline(msgspec.structs.replace(RadarConfig(), waveform=recording.waveform))
        near = pipeline.axes.near_bin
        cells = hits = moving = approaching = 0
        for i, (stamp_ns, frame) in enumerate(recording):
            message = pipeline.process(stamp_ns, frame)
            if first <= i < last:
                power = (10 ** (pipeline.detections().range_doppler_db / 10))[near:]
                cells += power.size
                over = pipeline.cfar.detect(power)
                speeds = np.abs(pipeline.axes.velocity_mps[over.column])
                hits += len(over.row)
                moving += np.count_nonzero(speeds > 2.5 * pipeline.axes.velocity_bin_mps)  # beyond the standing echo
                approaching += sum(track.approaching for track in message.tracks)
        print(
            f"{name:26s} {last - first} frames, {cells} cells: {hits} over 16 dB, {moving} of them moving; "
            f"approaching tracks: {approaching}"
        )


PARTS = {"speed": speed, "accuracy": accuracy, "detection": detection, "noise": noise, "recorded": recorded}


def main() -> None:
    """Print the parts named on the command line, or all: speed, accuracy, detection, noise, recorded chirps."""
    wanted = [name for name in sys.argv[1:] if name in PARTS] or list(PARTS)
    for name in wanted:
        print(f"--- radar, {name}")
        PARTS[name]()


if __name__ == "__main__":
    main()
