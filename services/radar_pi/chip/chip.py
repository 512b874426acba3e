"""Register-level access to the chip over the link, and what can be wrong with it."""

from __future__ import annotations

from enum import IntEnum

from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.link import Clock, Link
from services.radar_pi.chip.registers import CHIP_ID_BGT60TR13C, Fstat, Gsr0, Register, Registers

RESET_PULSE_S = 1e-3  # at least 100 ns each
RESET_SETTLE_S = 10e-3
SW_RESET_POLLS = 20
MAX_WRONG_REGISTERS = 3
HIGH_SPEED_FROM_HZ = 20_000_000  # above, MISO has to change on the rising edge
_SELF_CLEARING = {int(Register.MAIN): 0x00000F}
_SILENCE = (0x000000, 0xFFFFFF)  # what an unconnected MISO reads


class Cure(IntEnum):
    """What brings the chip back, from the mildest on; each includes the ones before it."""

    FIFO_RESET = 1  # and the state machine; registers stay
    SOFTWARE_RESET = 2  # everything back to reset values
    HARDWARE_RESET = 3


class RadarFault(RuntimeError):
    """Something is wrong with chip or link: a short name for counting, a sentence for a person, and the cure."""

    def __init__(self, name: str, text: str, cure: Cure) -> None:
        super().__init__(text)
        self.name = name
        self.cure = cure


class ChipRefused(RadarFault):
    """Not the chip this driver is for, or none at all."""


class Chip:
    """The BGT60TR13C behind a link."""

    def __init__(self, link: Link, clock: Clock, speed_hz: int) -> None:
        self._link = link
        self._clock = clock
        self.high_speed = reg.MISO_HS_RD.bits(int(speed_hz > HIGH_SPEED_FROM_HZ))

    def read(self, address: int) -> int:
        """Content of a register."""
        return int.from_bytes(self._link.transfer(reg.read_command(address))[1:4], "big")

    def write(self, address: int, value: int) -> None:
        """Set the content of a register."""
        self._link.transfer(reg.write_command(address, value))

    def burst(self, words: int) -> tuple[int, bytes]:
        """Read FIFO words: status byte as of the begin of this burst, data (3 * words bytes)."""
        reply = self._link.transfer(reg.burst_command() + bytes(reg.WORD_BYTES * words))
        return reply[0], reply[reg.COMMAND_BYTES :]

    def fifo_status(self) -> Fstat:
        """FSTAT without the fill level, which means nothing while the chip samples.

        Raises:
            RadarFault: an error flag is set.
        """
        content = self.read(Register.FSTAT)
        self.refuse_errors(0, content)
        return Fstat(content & (reg.FSTAT_ERRORS | Fstat.CREF | Fstat.FULL | Fstat.EMPTY))

    def check_burst(self, status: int) -> None:
        """Judge the status byte of a burst; FSTAT tells which of the FIFO errors it was.

        Raises:
            RadarFault: an error flag is set, or nobody answered.
        """
        if status & reg.GSR0_BURST_NIBBLE != reg.GSR0_BURST_NIBBLE:
            raise RadarFault("no_reply", f"burst answered with status 0x{status:02x}: bus dead?", Cure.HARDWARE_RESET)
        if status & reg.GSR0_ERRORS:
            self.refuse_errors(status, self.read(Register.FSTAT))

    def refuse_errors(self, gsr0: int, fstat: int) -> None:
        """Raise the fault that GSR0 and FSTAT tell of together, the worst first."""
        if fstat in _SILENCE and self.read(Register.CHIP_ID) in _SILENCE:
            raise RadarFault("no_reply", f"FSTAT reads 0x{fstat:06x}: nobody answers", Cure.HARDWARE_RESET)
        if gsr0 & Gsr0.CLOCK_ERROR or fstat & Fstat.CLOCK_ERROR:
            raise RadarFault("clock_error", "SPI clock error: wrong number of clocks", Cure.SOFTWARE_RESET)
        if gsr0 & Gsr0.BURST_ERROR or fstat & Fstat.BURST_ERROR:
            raise RadarFault("burst_error", "SPI burst error", Cure.SOFTWARE_RESET)
        if fstat & Fstat.OVERFLOW:
            raise RadarFault("fifo_overflow", "FIFO overflow: words were not read in time", Cure.FIFO_RESET)
        if fstat & Fstat.UNDERFLOW:
            raise RadarFault("fifo_underflow", "FIFO underflow: more was read than there was", Cure.FIFO_RESET)
        if gsr0 & Gsr0.FIFO_ERROR:
            raise RadarFault("fifo_error", "FIFO error in GSR0 that FSTAT does not name", Cure.FIFO_RESET)

    def reset_hardware(self) -> None:
        """Chip select high, reset line 1-0-1; then the MISO edge that this SPI speed needs."""
        for active in (False, True, False):
            self._link.set_reset(active=active)
            self._clock.sleep(RESET_PULSE_S)
        self._clock.sleep(RESET_SETTLE_S)
        self.write(Register.SFCTL, self.high_speed)

    def check_identity(self) -> None:
        """Raises ``ChipRefused`` unless this is a BGT60TR13C."""
        found = self.read(Register.CHIP_ID)
        if found == CHIP_ID_BGT60TR13C:
            return
        expected = f"expected chip id 0x{CHIP_ID_BGT60TR13C:06x} (BGT60TR13C)"
        hint = (
            "no chip answers: HAT seated, SPI enabled?" if found in _SILENCE else "another chip; this driver refuses it"
        )
        raise ChipRefused("wrong_chip", f"{expected}, found 0x{found:06x}: {hint}", Cure.HARDWARE_RESET)

    def reset_software(self) -> None:
        """All registers, counters, FIFO and state machine.

        Raises:
            RadarFault: the bit does not clear itself.
        """
        self.write(Register.MAIN, reg.SW_RESET.bits(1))
        self._clock.sleep(RESET_PULSE_S)
        self.write(Register.SFCTL, self.high_speed)
        for _ in range(SW_RESET_POLLS):
            if not reg.SW_RESET.value(self.read(Register.MAIN)):
                self._clock.sleep(RESET_SETTLE_S)
                return
            self._clock.sleep(RESET_PULSE_S)
        raise RadarFault("reset_hangs", "software reset does not end", Cure.HARDWARE_RESET)

    def configure(self, registers: Registers) -> str:
        """Write the list and read it back; returns a sentence about the few that read differently, or nothing.

        One bit that the state machine owns must not silence a radar that works, so a few are only told.

        Raises:
            RadarFault: many differ, so the link does not carry.
        """
        for address, value in registers.items():
            self.write(address, value)
        found = {address: self.read(address) for address in registers}
        wrong = [a for a, value in registers.items() if (found[a] ^ value) & ~_SELF_CLEARING.get(a, 0)]
        text = ", ".join(f"{reg.name_of(a)} reads 0x{found[a]:06x} after 0x{registers[a]:06x}" for a in wrong)
        if len(wrong) > MAX_WRONG_REGISTERS:
            what = f"{len(wrong)} of {len(registers)} registers do not keep their value: {text}"
            raise RadarFault("register_mismatch", what, Cure.HARDWARE_RESET)
        return f"register {text}" if text else ""
