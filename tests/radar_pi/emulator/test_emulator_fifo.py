"""The emulated chip's FIFO: when words appear, what they hold, overflow and underflow, injected faults."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.exports import plan
from services.radar_pi.chip.packing import lfsr_sequence, pack_frame, unpack_words
from services.radar_pi.chip.registers import Fstat, Gsr0, Register
from services.radar_pi.chip.schedule import WordSchedule
from services.radar_pi.chip.waveform import CLOCK_HZ
from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulator import signals
from services.radar_pi.emulator.emulator import FAULTS, EmulatedChip

SMALL = WaveformConfig(samples=32, chirps=8, sample_rate_hz=2e6, chirp_period_s=0.2e-3, frame_period_s=5e-3)
FAST = 8 * 4 / 50e6  # one register access


@pytest.fixture
def chip(probed_chip):
    """Transfers take no time, so that every moment is exact."""
    return probed_chip


def _ready_slowly(waveform: WaveformConfig, words: int) -> list[float]:
    """Seconds after FRAME_START of each word, sample by sample."""
    what = plan(waveform)
    t, rx = what.timing, len(what.waveform.rx)
    ready = []
    frame = 0
    while len(ready) < words:
        for chirp in range(t.chirps):
            begin = frame * t.frame + t.wake_up + t.init + chirp * t.chirp + t.first_sample
            ready += [begin] * 3
            halves = 0
            for sample in range(1, t.samples + 1):
                halves += rx
                ready += [begin + sample * t.adc_divider] * (halves // 2)
                halves %= 2
        frame += 1
    return [clocks / CLOCK_HZ for clocks in ready[:words]]


@pytest.mark.parametrize("rx_mask", [1, 5, 7])
def test_words_appear_when_the_timing_formulas_say(chip, clock, rx_mask: int) -> None:
    waveform = msgspec.structs.replace(SMALL, rx_mask=rx_mask)
    schedule = chip.start(waveform)
    started_s = clock.now_s
    for number, due_s in enumerate(_ready_slowly(waveform, 2 * schedule.frame_words), 1):
        assert schedule.ready_s(number) == pytest.approx(due_s, abs=1e-12)
        assert schedule.produced(due_s) >= number > schedule.produced(due_s - 1 / CLOCK_HZ)
    clock.sleep(started_s + schedule.ready_s(100) - clock.now_s)
    assert chip.fill() == schedule.produced(schedule.ready_s(100)) >= 100


def test_first_sample_comes_a_millisecond_after_frame_start(chip) -> None:
    schedule = chip.start()
    assert schedule.ready_s(1) == pytest.approx(1.0567e-3, abs=1e-6)


def test_interrupt_rises_with_the_word_after_the_mark_and_falls_below(chip, clock) -> None:
    schedule = chip.start(mark=99)
    started_s = clock.now_s
    assert not chip.wait_irq(schedule.ready_s(100) - 1e-6)
    assert chip.wait_irq(1.0)
    assert clock.now_s - started_s == pytest.approx(schedule.ready_s(100), abs=1e-9)
    assert chip.read(Register.FSTAT) & Fstat.CREF
    chip.burst(40)
    assert not chip.wait_irq(0.0)
    assert not chip.read(Register.FSTAT) & Fstat.CREF


def test_fifo_burst_on_the_wire(chip, clock) -> None:
    signal = signals.noise(seed=3)
    schedule = chip.start()
    clock.sleep(schedule.ready_s(schedule.frame_words))
    reply = chip.burst(schedule.frame_words)
    assert reply[:4].hex(" ") == "f0 00 00 00"  # SFCTL was written without high speed
    assert reply[4:] == pack_frame(signal(0.0, plan(SMALL).waveform), 0).tobytes()
    assert chip.read(Register.FSTAT) & (Fstat.EMPTY | reg.FSTAT_ERRORS) == Fstat.EMPTY


def test_without_header_there_are_samples_only(chip, clock) -> None:
    schedule = chip.start(header=0)
    clock.sleep(schedule.ready_s(schedule.frame_words))
    frame = signals.noise(seed=3)(0.0, plan(SMALL).waveform)
    assert unpack_words(chip.burst(schedule.frame_words)[4:]).tolist() == frame.transpose(1, 2, 0).ravel().tolist()


def test_test_pattern_replaces_the_first_channel(chip, clock) -> None:
    schedule = chip.start(msgspec.structs.replace(SMALL, rx_mask=1), header=0, lfsr=1)
    clock.sleep(schedule.ready_s(2 * schedule.frame_words))
    got = np.concatenate([unpack_words(chip.burst(schedule.frame_words)[4:]) for _ in range(2)])
    assert np.array_equal(got, lfsr_sequence(2 * 8 * 32))


def test_overflow_puts_the_chip_to_sleep_with_readable_data(chip, clock) -> None:
    schedule = chip.start(msgspec.structs.replace(SMALL, rx_mask=1))  # one word at a time
    started_s = clock.now_s
    clock.sleep(schedule.ready_s(8192))
    assert chip.fill() == 8192
    assert chip.read(Register.FSTAT) & Fstat.FULL
    assert not chip.status() & Gsr0.FIFO_ERROR
    clock.sleep(started_s + schedule.ready_s(8193) - clock.now_s + 1e-8)
    assert chip.read(Register.FSTAT) & Fstat.OVERFLOW
    assert chip.status() & Gsr0.FIFO_ERROR
    assert reg.POWER_MODE.value(chip.read(Register.STAT0)) == 5
    assert len(chip.burst(8192)) == 4 + 3 * 8192
    clock.sleep(1.0)
    assert chip.fill() == 0  # asleep
    assert chip.read(Register.FSTAT) & Fstat.OVERFLOW


def test_fifo_reset_ends_overflow_and_keeps_registers(chip, clock) -> None:
    schedule = chip.start()
    clock.sleep(1.0)
    main = chip.read(Register.MAIN)
    chip.write(Register.MAIN, main | reg.FIFO_RESET.bits(1))
    assert chip.read(Register.FSTAT) & reg.FSTAT_ERRORS == 0
    assert chip.fill() == 0
    chip.write(Register.MAIN, main | reg.FRAME_START.bits(1))
    clock.sleep(schedule.ready_s(50))
    assert chip.fill() >= 50


def test_underflow_reads_ones_and_sets_the_flag(chip, clock) -> None:
    schedule = chip.start()
    clock.sleep(schedule.ready_s(10))
    there = chip.fill()
    samples = unpack_words(chip.burst(there + 5)[4:])
    assert (samples[2 * there :] == 0xFFF).all()
    assert chip.read(Register.FSTAT) & Fstat.UNDERFLOW
    assert chip.status() & Gsr0.FIFO_ERROR


def test_fsm_reset_stops_and_leaves_the_fifo(chip, clock) -> None:
    schedule = chip.start()
    clock.sleep(schedule.ready_s(30))
    there = chip.fill()
    chip.write(Register.MAIN, chip.read(Register.MAIN) | reg.FSM_RESET.bits(1))
    clock.sleep(1.0)
    assert chip.fill() == there


def test_frame_start_needs_the_oscillator_and_is_ignored_while_running(chip, clock) -> None:
    chip.write(Register.MAIN, 0x1E8271)
    clock.sleep(0.1)
    assert chip.fill() == 0
    schedule = chip.start()
    clock.sleep(1.5e-3)
    chip.write(Register.MAIN, chip.read(Register.MAIN) | 1)
    clock.sleep(schedule.ready_s(300) - 1.5e-3)
    assert chip.fill() == schedule.produced(schedule.ready_s(300))


def test_commands_in_main_clear_themselves(chip) -> None:
    chip.write(Register.MAIN, 0x1E827D)
    assert chip.read(Register.MAIN) == 0x1E8270


def test_max_frame_count_ends_the_sequence(chip, clock) -> None:
    what = plan(SMALL)
    for address, value in (what.registers | {Register.SFCTL: reg.PREFIX_EN.bits(1)}).items():
        chip.write(address, value)
    chip.write(Register.CCR2, what.registers[Register.CCR2] | reg.MAX_FRAME_CNT.bits(2))
    chip.write(Register.MAIN, what.registers[Register.MAIN] | 1)
    clock.sleep(1.0)
    assert chip.fill() == 2 * WordSchedule(what.timing, 3).frame_words
    assert not chip.wait_irq(1.0) or chip.fill()


def test_counters_in_stat1(chip, clock) -> None:
    schedule = chip.start()
    clock.sleep(schedule.ready_s(schedule.frame_words + 3 * schedule.chirp_words))
    assert chip.read(Register.STAT1) == 1 << 12 | 3


def test_transfers_take_the_time_of_the_bus(clock) -> None:
    chip = EmulatedChip(clock, signals.silence, speed_hz=50_000_000)
    before_s = clock.now_s
    chip.transfer(reg.burst_command() + bytes(3 * 960))
    assert clock.now_s - before_s == pytest.approx(8 * 2884 / 50e6)


# --- faults and signals ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "flag"),
    [("overflow", Fstat.OVERFLOW), ("underflow", Fstat.UNDERFLOW), ("burst_error", Fstat.BURST_ERROR)],
)
def test_injected_faults_show_where_real_ones_would(chip, clock, fault: str, flag: Fstat) -> None:
    chip.start()
    clock.sleep(2e-3)
    chip.inject(fault)
    assert chip.read(Register.FSTAT) & flag


def test_injected_clock_error_hits_the_next_transfer(chip) -> None:
    chip.inject("clock_error")
    chip.write(Register.CCR2, 0x03F000)
    assert chip.read(Register.CCR2) == 0
    assert chip.read(Register.FSTAT) & Fstat.CLOCK_ERROR


def test_lasting_faults_last_until_healed(chip) -> None:
    chip.inject("wrong_chip")
    assert chip.read(Register.CHIP_ID) != 0x000303
    chip.heal("wrong_chip")
    assert chip.read(Register.CHIP_ID) == 0x000303
    chip.inject("unplugged")
    assert chip.read(Register.CHIP_ID) == 0
    chip.heal("unplugged")
    chip.inject("stuck_irq")
    assert chip.wait_irq(0.0)


def test_an_unknown_fault_is_refused(chip) -> None:
    with pytest.raises(ValueError, match=f"no fault 'fire'; known: {', '.join(FAULTS)}"):
        chip.inject("fire")


@pytest.mark.parametrize("signal", [signals.silence, signals.noise(), signals.world("crossing")])
@pytest.mark.parametrize("rx_mask", [1, 5, 7])
def test_signals_have_the_programmed_shape_and_12_bits(signal: Callable, rx_mask: int) -> None:
    waveform = msgspec.structs.replace(SMALL, rx_mask=rx_mask)
    frame = signal(1_700_000_000.0, waveform)
    assert frame.shape == (len(waveform.rx), 8, 32)
    assert frame.dtype == np.uint16
    assert frame.max() < 4096


def test_an_unknown_scenario_is_refused() -> None:
    with pytest.raises(ValueError, match="nowhere"):
        signals.world("nowhere")
