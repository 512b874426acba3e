"""Real BGT60TR13C chirps through the real pipeline: reflectors, a seated person, a hand."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest

from common.messages import RadarTracks
from services.radar_pi.axes import C_MPS, derive_axes
from services.radar_pi.config import RadarConfig
from services.radar_pi.detection import Detection
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.recording import Recording, open_recording

DATA = Path(os.environ.get("SPOTTER_DATA", Path(__file__).parents[3] / "shared" / "data")) / "radar-bgt60tr13c"


def recording(name: str) -> Recording:
    if not (DATA / name).is_dir():
        pytest.skip(f"no recording {name} in {DATA}; set SPOTTER_DATA")
    return open_recording(DATA / name)


def run(recorded: Recording) -> tuple[RadarPipeline, list[RadarTracks], list[list[Detection]], list[np.ndarray]]:
    pipeline = RadarPipeline(msgspec.structs.replace(RadarConfig(), waveform=recorded.waveform))
    messages, detections, maps = [], [], []
    for stamp_ns, frame in recorded:
        messages.append(pipeline.process(stamp_ns, frame))
        shown = pipeline.detections()
        detections.append(list(shown.detections))
        maps.append(shown.range_doppler_db)
    return pipeline, messages, detections, maps


def peaks(profile: np.ndarray) -> list[int]:
    """Local maxima from the fifth bin on (nearer is leakage), strongest first."""
    inner = np.arange(5, len(profile) - 1)
    tops = [k for k in inner if profile[k] > profile[k - 1] and profile[k] >= profile[k + 1]]
    return sorted(tops, key=lambda k: -profile[k])


PATH_M = 0.034  # what the way through chip, feed and cover adds to every range of that unit: one value for both


def standing_profile(pipeline: RadarPipeline) -> np.ndarray:
    """The range profile before subtraction: mean magnitude over the receivers, (bin,)."""
    assert pipeline.clutter.background is not None
    profile: np.ndarray = np.abs(pipeline.clutter.background).mean(axis=0)
    return profile


def sub_bin(profile: np.ndarray, k: int) -> float:
    """Place of the top of a parabola through a peak and its neighbours, in dB."""
    before, top, after = 20 * np.log10(profile[k - 1 : k + 2])
    return k + 0.5 * float((before - after) / (before - 2 * top + after))


def test_two_reflectors_are_in_bins_11_and_17() -> None:
    """The recordist's 0.30 and 0.46 m are these bins on an axis made of the *emitted* bandwidth."""
    recorded = recording("two_reflectors")
    pipeline, *_ = run(recorded)
    waveform = recorded.waveform
    nominal_bin_m = C_MPS / (2 * (waveform.end_frequency_hz - waveform.start_frequency_hz))
    nearest = sorted(peaks(standing_profile(pipeline))[:2])
    assert nearest == [11, 17]
    assert [k * nominal_bin_m for k in nearest] == pytest.approx([0.30, 0.46], abs=0.005)


def test_two_reflectors_are_within_a_bin_on_our_axis_with_one_path_offset() -> None:
    """On the sampled bandwidth's axis both are too far by nearly the same: one offset brings both within half a bin."""
    recorded = recording("two_reflectors")
    pipeline, *_ = run(recorded)
    profile = standing_profile(pipeline)
    exact = np.array([sub_bin(profile, k) for k in sorted(peaks(profile)[:2])])
    bin_m = pipeline.axes.range_bin_m
    assert bin_m == pytest.approx(0.0299, abs=1e-4)  # of this configuration
    standing_mps = np.zeros(2)
    assert pipeline.axes.to_range_m(exact, standing_mps) == pytest.approx([0.327, 0.501], abs=0.003)
    processing = msgspec.structs.replace(pipeline.config.processing, range_offset_m=PATH_M)
    calibrated = derive_axes(recorded.waveform, processing)
    assert calibrated.to_range_m(exact, standing_mps) == pytest.approx([0.30, 0.46], abs=0.5 * bin_m)


def test_two_reflectors_are_gone_after_settling() -> None:
    recorded = recording("two_reflectors")
    pipeline, messages, _, maps = run(recorded)
    profile = standing_profile(pipeline)
    nearest = sorted(peaks(profile)[:2])
    standing_db = 20 * np.log10(profile[nearest])
    left_db = np.array([map_[nearest].max(axis=1) for map_ in maps[15:]])
    gain_db = 10 * np.log10(recorded.waveform.chirps / 1.5)  # what the Doppler FFT adds to a standing echo
    assert np.all(np.median(left_db, axis=0) < standing_db + gain_db - 25.0)
    assert all(message.tracks == [] for message in messages[15:])


def test_a_quiet_room_is_quiet() -> None:
    """Real quiet frames: hardly a detection, no track."""
    recorded = recording("two_reflectors")
    pipeline, messages, detections, maps = run(recorded)
    looked_at = np.prod(maps[0][pipeline.axes.near_bin :].shape) * len(maps)
    assert sum(len(frame) for frame in detections[15:]) / looked_at < 1e-4
    assert {message.level for message in messages} == {"SAFE"}


def test_a_seated_person_never_approaches() -> None:
    _, messages, _, _ = run(recording("seated_person_breathing"))
    assert not any(track.approaching for message in messages for track in message.tracks)
    assert {message.level for message in messages} <= {"SAFE", "CAUTION"}  # 0.35 m: very close, whatever its speed
    nearest = [message.tracks[0].range_m for message in messages if message.tracks]
    assert len(nearest) > 200  # the chest moves, so the person is seen, and stands
    assert np.median(nearest) == pytest.approx(0.35, abs=0.06)


def test_a_hand_goes_to_and_fro_at_up_to_1_2_mps() -> None:
    _, messages, detections, _ = run(recording("moving_hand_first_half"))
    quiet = [d for frame in detections[:12] for d in frame if abs(d.velocity_mps) > 0.15]
    assert quiet == []
    hand = [
        d.velocity_mps for frame in detections[12:] for d in frame if d.range_m < 0.6 and abs(d.velocity_mps) > 0.15
    ]
    assert len(hand) > 12
    assert 1.0 < max(np.abs(hand)) < 1.5
    signs = np.sign(hand)
    assert np.count_nonzero(signs[1:] != signs[:-1]) >= 2
    assert any(message.level == "IMMINENT" for message in messages[20:])
    speeds = [abs(track.velocity_mps) for message in messages for track in message.tracks]
    assert max(speeds) < 2.0  # nothing that stands is taken for its alias of 4.2 m/s
    assert all(track.azimuth_rad is None for message in messages for track in message.tracks)  # RX2 and RX3 only


def test_receivers_noise_and_samples_are_plausible() -> None:
    """Real samples sit about mid-scale, never clip, and every receiver has the same order of noise."""
    for name in ("two_reflectors", "seated_person_breathing", "moving_hand_first_half"):
        recorded = recording(name)
        assert 1500 < float(np.mean(recorded.frames)) < 2600
        _, messages, _, _ = run(first_frames(recorded, 20))
        assert -10.0 < messages[-1].noise_floor_db < 40.0
        assert messages[-1].state == "online"


def first_frames(recorded: Recording, count: int) -> Recording:
    return Recording(recorded.waveform, recorded.stamps_ns[:count], recorded.frames[:count])
