"""A BGT60TR13C on the wire: what its SPI pins answer, bit for bit, on a clock that tests can run by hand.

Registers, FIFO of 8192 words, interrupt, GSR0 and the error rules follow the data sheet V2.4.9; when a word appears in
the FIFO follows from the programmed registers (``schedule.py``). A burst can read what is there when chip select
falls. The radar signal comes from a function of (UTC seconds of the first chirp, programmed waveform).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.link import Clock
from services.radar_pi.chip.registers import Fstat, Gsr0, PowerMode, Register
from services.radar_pi.emulator.emulated_fifo import EmulatedFifo, SignalSource

RESET_VALUES = {
    Register.MAIN: 0x1E0000,
    Register.ADC0: 0x0A0240,
    Register.CHIP_ID: reg.CHIP_ID_BGT60TR13C,
    Register.PACR1: 0x196524,
    Register.PACR2: 0x040014,
    Register.SFCTL: 0x010000,  # high-speed read is on after a reset
    Register.CSCI: 0x000B60,
    Register.CSCDS: 0x000B60,
    Register.CS1: 0x000B60,
    Register.CS2: 0x000480,
    Register.CS3: 0x000480,
    Register.CS4: 0x000480,
}
_READ_ONLY = {Register.CHIP_ID, Register.STAT1, Register.STAT0, Register.SADC_RESULT, Register.FSTAT}
_COMMANDS = 0x00000F  # MAIN bits that clear themselves
FAULTS = (
    "overflow",
    "underflow",
    "clock_error",
    "burst_error",
    "lost_words",
    "power_cycle",
    "wrong_chip",
    "bit_errors",
    "dead_irq",
    "stuck_irq",
    "unplugged",
)


class EmulatedChip:
    """The chip as a ``Link``: SPI transfer, reset line, interrupt line."""

    max_bytes = 4096

    def __init__(self, clock: Clock, signal: SignalSource, speed_hz: int | None = None) -> None:
        """``speed_hz``: bus clock whose time each transfer takes; None takes none (on the machine's own clock)."""
        self.faults: set[str] = set()  # those that last: dead_irq, stuck_irq, wrong_chip, bit_errors, unplugged
        self.commands: list[bytes] = []  # first four bytes of the latest transfers, for tests
        self._clock = clock
        self._signal = signal
        self._speed_hz = speed_hz
        self._in_reset = False
        self._errors = Gsr0(0)  # sticky: clock and burst errors
        self._next_transfer_fails = False
        self._power_on()

    # --- the link -------------------------------------------------------------------------------------------------

    def transfer(self, data: bytes) -> bytes:
        """One chip select period."""
        self.commands = [*self.commands[-63:], data[: reg.COMMAND_BYTES]]
        self._fifo.advance(self._clock.monotonic_s())
        reply = self._answer(data)
        if self._speed_hz:
            self._clock.sleep(8 * len(data) / self._speed_hz)
        return self._disturbed(reply)

    def set_reset(self, *, active: bool) -> None:
        """Active holds the chip in reset; registers, FIFO and errors are gone."""
        if active:
            self._power_on()
        self._in_reset = active

    def wait_irq(self, timeout_s: float) -> bool:
        """The line is high while more words than FIFO_CREF are there; sleeps on the clock until then."""
        end_s = self._clock.monotonic_s() + timeout_s
        self._fifo.prepare()
        while not self._irq_high():
            now_s = self._clock.monotonic_s()
            if now_s >= end_s:
                return False
            due_s = self._fifo.fill_exceeds_s(reg.FIFO_CREF.of(self._registers))
            if due_s <= now_s:  # high, were the line not dead
                due_s = math.inf
            self._clock.sleep(min(due_s, end_s) - now_s)
        return True

    def close(self) -> None:
        """Nothing to release."""

    # --- what a test or a drill does to it -------------------------------------------------------------------------

    def inject(self, fault: str) -> None:
        """Make one of ``FAULTS`` happen now; those that last are ended with ``heal``.

        Raises:
            ValueError: no such fault.
        """
        if fault not in FAULTS:
            raise ValueError(f"no fault {fault!r}; known: {', '.join(FAULTS)}")
        self._fifo.advance(self._clock.monotonic_s())
        events: dict[str, Callable[[], None]] = {
            "overflow": self._fifo.overflow,
            "underflow": self._fifo.underflow,
            "clock_error": self._fail_next_transfer,
            "burst_error": lambda: self._raise_error(Gsr0.BURST_ERROR),
            "lost_words": lambda: self._fifo.lose(7),
            "power_cycle": self._power_on,
        }
        if fault in events:
            events[fault]()
        else:
            self.faults.add(fault)

    def heal(self, fault: str) -> None:
        """End a fault that lasts."""
        self.faults.discard(fault)

    def _irq_high(self) -> bool:
        if self.faults & {"stuck_irq", "dead_irq", "unplugged"}:
            return "stuck_irq" in self.faults
        self._fifo.advance(self._clock.monotonic_s())
        return self._fifo.fill > reg.FIFO_CREF.of(self._registers)

    # --- inside -----------------------------------------------------------------------------------------------------

    def _power_on(self) -> None:
        self._registers = dict.fromkeys(range(Register.FIFO), 0) | {int(a): v for a, v in RESET_VALUES.items()}
        self._errors = Gsr0(0)
        self._fifo = EmulatedFifo(self._signal, self._clock)

    def _answer(self, data: bytes) -> bytes:
        """Status byte and content for one chip select period, with the data sheet's rules for wrong clock counts."""
        if self._in_reset or "unplugged" in self.faults:
            return bytes(len(data))
        status = 0xF0 | self._status()
        if self._next_transfer_fails or len(data) < reg.COMMAND_BYTES:  # 1 to 31 clocks: ignored
            self._next_transfer_fails = False
            self._raise_error(Gsr0.CLOCK_ERROR)
            return bytes([status, *bytes(len(data) - 1)])
        command = int.from_bytes(data[: reg.COMMAND_BYTES], "big")
        if reg.is_burst(command):
            return bytes([status, 0, 0, 0]) + self._burst(command, data[reg.COMMAND_BYTES :])
        if len(data) > reg.COMMAND_BYTES:  # more than 32 clocks: extra bits ignored
            self._raise_error(Gsr0.CLOCK_ERROR)
        address = command >> 25
        content = self._content(address)
        if command >> 24 & 1:
            self._write(address, command & 0xFFFFFF)
        return bytes([status]) + content.to_bytes(3, "big") + bytes(len(data) - reg.COMMAND_BYTES)

    def _burst(self, command: int, payload: bytes) -> bytes:
        start, write, bound = command >> 17 & 0x7F, command >> 16 & 1, command >> 9 & 0x7F
        words, rest = divmod(len(payload), reg.WORD_BYTES)
        if rest:
            self._raise_error(Gsr0.CLOCK_ERROR | (Gsr0.BURST_ERROR if bound else Gsr0(0)))
        elif bound and words != bound:
            self._raise_error(Gsr0.BURST_ERROR)
        if start < Register.FIFO:
            return self._register_burst(start, words, payload if write else b"") + bytes(rest)
        if write:  # not supported
            self._raise_error(Gsr0.BURST_ERROR)
            return bytes(len(payload))
        content = self._fifo.read(words)
        if rest:  # the word that was read in part is gone
            content += self._fifo.read(1)[:rest]
        return content

    def _register_burst(self, start: int, words: int, values: bytes) -> bytes:
        reply = b""
        for n in range(min(words, Register.FIFO - start)):
            reply += self._content(start + n).to_bytes(3, "big")
            if values:
                self._write(start + n, int.from_bytes(values[3 * n : 3 * n + 3], "big"))
        return reply.ljust(3 * words, b"\0")

    def _content(self, address: int) -> int:
        if address == Register.FSTAT:
            return self._fifo_flags() | min(self._fifo.fill, (1 << 14) - 1)
        if address == Register.STAT0:
            return reg.POWER_MODE.bits(PowerMode.ACTIVE if self._fifo.running else PowerMode.DEEP_SLEEP)
        if address == Register.STAT1:
            frame, group = self._fifo.counters
            return reg.FRAME_CNT.bits(frame % 4096) | reg.SHAPE_GRP_CNT.bits(group % 4096)
        if address == Register.CHIP_ID and "wrong_chip" in self.faults:
            return 0x000606
        return self._registers.get(address, 0)

    def _write(self, address: int, value: int) -> None:
        if address in _READ_ONLY or address >= Register.FIFO:
            return
        if address != Register.MAIN:
            self._registers[address] = value
            return
        self._registers[Register.MAIN] = value & ~_COMMANDS
        if reg.SW_RESET.value(value):
            self._power_on()
        elif reg.FIFO_RESET.value(value):
            self._fifo = EmulatedFifo(self._signal, self._clock)
        elif reg.FSM_RESET.value(value):
            self._fifo.stop()
        elif reg.FRAME_START.value(value) and reg.OSCCLKEN.of(self._registers):
            self._fifo.start(self._registers)

    def _status(self) -> Gsr0:
        status = self._errors
        if reg.MISO_HS_RD.of(self._registers):
            status |= Gsr0.HIGH_SPEED
        if self._fifo.overflowed or self._fifo.underflowed:
            status |= Gsr0.FIFO_ERROR
        return status

    def _fifo_flags(self) -> Fstat:
        fill = self._fifo.fill
        flags = {
            Fstat.CLOCK_ERROR: bool(self._errors & Gsr0.CLOCK_ERROR),
            Fstat.BURST_ERROR: bool(self._errors & Gsr0.BURST_ERROR),
            Fstat.UNDERFLOW: self._fifo.underflowed,
            Fstat.OVERFLOW: self._fifo.overflowed,
            Fstat.EMPTY: fill == 0,
            Fstat.CREF: fill > reg.FIFO_CREF.of(self._registers),
            Fstat.FULL: fill >= reg.FIFO_WORDS,
        }
        result = Fstat(0)
        for flag, is_set in flags.items():
            result |= flag if is_set else Fstat(0)
        return result

    def _fail_next_transfer(self) -> None:
        self._next_transfer_fails = True

    def _raise_error(self, error: Gsr0) -> None:
        self._errors |= error

    def _disturbed(self, reply: bytes) -> bytes:
        """Fault ``bit_errors``: every 500th byte on the wire arrives with a flipped bit."""
        if "bit_errors" not in self.faults or len(reply) < 500:
            return reply
        data = np.frombuffer(reply, np.uint8).copy()
        data[499::500] ^= 0x10
        return data.tobytes()
