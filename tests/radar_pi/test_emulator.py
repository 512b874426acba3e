"""The emulated chip on the wire, against the data sheet's rules."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from services.radar_pi import registers as reg
from services.radar_pi import signals
from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulator import FAULTS, EmulatedChip
from services.radar_pi.exports import plan
from services.radar_pi.packing import lfsr_sequence, pack_frame, unpack_words
from services.radar_pi.registers import Fstat, Gsr0, Register
from services.radar_pi.schedule import WordSchedule
from services.radar_pi.waveform import CLOCK_HZ

SMALL = WaveformConfig(samples=32, chirps=8, sample_rate_hz=2e6, chirp_period_s=0.2e-3, frame_period_s=5e-3)
FAST = 8 * 4 / 50e6  # one register access


@pytest.fixture
def chip(clock) -> EmulatedChip:
    """Transfers take no time, so that every moment is exact."""
    return EmulatedChip(clock, signals.noise(seed=3))


def _read(chip: EmulatedChip, register: int) -> int:
    return int.from_bytes(chip.transfer(reg.read_command(register))[1:], "big")


def _write(chip: EmulatedChip, register: int, value: int) -> bytes:
    return chip.transfer(reg.write_command(register, value))


def _status(chip: EmulatedChip) -> Gsr0:
    return Gsr0(chip.transfer(reg.read_command(Register.MAIN))[0] & 0x0F)


def _burst(chip: EmulatedChip, words: int) -> bytes:
    return chip.transfer(reg.burst_command() + bytes(3 * words))


def _start(chip: EmulatedChip, waveform: WaveformConfig = SMALL, mark: int = 8191, **fields: int) -> WordSchedule:
    """Program a waveform and start it, headers on; ``fields`` are further SFCTL bits."""
    what = plan(waveform)
    header = fields.pop("header", 1)
    for address, value in what.registers.items():
        _write(chip, address, value)
    sfctl = reg.FIFO_CREF.bits(mark) | reg.PREFIX_EN.bits(header) | reg.LFSR_EN.bits(fields.pop("lfsr", 0))
    _write(chip, Register.SFCTL, sfctl)
    _write(chip, Register.MAIN, what.registers[Register.MAIN] | 1)
    return WordSchedule(what.timing, len(what.waveform.rx), 3 * header)


def _fill(chip: EmulatedChip) -> int:
    return reg.FILL_STATUS.value(_read(chip, Register.FSTAT))


# --- registers -------------------------------------------------------------------------------------------------------


def test_chip_id_on_the_wire(chip) -> None:
    assert chip.transfer(bytes.fromhex("04000000")).hex(" ") == "f4 00 03 03"


@pytest.mark.parametrize(
    ("register", "value"),
    [("MAIN", 0x1E0000), ("ADC0", 0x0A0240), ("SFCTL", 0x010000), ("PACR2", 0x040014), ("CCR2", 0), ("PLL1_0", 0)],
)
def test_reset_values(chip, register: str, value: int) -> None:
    _write(chip, Register[register], 0x123450)
    _write(chip, Register.MAIN, reg.SW_RESET.bits(1))
    assert _read(chip, Register[register]) == value


def test_every_register_keeps_what_the_driver_writes(chip) -> None:
    for address, value in plan(WaveformConfig()).registers.items():
        _write(chip, address, value)
        assert _read(chip, address) == value


def test_a_write_answers_with_the_content_before_it(chip) -> None:
    assert _write(chip, Register.CCR2, 0x03F000)[1:].hex() == "000000"
    assert _write(chip, Register.CCR2, 0x01F000)[1:].hex() == "03f000"


def test_status_registers_cannot_be_written(chip) -> None:
    for register in (Register.CHIP_ID, Register.STAT0, Register.STAT1, Register.FSTAT):
        before = _read(chip, register)
        _write(chip, register, 0xFFFFFF)
        assert _read(chip, register) == before


def test_high_speed_bit_follows_sfctl_and_is_set_by_reset(chip) -> None:
    assert _status(chip) == Gsr0.HIGH_SPEED
    _write(chip, Register.SFCTL, 0)
    assert _status(chip) == Gsr0(0)
    _write(chip, Register.MAIN, reg.SW_RESET.bits(1))
    assert _status(chip) == Gsr0.HIGH_SPEED


def test_reset_line_restores_everything_and_silences_the_chip(chip) -> None:
    _write(chip, Register.CCR2, 0x03F000)
    chip.set_reset(active=True)
    assert chip.transfer(reg.read_command(Register.CHIP_ID)) == bytes(4)
    chip.set_reset(active=False)
    assert _read(chip, Register.CHIP_ID) == 0x000303
    assert _read(chip, Register.CCR2) == 0


def test_registers_in_bursts(chip) -> None:
    values = bytes.fromhex("0a0210 000000 000000")
    chip.transfer(reg.burst_command(3, Register.ADC0, write=True) + values)
    reply = chip.transfer(reg.burst_command(2, Register.ADC0) + bytes(6))
    assert reply.hex(" ") == "f4 00 00 00 0a 02 10 00 03 03"


# --- clock and burst errors ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("length", [1, 2, 3])
def test_fewer_than_32_clocks_are_ignored_and_an_error(chip, length: int) -> None:
    assert len(chip.transfer(reg.write_command(Register.CCR2, 0x03F000)[:length])) == length
    assert _read(chip, Register.CCR2) == 0
    assert _status(chip) & Gsr0.CLOCK_ERROR
    assert _read(chip, Register.FSTAT) & Fstat.CLOCK_ERROR


def test_more_than_32_clocks_are_an_error_but_the_access_counts(chip) -> None:
    chip.transfer(reg.write_command(Register.CCR2, 0x03F000) + bytes(2))
    assert _read(chip, Register.CCR2) == 0x03F000
    assert _status(chip) & Gsr0.CLOCK_ERROR


@pytest.mark.parametrize("words", [3, 5])
def test_a_bounded_burst_of_the_wrong_length_is_a_burst_error(chip, words: int) -> None:
    chip.transfer(reg.burst_command(4, Register.ADC0) + bytes(3 * words))
    assert _status(chip) == Gsr0.BURST_ERROR | Gsr0.HIGH_SPEED
    assert _read(chip, Register.FSTAT) & Fstat.BURST_ERROR


def test_a_bounded_burst_of_the_right_length_is_none(chip) -> None:
    chip.transfer(reg.burst_command(4, Register.ADC0) + bytes(12))
    assert _status(chip) == Gsr0.HIGH_SPEED


def test_a_misaligned_bounded_burst_is_both(chip) -> None:
    chip.transfer(reg.burst_command(4, Register.ADC0) + bytes(10))
    assert _status(chip) & reg.GSR0_ERRORS == Gsr0.BURST_ERROR | Gsr0.CLOCK_ERROR


def test_a_misaligned_unbounded_burst_is_a_clock_error_and_loses_the_word(chip, clock) -> None:
    schedule = _start(chip)
    clock.sleep(schedule.ready_s(20))
    there = _fill(chip)
    chip.transfer(reg.burst_command() + bytes(3 * 5 + 1))
    assert _fill(chip) == there - 6
    assert _status(chip) & reg.GSR0_ERRORS == Gsr0.CLOCK_ERROR


def test_writing_to_the_fifo_is_not_supported(chip) -> None:
    chip.transfer(reg.burst_command(write=True) + bytes(3))
    assert _status(chip) & Gsr0.BURST_ERROR


@pytest.mark.parametrize("error", [Gsr0.CLOCK_ERROR, Gsr0.BURST_ERROR])
def test_clock_and_burst_errors_stay_until_software_or_hardware_reset(chip, error: Gsr0) -> None:
    def fail() -> None:
        if error == Gsr0.CLOCK_ERROR:
            chip.transfer(b"\x04")
        else:
            chip.transfer(reg.burst_command(4, Register.ADC0) + bytes(3))

    fail()
    _write(chip, Register.MAIN, reg.FIFO_RESET.bits(1))
    assert _status(chip) & error
    _write(chip, Register.MAIN, reg.SW_RESET.bits(1))
    assert not _status(chip) & error
    fail()
    chip.set_reset(active=True)
    chip.set_reset(active=False)
    assert not _status(chip) & error


# --- FIFO ------------------------------------------------------------------------------------------------------------


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
    schedule = _start(chip, waveform)
    started_s = clock.now_s
    for number, due_s in enumerate(_ready_slowly(waveform, 2 * schedule.frame_words), 1):
        assert schedule.ready_s(number) == pytest.approx(due_s, abs=1e-12)
        assert schedule.produced(due_s) >= number > schedule.produced(due_s - 1 / CLOCK_HZ)
    clock.sleep(started_s + schedule.ready_s(100) - clock.now_s)
    assert _fill(chip) == schedule.produced(schedule.ready_s(100)) >= 100


def test_first_sample_comes_a_millisecond_after_frame_start(chip) -> None:
    schedule = _start(chip)
    assert schedule.ready_s(1) == pytest.approx(1.0567e-3, abs=1e-6)


def test_interrupt_rises_with_the_word_after_the_mark_and_falls_below(chip, clock) -> None:
    schedule = _start(chip, mark=99)
    started_s = clock.now_s
    assert not chip.wait_irq(schedule.ready_s(100) - 1e-6)
    assert chip.wait_irq(1.0)
    assert clock.now_s - started_s == pytest.approx(schedule.ready_s(100), abs=1e-9)
    assert _read(chip, Register.FSTAT) & Fstat.CREF
    _burst(chip, 40)
    assert not chip.wait_irq(0.0)
    assert not _read(chip, Register.FSTAT) & Fstat.CREF


def test_fifo_burst_on_the_wire(chip, clock) -> None:
    signal = signals.noise(seed=3)
    schedule = _start(chip)
    clock.sleep(schedule.ready_s(schedule.frame_words))
    reply = _burst(chip, schedule.frame_words)
    assert reply[:4].hex(" ") == "f0 00 00 00"  # SFCTL was written without high speed
    assert reply[4:] == pack_frame(signal(0.0, plan(SMALL).waveform), 0).tobytes()
    assert _read(chip, Register.FSTAT) & (Fstat.EMPTY | reg.FSTAT_ERRORS) == Fstat.EMPTY


def test_without_header_there_are_samples_only(chip, clock) -> None:
    schedule = _start(chip, header=0)
    clock.sleep(schedule.ready_s(schedule.frame_words))
    frame = signals.noise(seed=3)(0.0, plan(SMALL).waveform)
    assert unpack_words(_burst(chip, schedule.frame_words)[4:]).tolist() == frame.transpose(1, 2, 0).ravel().tolist()


def test_test_pattern_replaces_the_first_channel(chip, clock) -> None:
    schedule = _start(chip, msgspec.structs.replace(SMALL, rx_mask=1), header=0, lfsr=1)
    clock.sleep(schedule.ready_s(2 * schedule.frame_words))
    got = np.concatenate([unpack_words(_burst(chip, schedule.frame_words)[4:]) for _ in range(2)])
    assert np.array_equal(got, lfsr_sequence(2 * 8 * 32))


def test_overflow_puts_the_chip_to_sleep_with_readable_data(chip, clock) -> None:
    schedule = _start(chip, msgspec.structs.replace(SMALL, rx_mask=1))  # one word at a time
    started_s = clock.now_s
    clock.sleep(schedule.ready_s(8192))
    assert _fill(chip) == 8192
    assert _read(chip, Register.FSTAT) & Fstat.FULL
    assert not _status(chip) & Gsr0.FIFO_ERROR
    clock.sleep(started_s + schedule.ready_s(8193) - clock.now_s + 1e-8)
    assert _read(chip, Register.FSTAT) & Fstat.OVERFLOW
    assert _status(chip) & Gsr0.FIFO_ERROR
    assert reg.POWER_MODE.value(_read(chip, Register.STAT0)) == 5
    assert len(_burst(chip, 8192)) == 4 + 3 * 8192
    clock.sleep(1.0)
    assert _fill(chip) == 0  # asleep
    assert _read(chip, Register.FSTAT) & Fstat.OVERFLOW


def test_fifo_reset_ends_overflow_and_keeps_registers(chip, clock) -> None:
    schedule = _start(chip)
    clock.sleep(1.0)
    main = _read(chip, Register.MAIN)
    _write(chip, Register.MAIN, main | reg.FIFO_RESET.bits(1))
    assert _read(chip, Register.FSTAT) & reg.FSTAT_ERRORS == 0
    assert _fill(chip) == 0
    _write(chip, Register.MAIN, main | reg.FRAME_START.bits(1))
    clock.sleep(schedule.ready_s(50))
    assert _fill(chip) >= 50


def test_underflow_reads_ones_and_sets_the_flag(chip, clock) -> None:
    schedule = _start(chip)
    clock.sleep(schedule.ready_s(10))
    there = _fill(chip)
    samples = unpack_words(_burst(chip, there + 5)[4:])
    assert (samples[2 * there :] == 0xFFF).all()
    assert _read(chip, Register.FSTAT) & Fstat.UNDERFLOW
    assert _status(chip) & Gsr0.FIFO_ERROR


def test_fsm_reset_stops_and_leaves_the_fifo(chip, clock) -> None:
    schedule = _start(chip)
    clock.sleep(schedule.ready_s(30))
    there = _fill(chip)
    _write(chip, Register.MAIN, _read(chip, Register.MAIN) | reg.FSM_RESET.bits(1))
    clock.sleep(1.0)
    assert _fill(chip) == there


def test_frame_start_needs_the_oscillator_and_is_ignored_while_running(chip, clock) -> None:
    _write(chip, Register.MAIN, 0x1E8271)
    clock.sleep(0.1)
    assert _fill(chip) == 0
    schedule = _start(chip)
    clock.sleep(1.5e-3)
    _write(chip, Register.MAIN, _read(chip, Register.MAIN) | 1)
    clock.sleep(schedule.ready_s(300) - 1.5e-3)
    assert _fill(chip) == schedule.produced(schedule.ready_s(300))


def test_commands_in_main_clear_themselves(chip) -> None:
    _write(chip, Register.MAIN, 0x1E827D)
    assert _read(chip, Register.MAIN) == 0x1E8270


def test_max_frame_count_ends_the_sequence(chip, clock) -> None:
    what = plan(SMALL)
    for address, value in (what.registers | {Register.SFCTL: reg.PREFIX_EN.bits(1)}).items():
        _write(chip, address, value)
    _write(chip, Register.CCR2, what.registers[Register.CCR2] | reg.MAX_FRAME_CNT.bits(2))
    _write(chip, Register.MAIN, what.registers[Register.MAIN] | 1)
    clock.sleep(1.0)
    assert _fill(chip) == 2 * WordSchedule(what.timing, 3).frame_words
    assert not chip.wait_irq(1.0) or _fill(chip)


def test_counters_in_stat1(chip, clock) -> None:
    schedule = _start(chip)
    clock.sleep(schedule.ready_s(schedule.frame_words + 3 * schedule.chirp_words))
    assert _read(chip, Register.STAT1) == 1 << 12 | 3


def test_transfers_take_the_time_of_the_bus(clock) -> None:
    chip = EmulatedChip(clock, signals.silence, speed_hz=50_000_000)
    before_s = clock.now_s
    _burst(chip, 960)
    assert clock.now_s - before_s == pytest.approx(8 * 2884 / 50e6)


# --- faults and signals ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "flag"),
    [("overflow", Fstat.OVERFLOW), ("underflow", Fstat.UNDERFLOW), ("burst_error", Fstat.BURST_ERROR)],
)
def test_injected_faults_show_where_real_ones_would(chip, clock, fault: str, flag: Fstat) -> None:
    _start(chip)
    clock.sleep(2e-3)
    chip.inject(fault)
    assert _read(chip, Register.FSTAT) & flag


def test_injected_clock_error_hits_the_next_transfer(chip) -> None:
    chip.inject("clock_error")
    _write(chip, Register.CCR2, 0x03F000)
    assert _read(chip, Register.CCR2) == 0
    assert _read(chip, Register.FSTAT) & Fstat.CLOCK_ERROR


def test_lasting_faults_last_until_healed(chip) -> None:
    chip.inject("wrong_chip")
    assert _read(chip, Register.CHIP_ID) != 0x000303
    chip.heal("wrong_chip")
    assert _read(chip, Register.CHIP_ID) == 0x000303
    chip.inject("unplugged")
    assert _read(chip, Register.CHIP_ID) == 0
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
