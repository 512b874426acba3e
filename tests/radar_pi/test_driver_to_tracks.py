"""From the wire to tracks: the emulated chip looks at the simulated world, the real pipeline looks at its frames."""

from __future__ import annotations

from contextlib import closing

import pytest

from common.bus.status import Report
from common.messages import RadarTracks
from services.radar_pi.chip.driver import Driver
from services.radar_pi.chip.exports import plan
from services.radar_pi.config import RadarConfig
from services.radar_pi.emulator import signals
from services.radar_pi.emulator.emulator import EmulatedChip
from services.radar_pi.emulator.manual_clock import START_S
from services.radar_pi.pipeline import RadarPipeline


def _watch(clock, chip: EmulatedChip, seconds: float) -> list[RadarTracks]:
    config = RadarConfig()
    what = plan(config.waveform)
    pipeline = RadarPipeline(RadarConfig(waveform=what.waveform))
    results = []
    with closing(Driver(chip, clock, what, config.spi.speed_hz, Report("test")).frames()) as frames:
        for frame in frames:
            results.append(pipeline.process(frame.stamp_ns, frame.samples, None, frame.epoch, frame.note))
            if clock.now_s > START_S + seconds:
                return results
    return results


def test_the_crossing_is_seen_through_the_chip(clock) -> None:
    results = _watch(clock, EmulatedChip(clock, signals.world("crossing"), 50_000_000), 8.0)
    assert len(results) == pytest.approx(8.0 / plan(RadarConfig().waveform).timing.frame_period_s, abs=2)
    assert any(track.moving for result in results for track in result.tracks)
    assert not results[0].settled
    assert results[-1].settled


@pytest.mark.parametrize(("fault", "resets"), [("overflow", True), ("clock_error", True), ("lost_words", False)])
def test_a_restart_of_the_chip_starts_the_background_again(clock, chip, fault: str, resets: bool) -> None:
    clock.at(2.5299, lambda: chip.inject(fault))  # while chirping
    settled = [result.settled for result in _watch(clock, chip, 3.0)]
    first = settled.index(True)
    assert (False in settled[first:]) == resets


def test_a_dead_interrupt_degrades_the_radar_with_the_reason(clock, chip) -> None:
    chip.inject("dead_irq")
    last = _watch(clock, chip, 3.0)[-1]
    assert last.state == "degraded"
    assert "interrupt line" in last.reason
