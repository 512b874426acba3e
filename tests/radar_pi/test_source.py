"""Sources: the same frames come through the same door, at their pace, with their own waveform."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from common import clock as clocks
from common import pacing
from common.bus.status import Report
from common.config import ConfigError, load
from services.radar_pi import source
from services.radar_pi.config import RadarConfig, WaveformConfig
from services.radar_pi.emulator import signals
from services.radar_pi.recording import Recorder
from services.radar_pi.source import open_source, with_waveform_of_source
from spotter_sim import scenario_clock

WAVEFORM = WaveformConfig(chirps=4, samples=32, frame_period_s=0.02)


class ManualTime:
    """Stands in for the clock and for sleeping: sleeping is what makes time pass."""

    def __init__(self) -> None:
        self.now_s = 50.0

    def monotonic_s(self) -> float:
        return self.now_s

    def utc_ns(self) -> int:
        return 1_700_000_000_000_000_000 + round(self.now_s * 1e9)

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> ManualTime:
    manual = ManualTime()
    for module in (clocks, pacing, scenario_clock, source):
        monkeypatch.setattr(module, "monotonic_s", manual.monotonic_s)
    for module in (clocks, scenario_clock, source):
        monkeypatch.setattr(module, "utc_ns", manual.utc_ns)
    monkeypatch.setattr(pacing, "time", SimpleNamespace(sleep=manual.sleep))  # other threads sleep on
    return manual


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "a.radar"
    with Recorder(path, WAVEFORM) as recorder:
        for i in range(5):
            recorder.write(10_000_000_000 + i * 20_000_000, 0, np.full((3, 4, 32), i, np.uint16))
    return path


def config(text: str) -> RadarConfig:
    return load(RadarConfig, None, [f'source="{text}"'])


def test_a_recording_is_played_at_its_pace_with_stamps_of_now(clock: ManualTime, recording: Path) -> None:
    start_s, start_ns = clock.now_s, clock.utc_ns()
    played = list(open_source(config(f"file:{recording}"), Report("t")))
    assert [int(frame.samples[0, 0, 0]) for frame in played] == [0, 1, 2, 3, 4]
    assert [frame.stamp_ns - start_ns for frame in played] == [i * 20_000_000 for i in range(5)]
    assert clock.now_s - start_s == pytest.approx(0.08)


@pytest.mark.parametrize(("set_by_s", "expected_s"), [(1.7e9, 10.06), (-1.7e9, 0.08)])
def test_a_recording_in_which_the_clock_was_set_does_not_stand_still_for_years(
    clock: ManualTime, tmp_path: Path, set_by_s: float, expected_s: float
) -> None:
    with Recorder(tmp_path / "a.radar", WAVEFORM) as recorder:
        for i in range(5):
            stamp_ns = 2_000_000_000_000_000_000 + i * 20_000_000 + (round(set_by_s * 1e9) if i > 2 else 0)
            recorder.write(stamp_ns, 0, np.full((3, 4, 32), i, np.uint16))
    start_s = clock.now_s
    played = list(open_source(config(f"file:{tmp_path / 'a.radar'}"), Report("t")))
    assert clock.now_s - start_s == pytest.approx(expected_s)
    assert (np.diff([frame.stamp_ns for frame in played]) > 0).all()


@pytest.mark.parametrize(("rate", "expected_s"), [("2", 0.04), ("0.5", 0.16), ("0", 0.0)])
def test_rate_scales_the_pace(clock: ManualTime, recording: Path, rate: str, expected_s: float) -> None:
    start_s = clock.now_s
    assert len(list(open_source(config(f"file:{recording}?rate={rate}"), Report("t")))) == 5
    assert clock.now_s - start_s == pytest.approx(expected_s)


def test_a_loop_goes_on_in_time_and_in_a_new_epoch(clock: ManualTime, recording: Path) -> None:
    played = list(islice(open_source(config(f"file:{recording}?loop=1"), Report("t")), 12))
    assert np.diff([frame.stamp_ns for frame in played]).tolist() == [20_000_000] * 11
    assert [frame.epoch for frame in played] == [0] * 5 + [1] * 5 + [2] * 2


def test_a_recordings_waveform_replaces_the_configured_one(recording: Path) -> None:
    assert with_waveform_of_source(config(f"file:{recording}")).waveform == WAVEFORM
    assert with_waveform_of_source(config("sim:crossing")).waveform == WaveformConfig()


def test_the_chips_waveform_is_the_quantised_one() -> None:
    real = with_waveform_of_source(config("spi:emulator")).waveform
    assert real.chirp_period_s == pytest.approx(0.24e-3, rel=1e-3)
    assert real.end_frequency_hz == pytest.approx(61.31e9, rel=1e-4)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("file:/nowhere/a.radar", "No such file"),
        ("sim:nothing", "no scenario 'nothing'; known: crossing"),
        ("serial:/dev/x", "expected one of"),
        ("sim:crossing?speed=2", "no parameter 'speed'"),
    ],
)
def test_a_wrong_source_is_refused_with_a_reason(text: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        open_source(config(text), Report("t"))


def test_the_simulated_world_comes_at_the_frame_rate(clock: ManualTime) -> None:
    start_s = clock.now_s
    frames = list(islice(open_source(config("sim:crossing?t0=3"), Report("t")), 4))
    assert np.diff([frame.stamp_ns for frame in frames]).tolist() == [100_000_000] * 3
    assert clock.now_s - start_s == pytest.approx(0.3)
    assert frames[0].samples.shape == (3, 64, 128)
    assert frames[0].samples.dtype == np.uint16


def test_a_slow_reader_gets_newer_frames_and_the_rest_is_counted(clock: ManualTime) -> None:
    report = Report("t")
    frames = open_source(config("sim:crossing?t0=3"), report)
    first = next(frames)
    clock.sleep(0.75)
    later = next(frames)
    assert later.stamp_ns - first.stamp_ns == 700_000_000
    assert report.snapshot().dropped == 6


@pytest.mark.parametrize(("t0", "word"), [("50", "unplugged"), ("41", "no frame")])
def test_an_unplugged_or_silent_radar_is_disconnected_and_comes_back(clock: ManualTime, t0: str, word: str) -> None:
    report = Report("t")
    frame = next(open_source(config(f"sim:faults?t0={t0}"), report))
    assert frame.samples.shape == (3, 64, 128)
    snapshot = report.snapshot()
    assert snapshot.state == "disconnected"
    assert word in snapshot.reason
    assert clock.now_s - 50.0 == pytest.approx(4.0, abs=0.2)  # both faults of the scenario end at 54 s and 45 s


def test_waveforms_for_simulator_and_axes_agree() -> None:
    sampled = signals.simulator_waveform(msgspec.structs.replace(WaveformConfig(), rx_mask=5))
    assert sampled.rx == (1, 3)
    assert sampled.slope_hz_per_s == pytest.approx(12.4156e12, rel=1e-4)
