"""Random sequences of faults, random moments, random reader: what is delivered is always what was measured."""

from __future__ import annotations

from contextlib import closing

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from common.bus.status import Report
from services.radar_pi.chip.driver import Driver
from services.radar_pi.chip.exports import plan
from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulator.emulator import EmulatedChip
from services.radar_pi.emulator.manual_clock import START_S, ManualClock

SMALL = plan(WaveformConfig(samples=32, chirps=16, sample_rate_hz=2e6, chirp_period_s=0.15e-3, frame_period_s=0.01))
EVENTS = ("overflow", "underflow", "clock_error", "burst_error", "lost_words", "power_cycle")
LASTING = ("dead_irq", "stuck_irq")
LENGTH_S = 0.4

moments = st.floats(0.03, LENGTH_S)
events = st.lists(st.tuples(moments, st.sampled_from(EVENTS)), max_size=8)
lasting = st.lists(st.tuples(moments, st.sampled_from(LASTING), st.floats(0.001, 0.3)), max_size=2)
pauses = st.lists(st.tuples(st.integers(1, 30), st.floats(0.0, 0.1)), max_size=3)


class Marked:
    """Random frames, each with its number as the first sample; all are kept."""

    def __init__(self) -> None:
        self.measured: list[np.ndarray] = []
        self._rng = np.random.default_rng(7)

    def __call__(self, t_s: float, waveform: WaveformConfig) -> np.ndarray:
        shape = (len(waveform.rx), waveform.chirps, waveform.samples)
        frame = self._rng.integers(1, 4096, shape, np.uint16)
        frame[0, 0, 0] = len(self.measured) + 1
        self.measured.append(frame)
        return frame

    def knows(self, samples: np.ndarray) -> bool:
        return np.array_equal(samples, self.measured[int(samples[0, 0, 0]) - 1])


def _schedule(clock, chip: EmulatedChip, events, lasting) -> None:
    for at_s, fault in events:
        clock.at(at_s, lambda fault=fault: chip.inject(fault))
    for at_s, fault, length_s in lasting:
        clock.at(at_s, lambda fault=fault: chip.inject(fault))
        clock.at(at_s + length_s, lambda fault=fault: chip.heal(fault))


@settings(max_examples=40, deadline=None)
@given(events, lasting, pauses)
@example([(0.25, "clock_error"), (0.2265625, "power_cycle"), (0.09375, "power_cycle")], [], [])  # in the self-test
def test_random_faults_never_damage_a_frame_and_never_stop_the_stream(events, lasting, pauses) -> None:
    clock = ManualClock()
    signal, report = Marked(), Report("stress")
    chip = EmulatedChip(clock, signal, speed_hz=50_000_000)
    _schedule(clock, chip, events, lasting)
    slow = dict(pauses)
    stamp_ns = epoch = 0
    with closing(Driver(chip, clock, SMALL, 50_000_000, report).frames()) as frames:
        for number, frame in enumerate(frames):
            assert signal.knows(frame.samples)
            assert frame.epoch >= epoch
            assert frame.stamp_ns > stamp_ns
            assert 0 < frame.received_ns - frame.stamp_ns < 0.3e9
            stamp_ns, epoch = frame.stamp_ns, frame.epoch
            if clock.now_s > START_S + LENGTH_S + 1.2:
                break
            clock.sleep(slow.get(number, 0.0))
    assert not frame.note  # every fault is over, and so is every note
    assert epoch - 1 <= sum(n for name, n in report.snapshot().counters.items() if name != "lost_words")


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(0.04, 0.08), st.sampled_from(EVENTS)), min_size=1, max_size=6))
def test_after_a_volley_of_faults_frames_flow_again_within_half_a_second(events) -> None:
    clock = ManualClock()
    chip = EmulatedChip(clock, Marked(), speed_hz=50_000_000)
    _schedule(clock, chip, events, [])
    last_s = START_S + max(at_s for at_s, _ in events)
    with closing(Driver(chip, clock, SMALL, 50_000_000, Report("stress")).frames()) as frames:
        while clock.now_s <= last_s:
            next(frames)
    assert clock.now_s - last_s < 0.5
