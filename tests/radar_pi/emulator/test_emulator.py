"""The emulated chip on the wire, against the data sheet's rules: registers, commands, wrong clock counts."""

from __future__ import annotations

import pytest

from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.exports import plan
from services.radar_pi.chip.registers import Fstat, Gsr0, Register
from services.radar_pi.config import WaveformConfig


@pytest.fixture
def chip(probed_chip):
    """Transfers take no time, so that every moment is exact."""
    return probed_chip


# --- registers -------------------------------------------------------------------------------------------------------


def test_chip_id_on_the_wire(chip) -> None:
    assert chip.transfer(bytes.fromhex("04000000")).hex(" ") == "f4 00 03 03"


@pytest.mark.parametrize(
    ("register", "value"),
    [("MAIN", 0x1E0000), ("ADC0", 0x0A0240), ("SFCTL", 0x010000), ("PACR2", 0x040014), ("CCR2", 0), ("PLL1_0", 0)],
)
def test_reset_values(chip, register: str, value: int) -> None:
    chip.write(Register[register], 0x123450)
    chip.write(Register.MAIN, reg.SW_RESET.bits(1))
    assert chip.read(Register[register]) == value


def test_every_register_keeps_what_the_driver_writes(chip) -> None:
    for address, value in plan(WaveformConfig()).registers.items():
        chip.write(address, value)
        assert chip.read(address) == value


def test_a_write_answers_with_the_content_before_it(chip) -> None:
    assert chip.write(Register.CCR2, 0x03F000)[1:].hex() == "000000"
    assert chip.write(Register.CCR2, 0x01F000)[1:].hex() == "03f000"


def test_status_registers_cannot_be_written(chip) -> None:
    for register in (Register.CHIP_ID, Register.STAT0, Register.STAT1, Register.FSTAT):
        before = chip.read(register)
        chip.write(register, 0xFFFFFF)
        assert chip.read(register) == before


def test_high_speed_bit_follows_sfctl_and_is_set_by_reset(chip) -> None:
    assert chip.status() == Gsr0.HIGH_SPEED
    chip.write(Register.SFCTL, 0)
    assert chip.status() == Gsr0(0)
    chip.write(Register.MAIN, reg.SW_RESET.bits(1))
    assert chip.status() == Gsr0.HIGH_SPEED


def test_reset_line_restores_everything_and_silences_the_chip(chip) -> None:
    chip.write(Register.CCR2, 0x03F000)
    chip.set_reset(active=True)
    assert chip.transfer(reg.read_command(Register.CHIP_ID)) == bytes(4)
    chip.set_reset(active=False)
    assert chip.read(Register.CHIP_ID) == 0x000303
    assert chip.read(Register.CCR2) == 0


def test_registers_in_bursts(chip) -> None:
    values = bytes.fromhex("0a0210 000000 000000")
    chip.transfer(reg.burst_command(3, Register.ADC0, write=True) + values)
    reply = chip.transfer(reg.burst_command(2, Register.ADC0) + bytes(6))
    assert reply.hex(" ") == "f4 00 00 00 0a 02 10 00 03 03"


# --- clock and burst errors ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("length", [1, 2, 3])
def test_fewer_than_32_clocks_are_ignored_and_an_error(chip, length: int) -> None:
    assert len(chip.transfer(reg.write_command(Register.CCR2, 0x03F000)[:length])) == length
    assert chip.read(Register.CCR2) == 0
    assert chip.status() & Gsr0.CLOCK_ERROR
    assert chip.read(Register.FSTAT) & Fstat.CLOCK_ERROR


def test_more_than_32_clocks_are_an_error_but_the_access_counts(chip) -> None:
    chip.transfer(reg.write_command(Register.CCR2, 0x03F000) + bytes(2))
    assert chip.read(Register.CCR2) == 0x03F000
    assert chip.status() & Gsr0.CLOCK_ERROR


@pytest.mark.parametrize("words", [3, 5])
def test_a_bounded_burst_of_the_wrong_length_is_a_burst_error(chip, words: int) -> None:
    chip.transfer(reg.burst_command(4, Register.ADC0) + bytes(3 * words))
    assert chip.status() == Gsr0.BURST_ERROR | Gsr0.HIGH_SPEED
    assert chip.read(Register.FSTAT) & Fstat.BURST_ERROR


def test_a_bounded_burst_of_the_right_length_is_none(chip) -> None:
    chip.transfer(reg.burst_command(4, Register.ADC0) + bytes(12))
    assert chip.status() == Gsr0.HIGH_SPEED


def test_a_misaligned_bounded_burst_is_both(chip) -> None:
    chip.transfer(reg.burst_command(4, Register.ADC0) + bytes(10))
    assert chip.status() & reg.GSR0_ERRORS == Gsr0.BURST_ERROR | Gsr0.CLOCK_ERROR


def test_a_misaligned_unbounded_burst_is_a_clock_error_and_loses_the_word(chip, clock) -> None:
    schedule = chip.start()
    clock.sleep(schedule.ready_s(20))
    there = chip.fill()
    chip.transfer(reg.burst_command() + bytes(3 * 5 + 1))
    assert chip.fill() == there - 6
    assert chip.status() & reg.GSR0_ERRORS == Gsr0.CLOCK_ERROR


def test_writing_to_the_fifo_is_not_supported(chip) -> None:
    chip.transfer(reg.burst_command(write=True) + bytes(3))
    assert chip.status() & Gsr0.BURST_ERROR


@pytest.mark.parametrize("error", [Gsr0.CLOCK_ERROR, Gsr0.BURST_ERROR])
def test_clock_and_burst_errors_stay_until_software_or_hardware_reset(chip, error: Gsr0) -> None:
    def fail() -> None:
        if error == Gsr0.CLOCK_ERROR:
            chip.transfer(b"\x04")
        else:
            chip.transfer(reg.burst_command(4, Register.ADC0) + bytes(3))

    fail()
    chip.write(Register.MAIN, reg.FIFO_RESET.bits(1))
    assert chip.status() & error
    chip.write(Register.MAIN, reg.SW_RESET.bits(1))
    assert not chip.status() & error
    fail()
    chip.set_reset(active=True)
    chip.set_reset(active=False)
    assert not chip.status() & error
