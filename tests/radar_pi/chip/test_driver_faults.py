"""The driver and a chip, a link or a reader that fail: what is told, how soon frames flow again."""

from __future__ import annotations

import itertools
from contextlib import closing

import numpy as np
import pytest

from common.config import ConfigError
from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.chip import RadarFault
from services.radar_pi.chip.driver import Driver
from services.radar_pi.chip.exports import plan
from services.radar_pi.config import RadarConfig, WaveformConfig
from services.radar_pi.emulator.emulator import EmulatedChip
from services.radar_pi.spi_source import keep_open, link_opener, open_spi

DEFAULT = plan(WaveformConfig())
SPEED_HZ = 50_000_000
TRANSIENT = {  # fault -> name under which it is counted, cure named in the status
    "overflow": ("fifo_overflow", "fifo reset"),
    "underflow": ("fifo_underflow", "fifo reset"),
    "clock_error": ("clock_error", "software reset"),
    "burst_error": ("burst_error", "software reset"),
    "power_cycle": ("stalled", "hardware reset"),
}


@pytest.fixture
def chip(numbered_chip):
    """Each of its frames can be told apart."""
    return numbered_chip


@pytest.mark.parametrize("fault", TRANSIENT)
@pytest.mark.parametrize("at_s", [0.16, 0.22655, 0.2333, 0.2409, 0.2419])
def test_after_a_transient_fault_frames_flow_again_within_half_a_second(
    frames, chip, clock, report, signal, fault: str, at_s: float
) -> None:
    """The moments lie in the pause between frames and in the middle of chirping."""
    name, cure = TRANSIENT[fault]
    first = next(frames)
    clock.at(at_s, lambda: chip.inject(fault))
    hit_ns = clock.utc_ns() - round((clock.now_s - 1000.0 - at_s) * 1e9)
    after = next(f for f in frames if f.epoch > first.epoch)
    assert 0 < clock.utc_ns() - hit_ns < 0.5e9
    assert after.epoch == first.epoch + 1  # the background model is void
    status = report.snapshot()
    assert status.counters[name] == 1
    assert status.state == "degraded"
    assert cure in status.reason
    assert "clutter background starts again" in status.reason
    for frame in (after, *itertools.islice(frames, 3)):
        assert np.array_equal(frame.samples, signal.measured[int(frame.samples[0, 0, 0])][1])
        assert frame.epoch == after.epoch


@pytest.mark.parametrize("at_s", [0.2285, 0.233, 0.2371, 0.2412])
def test_lost_words_cost_one_frame_and_no_restart(frames, chip, clock, report, signal, at_s: float) -> None:
    seen = [next(frames)]
    clock.at(at_s, lambda: chip.inject("lost_words"))
    seen += itertools.islice(frames, 8)
    assert {frame.epoch for frame in seen} == {1}
    assert all(np.array_equal(f.samples, signal.measured[int(f.samples[0, 0, 0])][1]) for f in seen)
    status = report.snapshot()
    assert status.dropped == 1
    assert status.counters["lost_words"] == 12480 - 7
    periods = np.diff([f.stamp_ns for f in seen]) / (DEFAULT.timing.frame_period_s * 1e9)
    assert sorted(np.round(periods, 3)) == [1.0] * 7 + [2.0]


@pytest.mark.parametrize("fault", ["dead_irq", "stuck_irq"])
def test_a_dead_interrupt_is_polled_around_and_reported(frames, chip, clock, report, fault: str) -> None:
    next(frames)
    clock.at(0.2, lambda: chip.inject(fault))
    polled = [frame for frame in itertools.islice(frames, 12) if frame.note]
    assert len(polled) >= 8
    assert polled[-1].note == "interrupt line is not to be trusted: polling; check [spi] irq_gpio"
    lasts_ns = [f.received_ns - f.stamp_ns - DEFAULT.timing.first_chirp_to_end_s * 1e9 for f in polled]
    assert max(lasts_ns) < 5e6
    assert report.snapshot().dropped == 0
    chip.heal(fault)
    assert any(not frame.note for frame in itertools.islice(frames, 10))  # trusted again


def test_an_interrupt_that_is_dead_from_the_start(chip, clock, report) -> None:
    chip.inject("dead_irq")
    with closing(Driver(chip, clock, DEFAULT, SPEED_HZ, report).frames()) as frames:
        notes = [frame.note for frame in itertools.islice(frames, 3)]
    assert "not to be trusted" in notes[-1]
    assert report.snapshot().counters == {}


def test_polling_does_not_hammer_the_bus(chip, clock, report, wire_class) -> None:
    wire = wire_class(chip)
    chip.inject("dead_irq")
    with closing(Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames()) as frames:
        next(frames)
        before = len(wire.log)
        next(frames)
    assert len(wire.log) - before < 13 * 3 + 5  # burst, FSTAT and perhaps one look too early


@pytest.mark.parametrize("pause_s", [0.02, 0.06, 0.15, 2.0])
def test_a_slow_reader_gets_true_stamps_and_fresh_frames(frames, chip, clock, report, signal, pause_s: float) -> None:
    """After 20 and 60 ms nothing is lost; later the FIFO overflows, and what follows is new."""
    next(frames)
    clock.sleep(pause_s)
    resumed_ns = clock.utc_ns()
    frame = next(frames)
    t_s, samples = signal.measured[int(frame.samples[0, 0, 0])]
    assert np.array_equal(frame.samples, samples)
    assert frame.stamp_ns == pytest.approx(t_s * 1e9, abs=1e5)
    assert clock.utc_ns() - resumed_ns < 0.5e9
    assert frame.received_ns - frame.stamp_ns < 0.1e9
    overflowed = report.snapshot().counters.get("fifo_overflow", 0)
    assert overflowed == (0 if pause_s < 0.09 else 1)
    assert frame.epoch == 1 + overflowed


def test_a_reader_that_is_always_too_slow_still_gets_frames(frames, clock, report) -> None:
    for frame in itertools.islice(frames, 6):
        assert frame.received_ns - frame.stamp_ns < 0.05e9  # never an old one
        clock.sleep(0.3)
    assert report.snapshot().counters["fifo_overflow"] == 5


def test_a_fault_that_no_cure_ends_is_handed_up(chip, clock, report, wire_class) -> None:
    def broken(sent: bytes, reply: bytes) -> bytes:
        """A burst error, whatever is done."""
        if sent[:4] == reg.burst_command() and len(sent) > 800:
            chip.inject("burst_error")
            return bytes([0xF2]) + reply[1:]
        return reply

    wire = wire_class(chip, broken)
    with pytest.raises(RadarFault, match="SPI burst error"):
        next(Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames())
    assert wire.log.count("reset") >= 4  # hardware resets were tried
    assert wire.log[-1] == "close"


# --- keep open --------------------------------------------------------------------------------------------------------


def test_a_chip_that_goes_and_comes_back(chip, clock, report, signal) -> None:
    frames = keep_open(lambda: chip, clock, DEFAULT, SPEED_HZ, report)
    states = []
    first = next(frames)
    clock.at(0.25, lambda: chip.inject("unplugged"))
    clock.at(2.0, lambda: states.append(report.snapshot()))
    clock.at(3.0, lambda: chip.heal("unplugged"))
    back = next(frame for frame in frames if frame.epoch > first.epoch)
    (away,) = states
    assert away.state == "disconnected"
    assert "expected chip id 0x000303" in away.reason
    assert "next try in" in away.reason
    assert 3.0 < clock.now_s - 1000.0 < 6.0  # bounded back-off
    assert np.array_equal(back.samples, signal.measured[int(back.samples[0, 0, 0])][1])
    frames.close()


def test_a_wrong_chip_is_reported_and_never_read(chip, clock, report, wire_class) -> None:
    chip.inject("wrong_chip")
    wire = wire_class(chip)
    frames = keep_open(lambda: wire, clock, DEFAULT, SPEED_HZ, report)
    clock.at(30.0, lambda: chip.heal("wrong_chip"))
    clock.at(29.0, lambda: wire.log.append(report.snapshot().reason))
    next(frames)
    reason = next(entry for entry in wire.log if "expected" in entry)
    assert "found 0x000606" in reason
    assert "ffc00000" not in wire.log[: wire.log.index(reason)]
    frames.close()


def test_a_bus_that_cannot_be_opened_is_tried_again(chip, clock, report) -> None:
    failures = iter([PermissionError(13, "not in group spi"), FileNotFoundError(2, "no /dev/spidev0.0")])

    def opened() -> EmulatedChip:
        for failure in failures:
            raise failure
        return chip

    frames = keep_open(opened, clock, DEFAULT, SPEED_HZ, report)
    assert next(frames).epoch == 1
    assert report.snapshot().counters["bus_lost"] == 2
    assert "no /dev/spidev0.0" in report.snapshot().reason
    frames.close()


@pytest.mark.parametrize("target", ["0", "a.b", "emulator/nowhere", "0.0.0"])
def test_a_target_that_is_none_is_refused(target: str, report) -> None:
    with pytest.raises(ConfigError, match="source spi:"):
        open_spi(target, RadarConfig(), report)


def test_the_emulator_as_a_source_on_the_machines_clock(report) -> None:
    """A fast small waveform: two frames in real time, from the simulated world."""
    waveform = WaveformConfig(samples=64, chirps=16, sample_rate_hz=2e6, chirp_period_s=0.2e-3, frame_period_s=0.02)
    frames = open_spi("emulator", RadarConfig(waveform=waveform), report)
    with closing(frames):  # type: ignore[type-var]
        first, second = next(frames), next(frames)
    assert first.samples.shape == (3, 16, 64)
    assert second.stamp_ns > first.stamp_ns


def test_hardware_without_its_libraries_says_which_extra(clock) -> None:
    try:
        import spidev  # noqa: F401
    except ImportError:
        with pytest.raises(OSError, match="install the extra radar-hw"):
            link_opener("0.0", RadarConfig().spi, clock)()
    else:
        pytest.skip("spidev is installed here")
