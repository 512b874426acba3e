"""Register map and SPI words against the data sheet's numbers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.registers import Field, Fstat, Gsr0, Register

FIELDS = [value for value in vars(reg).values() if isinstance(value, Field)]
FIELDS += [*reg.RX_EN, *reg.VGA_GAIN, *reg.HPF_SEL]


@pytest.mark.parametrize(
    ("command", "on_the_wire"),
    [
        (reg.burst_command(), "ff c0 00 00"),  # FIFO, until chip select rises
        (reg.burst_command(126), "ff c0 fc 00"),  # bounded to 126 words
        (reg.burst_command(2, Register.ADC0), "ff 02 04 00"),  # registers from 0x01
        (reg.burst_command(1, Register.SFCTL, write=True), "ff 0d 02 00"),
        (reg.read_command(Register.CHIP_ID), "04 00 00 00"),
        (reg.read_command(Register.FSTAT), "be 00 00 00"),
        (reg.write_command(Register.MAIN, 0x1E8271), "01 1e 82 71"),  # as in Infineon's C headers
        (reg.write_command(Register.SDFT0, 0), "b7 00 00 00"),
    ],
)
def test_command_words(command: bytes, on_the_wire: str) -> None:
    assert command.hex(" ") == on_the_wire


@pytest.mark.parametrize("address", list(Register))
def test_no_register_access_looks_like_a_burst(address: Register) -> None:
    for command in (reg.read_command(address), reg.write_command(address, 0xFFFFFF)):
        assert not reg.is_burst(int.from_bytes(command, "big"))
    assert reg.is_burst(int.from_bytes(reg.burst_command(), "big"))


@pytest.mark.parametrize(
    ("field", "mask"),
    [
        (reg.SW_RESET, 0x000002),
        (reg.TR_WKUP, 0x000FF0),
        (reg.ADC_DIV, 0xFFC000),
        (reg.OSCCLKEN, 0x800000),
        (reg.FSDNTMR, 0x01FF00),
        (reg.FIFO_CREF, 0x001FFF),
        (reg.MISO_HS_RD, 0x010000),
        (reg.LFSR_EN, 0x020000),
        (reg.PREFIX_EN, 0x040000),
        (reg.BBCH_SEL, 0x700000),
        (reg.TR_INIT1, 0x3FC000),
        (reg.TR_FED, 0x07F800),
        (reg.FRAME_LEN, 0xFFF000),
        (reg.TR_SSTART, 0x003E00),
        (reg.VGA_GAIN[2], 0x007000),
        (reg.HPF_SEL[1], 0x000060),
        (reg.FILL_STATUS, 0x003FFF),
    ],
)
def test_field_masks(field: Field, mask: int) -> None:
    assert field.mask == mask


def test_status_bits_are_in_the_data_sheets_order() -> None:
    assert (Gsr0.CLOCK_ERROR, Gsr0.BURST_ERROR, Gsr0.HIGH_SPEED, Gsr0.FIFO_ERROR) == (1, 2, 4, 8)
    assert reg.GSR0_ERRORS == 0x0B
    assert Fstat.OVERFLOW == 1 << 23
    assert Fstat.CREF == 1 << 21


def test_fields_of_a_register_do_not_overlap() -> None:
    taken: dict[int, int] = {}
    for field in FIELDS:
        assert not taken.get(field.register, 0) & field.mask, field
        taken[field.register] = taken.get(field.register, 0) | field.mask


@given(st.sampled_from(FIELDS), st.integers(0, 0xFFFFFF), st.data())
def test_a_field_that_was_put_is_read_back_and_nothing_else_changes(field: Field, content: int, data: st.DataObject):
    value = data.draw(st.integers(0, field.mask >> field.lsb))
    changed = field.put(content, value)
    assert field.value(changed) == value
    assert changed & ~field.mask == content & ~field.mask


def test_a_value_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match=r"ADC0\[23:14\]: 1024 does not fit into 10 bits"):
        reg.ADC_DIV.bits(1024)


def test_negative_values_are_twos_complement() -> None:
    assert reg.FSU.signed({Register.PLL1_0: 0xA89A94}) == 0xA89A94 - (1 << 24)
    assert reg.FSU.bits(-1) == 0xFFFFFF
