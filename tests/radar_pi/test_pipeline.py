"""The whole signal path on simulated chirps: accuracy, sign, one id, levels, silence on noise, health."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.radar.radar_accuracy import Truth, accuracy, approach, settled_pipeline, tracks_on_noise
from common.codec import decode, encode
from common.messages import Motion, RadarDetections, RadarTracks
from common.topics import RADAR_DETECTIONS, RADAR_TRACKS
from services.radar_pi.config import CfarConfig, ProcessingConfig, RadarConfig
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.pipeline import RadarPipeline
from spotter_sim.bgt60 import LEAKAGE, Target, simulate

CONFIG = RadarConfig()
SHAPE = simulator_waveform(CONFIG.waveform)
PERIOD_NS = 100_000_000


def empty(seed: int) -> np.ndarray:
    return simulate(LEAKAGE, SHAPE, seed=seed)


@pytest.mark.parametrize("kind", ["ca", "os"])
def test_accuracy_over_the_field_of_view(kind: str) -> None:
    """Range 0.3 to 6 m, +-4 m/s, +-40 degrees, cell SNR from 20 dB."""
    errors = accuracy(60, seed=3, config=RadarConfig(cfar=CfarConfig(kind=kind)))  # type: ignore[arg-type]
    assert np.all(errors["tracks"] == 1)
    assert not errors["wrong_sign"].any()
    assert np.percentile(np.abs(errors["range_m"]), 95) < 0.01
    assert np.percentile(np.abs(errors["velocity_mps"]), 95) < 0.02
    assert np.percentile(np.abs(errors["azimuth_deg"]), 95) < 3.0
    assert np.percentile(np.abs(errors["ttc_fraction"]), 95) < 0.02
    assert abs(np.mean(errors["range_m"])) < 0.002  # no bias from motion during the frame
    assert abs(np.mean(errors["velocity_mps"])) < 0.003


@pytest.mark.parametrize("offset_rad", [0.0, 0.6])
def test_the_phase_offset_of_the_pair_is_subtracted(offset_rad: float) -> None:
    azimuth = msgspec.structs.replace(CONFIG.azimuth, phase_offset_rad=offset_rad)
    pipeline, start_ns = settled_pipeline(RadarConfig(azimuth=azimuth))
    track = approach(pipeline, start_ns, Truth(3.0, -1.0, 0.2, 35.0), 5, seed=1)[-1].tracks[0]
    shift = offset_rad * pipeline.axes.wavelength_m / (2 * np.pi * azimuth.spacing_m)
    assert track.azimuth_rad == pytest.approx(np.arcsin(np.sin(0.2) - shift), abs=0.02)


def test_time_to_collision_counts_down_and_levels_rise() -> None:
    pipeline, start_ns = settled_pipeline(CONFIG)
    messages = approach(pipeline, start_ns, Truth(0.4, -1.4, 0.1, 35.0), 38, seed=2)
    levels = [message.level for message in messages]
    assert [level for i, level in enumerate(levels) if i == 0 or level != levels[i - 1]] == [
        "SAFE", "CAUTION", "IMMINENT",
    ]  # fmt: skip
    ttc = [message.tracks[0].ttc_s for message in messages[3:]]
    assert all(value is not None for value in ttc)
    assert np.all(np.diff(np.array(ttc, float)) < 0)


def test_a_receding_body_never_alarms() -> None:
    pipeline, start_ns = settled_pipeline(CONFIG)
    messages = approach(pipeline, start_ns, Truth(4.0, 1.4, 0.0, 35.0), 26, seed=4)
    assert {message.level for message in messages} == {"SAFE"}
    assert messages[-1].tracks[0].velocity_mps > 1.0


def test_noise_makes_no_track() -> None:
    assert tracks_on_noise(400, seed=5) == (0, 0)


@pytest.mark.slow
def test_ten_thousand_frames_of_noise_make_no_track() -> None:
    tracks, _ = tracks_on_noise(10_000, seed=6)
    assert tracks == 0


def test_what_stands_from_the_beginning_is_forgotten() -> None:
    pipeline = RadarPipeline(CONFIG)
    scene = [*LEAKAGE, Target(2.0, amplitude_lsb=400.0), Target(4.0, azimuth_rad=0.3, amplitude_lsb=900.0)]
    for i in range(20):
        message = pipeline.process(i * PERIOD_NS, simulate(scene, SHAPE, seed=i))
    assert message.tracks == []


def test_a_body_that_appears_and_stands_is_static_and_silent() -> None:
    pipeline, start_ns = settled_pipeline(CONFIG)
    for i in range(8):
        scene = [*LEAKAGE, Target(1.0, amplitude_lsb=100.0)]
        message = pipeline.process(start_ns + i * PERIOD_NS, simulate(scene, SHAPE, seed=i))
    assert len(message.tracks) == 1
    assert (message.level, message.static_level) == ("SAFE", "CAUTION")
    assert not message.tracks[0].moving


def test_settling_is_reported_and_over_after_fifteen_frames() -> None:
    pipeline = RadarPipeline(CONFIG)
    messages = [pipeline.process(i * PERIOD_NS, empty(i)) for i in range(17)]
    assert [message.settled for message in messages] == [False] * 15 + [True] * 2
    assert [message.state for message in messages] == ["degraded"] * 15 + ["online"] * 2
    assert messages[0].reason == "settling: the background is not learned yet"


@pytest.mark.parametrize("cause", ["epoch", "gap", "clock"])
def test_after_a_restart_the_background_settles_again(cause: str) -> None:
    pipeline, start_ns = settled_pipeline(CONFIG)
    stamp_ns = {"epoch": start_ns, "gap": start_ns + 10 * PERIOD_NS, "clock": 0}[cause]
    message = pipeline.process(stamp_ns, empty(0), None, 1 if cause == "epoch" else 0)
    assert not message.settled
    assert message.state == "degraded"


def test_an_alarm_lives_through_a_restart_of_the_chip() -> None:
    pipeline, start_ns = settled_pipeline(CONFIG)
    for i in range(12):
        scene = [*LEAKAGE, Target(2.2 - 0.14 * i, -1.4, amplitude_lsb=300.0)]
        frame = simulate(scene, SHAPE, seed=i)
        message = pipeline.process(start_ns + i * PERIOD_NS, frame, None, epoch=0 if i < 8 else 1)
    assert (message.level, message.settled, message.state) == ("IMMINENT", False, "degraded")
    assert [track.track_id for track in message.tracks] == [1]


def test_a_few_lost_frames_are_no_restart() -> None:
    pipeline, start_ns = settled_pipeline(CONFIG)
    assert pipeline.process(start_ns + 3 * PERIOD_NS, empty(0)).settled


def test_the_drivers_note_reaches_the_message() -> None:
    pipeline, start_ns = settled_pipeline(CONFIG)
    message = pipeline.process(start_ns, empty(0), note="interrupt line is dead: polling")
    assert (message.state, message.reason) == ("degraded", "interrupt line is dead: polling")


def test_a_covered_antenna_and_a_lost_transmitter_are_noticed() -> None:
    for change, word in ((6.0, "covered"), (0.02, "detuned")):
        config = RadarConfig(health=msgspec.structs.replace(CONFIG.health, learn_frames=10, hold_frames=5))
        pipeline = RadarPipeline(config)
        for i in range(26):
            assert pipeline.process(i * PERIOD_NS, empty(i)).state == ("degraded" if i < 15 else "online")
        changed = [Target(t.range_m, amplitude_lsb=change * t.amplitude_lsb) for t in LEAKAGE]
        for i in range(26, 60):
            message = pipeline.process(i * PERIOD_NS, simulate(changed, SHAPE, seed=i))
        assert message.state == "degraded"
        assert word in message.reason


def test_a_saturated_receiver_is_noticed_and_still_alarms() -> None:
    health = msgspec.structs.replace(CONFIG.health, saturated_frames=5)
    pipeline, start_ns = settled_pipeline(RadarConfig(health=health))
    for i in range(20):
        scene = [*LEAKAGE, Target(2.6 - 0.1 * i, -1.0, amplitude_lsb=6000.0)]
        message = pipeline.process(start_ns + i * PERIOD_NS, simulate(scene, SHAPE, seed=i))
    assert "saturated" in message.reason
    assert message.level == "IMMINENT"


def test_ego_speed_tells_a_wall_from_a_walker() -> None:
    for motion, moving in ((Motion(1.0), False), (None, True), (Motion(0.0), True)):
        pipeline, start_ns = settled_pipeline(CONFIG)
        for i in range(6):
            scene = [*LEAKAGE, Target(3.0 - 0.1 * i, -1.0, amplitude_lsb=300.0)]
            message = pipeline.process(start_ns + i * PERIOD_NS, simulate(scene, SHAPE, seed=i), motion)
        assert message.tracks[0].moving is moving
        assert message.tracks[0].approaching


def test_messages_pass_the_codec_and_publish_the_limits() -> None:
    pipeline, start_ns = settled_pipeline(CONFIG)
    message = approach(pipeline, start_ns, Truth(2.0, -1.0, 0.2, 35.0), 5, seed=1)[-1]
    again = decode(encode(message), RadarTracks, RADAR_TRACKS.max_bytes)
    assert again.tracks[0].track_id == message.tracks[0].track_id
    assert again.v_max_mps == pytest.approx(5.15, abs=0.01)
    assert (again.range_min_m, again.range_max_m) == pytest.approx((0.236, 6.485), abs=0.01)
    detections = decode(encode(pipeline.detections()), RadarDetections, RADAR_DETECTIONS.max_bytes)
    assert detections.detections[0].range_m == pytest.approx(2.0, abs=0.05)
    row, column = np.unravel_index(detections.range_doppler_db.argmax(), detections.range_doppler_db.shape)
    assert detections.range_axis_m[row] == pytest.approx(2.0, abs=0.12)
    assert detections.velocity_axis_mps[column] == pytest.approx(-1.0, abs=0.16)


def test_detections_before_the_first_frame_are_refused() -> None:
    with pytest.raises(RuntimeError, match="no radar frame"):
        RadarPipeline(CONFIG).detections()


def test_the_same_frames_give_the_same_messages() -> None:
    def levels() -> list[tuple[float, ...]]:
        pipeline, start_ns = settled_pipeline(CONFIG)
        messages = approach(pipeline, start_ns, Truth(1.0, -1.2, 0.1, 30.0), 8, seed=9)
        return [(track.range_m, track.velocity_mps, track.snr_db) for message in messages for track in message.tracks]

    assert levels() == levels()


@settings(deadline=None, max_examples=15)
@given(
    st.integers(2, 40), st.integers(32, 128), st.sampled_from([1, 2, 4, 5, 6, 7]), st.integers(0, 4095),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_any_frame_of_any_waveform_gives_a_message(chirps: int, samples: int, mask: int, value: int, seed: int) -> None:
    """Constant, random and clipped samples, few chirps, one receiver: a valid message or none at all, never a crash."""
    waveform = msgspec.structs.replace(CONFIG.waveform, chirps=chirps, samples=samples, rx_mask=mask)
    config = RadarConfig(waveform=waveform, processing=ProcessingConfig(range_max_m=50.0))
    pipeline = RadarPipeline(config)
    shape = (len(waveform.rx), chirps, samples)
    rng = np.random.default_rng(seed)
    for i, frame in enumerate((np.full(shape, value), rng.integers(0, 4096, shape), rng.choice([0, 4095], shape))):
        message = pipeline.process(i * PERIOD_NS, frame.astype(np.uint16))
        decode(encode(message), RadarTracks, RADAR_TRACKS.max_bytes)
