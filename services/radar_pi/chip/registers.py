"""Registers of the BGT60TR13C and the words of its SPI protocol (Infineon data sheet V2.4.9).

A register access is 32 bits: address[31:25], write flag[24], data[23:0]. The reply is the status byte GSR0 and the
content *before* the access. A burst begins with ``0x7F`` as address, flag 1, start address[23:17], write[16] and the
number of words[15:9], 0 for "until chip select rises".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag

Registers = dict[int, int]  # address -> 24-bit content

CHIP_ID_BGT60TR13C = 0x000303  # digital id 3, RF id 3 (1 TX, 3 RX)
FIFO_WORDS = 8192
WORD_BYTES = 3
COMMAND_BYTES = 4
UNBOUNDED = 0
_BURST_ADDRESS = 0x7F
_DATA_MASK = 0xFFFFFF


class Register(IntEnum):
    """Addresses, under the names that Infineon's register export uses."""

    MAIN = 0x00
    ADC0 = 0x01
    CHIP_ID = 0x02
    STAT1 = 0x03
    PACR1 = 0x04
    PACR2 = 0x05
    SFCTL = 0x06
    SADC_CTRL = 0x07
    CSP_I_0 = 0x08
    CSP_I_1 = 0x09
    CSP_I_2 = 0x0A
    CSCI = 0x0B
    CSP_D_0 = 0x0C
    CSP_D_1 = 0x0D
    CSP_D_2 = 0x0E
    CSCDS = 0x0F
    CS1_U_0 = 0x10
    CS1_U_1 = 0x11
    CS1_U_2 = 0x12
    CS1 = 0x16
    CS2 = 0x1D
    CS3 = 0x24
    CS4 = 0x2B
    CCR0 = 0x2C
    CCR1 = 0x2D
    CCR2 = 0x2E
    CCR3 = 0x2F
    PLL1_0 = 0x30
    PLL1_1 = 0x31
    PLL1_2 = 0x32
    PLL1_3 = 0x33
    PLL1_4 = 0x34
    PLL1_5 = 0x35
    PLL1_6 = 0x36
    PLL1_7 = 0x37
    PLL2_7 = 0x3F
    PLL3_7 = 0x47
    PLL4_7 = 0x4F
    RFT1 = 0x56
    SDFT0 = 0x5B
    STAT0 = 0x5D
    SADC_RESULT = 0x5E
    FSTAT = 0x5F
    FIFO = 0x60


@dataclass(frozen=True)
class Field:
    """Some bits of one register, ``msb`` and ``lsb`` as the data sheet writes them."""

    register: Register
    msb: int
    lsb: int

    @property
    def mask(self) -> int:
        """The field's bits within the register."""
        return ((1 << (self.msb - self.lsb + 1)) - 1) << self.lsb

    def of(self, registers: Mapping[int, int]) -> int:
        """The field's value in a set of registers."""
        return self.value(registers[self.register])

    def value(self, content: int) -> int:
        """The field's value in the content of its register."""
        return (content & self.mask) >> self.lsb

    def signed(self, registers: Mapping[int, int]) -> int:
        """The field's value read as two's complement."""
        width = self.msb - self.lsb + 1
        value = self.of(registers)
        return value - (1 << width) if value >> (width - 1) else value

    def bits(self, value: int) -> int:
        """The content of the register that has ``value`` in this field and zero elsewhere.

        Raises:
            ValueError: the value does not fit.
        """
        width = self.msb - self.lsb + 1
        if not -(1 << (width - 1)) <= value < 1 << width:
            raise ValueError(f"{self.register.name}[{self.msb}:{self.lsb}]: {value} does not fit into {width} bits")
        return (value << self.lsb) & self.mask

    def put(self, content: int, value: int) -> int:
        """``content`` with this field replaced."""
        return (content & ~self.mask) | self.bits(value)


_R = Register
FRAME_START = Field(_R.MAIN, 0, 0)
SW_RESET = Field(_R.MAIN, 1, 1)
FSM_RESET = Field(_R.MAIN, 2, 2)
FIFO_RESET = Field(_R.MAIN, 3, 3)
TR_WKUP = Field(_R.MAIN, 11, 4)
TR_WKUP_MUL = Field(_R.MAIN, 15, 12)
ADC_DIV = Field(_R.ADC0, 23, 14)
FRAME_CNT = Field(_R.STAT1, 23, 12)
SHAPE_GRP_CNT = Field(_R.STAT1, 11, 0)
OSCCLKEN = Field(_R.PACR1, 23, 23)
FSTDNEN = Field(_R.PACR2, 7, 6)
FSDNTMR = Field(_R.PACR2, 16, 8)
FIFO_CREF = Field(_R.SFCTL, 12, 0)
FIFO_LP_MODE = Field(_R.SFCTL, 13, 13)
MISO_HS_RD = Field(_R.SFCTL, 16, 16)
LFSR_EN = Field(_R.SFCTL, 17, 17)
PREFIX_EN = Field(_R.SFCTL, 18, 18)
QSPI_WT = Field(_R.SFCTL, 20, 20)
SADC_SD_EN = Field(_R.SADC_CTRL, 8, 8)
SADC_OVERS_CFG = Field(_R.SADC_CTRL, 10, 9)
SADC_SESP = Field(_R.SADC_CTRL, 11, 11)
SADC_TC_TRIM = Field(_R.SADC_CTRL, 16, 14)
TX_EN = Field(_R.CS1_U_0, 0, 0)
VCO_EN = Field(_R.CS1_U_0, 4, 4)
FDIV_EN = Field(_R.CS1_U_0, 6, 6)
LO_DIST2_EN = Field(_R.CS1_U_0, 10, 10)  # feeds RX1 and RX3
LO_DIST1_EN = Field(_R.CS1_U_0, 11, 11)  # feeds RX2 and TX
RX_EN = tuple(Field(_R.CS1_U_0, 13 + 2 * n, 12 + 2 * n) for n in range(3))  # mixer and its LO buffer
BBCHGLOB_EN = Field(_R.CS1_U_0, 20, 20)
TX_DAC = Field(_R.CS1_U_1, 4, 0)
MADC_EN = Field(_R.CS1_U_1, 10, 10)
TEMP_MEAS_EN = Field(_R.CS1_U_1, 12, 12)
BB_RSTCNT = Field(_R.CS1_U_1, 19, 13)
BBCH_SEL = Field(_R.CS1_U_1, 22, 20)  # bit 0 = RX1
HP_GAIN = Field(_R.CS1_U_2, 22, 20)  # 1 = 18 dB, 0 = 30 dB, one bit per channel
VGA_GAIN = tuple(Field(_R.CS1_U_2, 4 + 5 * n, 2 + 5 * n) for n in range(3))  # steps of 5 dB
HPF_SEL = tuple(Field(_R.CS1_U_2, 1 + 5 * n, 5 * n) for n in range(3))
TR_END = Field(_R.CCR0, 8, 0)
CONT_MODE = Field(_R.CCR0, 9, 9)
REPT = Field(_R.CCR0, 13, 10)
TR_INIT1 = Field(_R.CCR0, 21, 14)
TR_INIT1_MUL = Field(_R.CCR0, 23, 22)
TR_START = Field(_R.CCR1, 8, 0)
FRAME_PD_MODE = Field(_R.CCR1, 10, 9)
TR_FED = Field(_R.CCR1, 18, 11)
TR_FED_MUL = Field(_R.CCR1, 23, 19)
MAX_FRAME_CNT = Field(_R.CCR2, 11, 0)
FRAME_LEN = Field(_R.CCR2, 23, 12)
TR_PAEN = Field(_R.CCR3, 8, 0)
TR_SSTART = Field(_R.CCR3, 13, 9)
TR_INIT0 = Field(_R.CCR3, 21, 14)
TR_INIT0_MUL = Field(_R.CCR3, 23, 22)
FSU = Field(_R.PLL1_0, 23, 0)
RSU = Field(_R.PLL1_1, 23, 0)
RTU = Field(_R.PLL1_2, 13, 0)
TR_EDU = Field(_R.PLL1_2, 23, 16)
APU = Field(_R.PLL1_3, 11, 0)
SH_EN = Field(_R.PLL1_7, 4, 4)
SHAPE_CONT_MODE = Field(_R.PLL1_7, 8, 8)
SHAPE_PD_MODE = Field(_R.PLL1_7, 10, 9)
TR_SED = Field(_R.PLL1_7, 18, 11)
TR_SED_MUL = Field(_R.PLL1_7, 23, 19)
POWER_MODE = Field(_R.STAT0, 7, 5)
FILL_STATUS = Field(_R.FSTAT, 13, 0)


class PowerMode(IntEnum):
    """STAT0: what the chip's state machine is in."""

    ACTIVE = 1
    INTERCHIRP = 2
    IDLE = 3
    DEEP_SLEEP = 5


class PdMode(IntEnum):
    """What the chip does in the pause after a chirp or a frame."""

    STAY = 0
    IDLE = 1
    DEEP_SLEEP = 2


class Gsr0(IntFlag):
    """The first byte of every reply, as the data sheet has it (one vendor header lists the bits in reverse)."""

    CLOCK_ERROR = 0x01
    BURST_ERROR = 0x02
    HIGH_SPEED = 0x04
    FIFO_ERROR = 0x08  # overflow or underflow; also seen on an empty FIFO, so evaluated on bursts only


GSR0_ERRORS = Gsr0.CLOCK_ERROR | Gsr0.BURST_ERROR | Gsr0.FIFO_ERROR
GSR0_BURST_NIBBLE = 0xF0  # the upper nibble of a burst's status byte is all ones


class Fstat(IntFlag):
    """Flags of the FIFO status register."""

    CLOCK_ERROR = 1 << 17
    BURST_ERROR = 1 << 18
    UNDERFLOW = 1 << 19
    EMPTY = 1 << 20
    CREF = 1 << 21  # the fill is over the mark
    FULL = 1 << 22
    OVERFLOW = 1 << 23


FSTAT_ERRORS = Fstat.CLOCK_ERROR | Fstat.BURST_ERROR | Fstat.UNDERFLOW | Fstat.OVERFLOW


def name_of(address: int) -> str:
    """A register's name, or its address for those that this service never uses."""
    return Register(address).name if address in list(Register) else f"0x{address:02X}"


def read_command(address: int) -> bytes:
    """The four bytes that read a register."""
    return (address << 25).to_bytes(4, "big")


def write_command(address: int, value: int) -> bytes:
    """The four bytes that write a register."""
    return (address << 25 | 1 << 24 | value & _DATA_MASK).to_bytes(4, "big")


def burst_command(words: int = UNBOUNDED, start: int = Register.FIFO, *, write: bool = False) -> bytes:
    """The four bytes that begin a burst; ``FF C0 00 00`` for the FIFO."""
    head = _BURST_ADDRESS << 25 | 1 << 24 | start << 17 | int(write) << 16 | words << 9
    return head.to_bytes(4, "big")


def is_burst(command: int) -> bool:
    """Whether a 32-bit command word begins a burst."""
    return command >> 24 == _BURST_ADDRESS << 1 | 1
