"""The driver of the BGT60TR13C: start-up, bursts on interrupt, recovery, clean stop.

    hardware reset -> chip id -> software reset -> register list -> link self-test -> FIFO mark -> FRAME_START
    interrupt -> burst -> status byte -> headers -> frame -> FSTAT -> stamp

The FIFO mark equals the burst and the burst divides the frame, so a frame's last words raise an interrupt when its last
sample is converted: nothing waits for the next frame. Every fault names its cure (``chip.Cure``); a cure that does not
help is followed by the next stronger one.
"""

from __future__ import annotations

import logging
from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from common.bus.status import Report
from common.messages import Motion
from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.chip import Chip, ChipRefused, Cure, RadarFault
from services.radar_pi.chip.exports import Plan
from services.radar_pi.chip.interrupt import InterruptLine
from services.radar_pi.chip.link import Clock, Link
from services.radar_pi.chip.packing import (
    COUNTER_SPAN,
    FrameAssembler,
    Layout,
    PackedFrame,
    lfsr_sequence,
    unpack_frame,
    unpack_words,
)
from services.radar_pi.chip.registers import Fstat, Register
from services.radar_pi.chip.schedule import WordSchedule, burst_words
from services.radar_pi.chip.stamps import FrameStamps

log = logging.getLogger("driver")

POLL_S = 0.5e-3
DUE_MARGIN_S = 50e-6  # the first look comes so long after the words were due
IRQ_GRACE_S = 2e-3  # an interrupt later than this is looked for in FSTAT
STALL_S = 0.1  # no words for so long after they were due: the chip has stopped
SELF_TEST_WORDS = 256
SELF_TEST_TRIES = 3
SELF_TEST_POLLS = 10
CURES_PER_STEP = 3  # so often is a cure tried before the next stronger one: the host may just be busy
MAX_CURES = 12  # without a frame in between


class RadarFrame(NamedTuple):
    """One frame from the chip."""

    stamp_ns: int  # UTC of the start of the first chirp
    received_ns: int  # UTC when the frame was complete in memory
    samples: np.ndarray  # (rx, chirp, sample) uint16, 0..4095
    epoch: int  # rises whenever the chip was restarted: what was learned before is void
    note: str  # what is wrong with the link although frames arrive; empty if nothing
    motion: Motion | None = None  # of a recording of the bus: how the vehicle was known to move


class Driver:
    """One chip, from one thread. ``frames()`` runs until the generator is closed."""

    def __init__(
        self, link: Link, clock: Clock, plan: Plan, speed_hz: int, report: Report, first_epoch: int = 1
    ) -> None:
        self.epoch = first_epoch - 1
        self._link = link
        self._clock = clock
        self._plan = plan
        self._report = report
        self._chip = Chip(link, clock, speed_hz)
        self._layout = Layout(len(plan.waveform.rx), plan.waveform.chirps, plan.waveform.samples)
        self._schedule = WordSchedule(plan.timing, self._layout.rx)
        self._burst = burst_words(self._layout, link.max_bytes)
        self._irq = InterruptLine()
        self._self_test_text = self._register_text = ""

    def frames(self) -> Generator[RadarFrame]:
        """Frames for ever; every fault is reported and cured.

        Raises:
            ChipRefused: another chip, or none.
            RadarFault: not even a hardware reset helps.
            OSError: the bus is gone.
        """
        try:
            self._restart(Cure.HARDWARE_RESET)
            cures = 0  # since the last frame
            while True:
                try:
                    yield self._next_frame()
                    cures = 0
                except RadarFault as fault:
                    self._recover(fault, cures)
                    cures += 1
        finally:
            self._stop()

    # --- start, recovery, stop ---------------------------------------------------------------------------------------

    def _restart(self, cure: Cure) -> None:
        """Bring the chip to FRAME_START from the depth that the cure asks for."""
        if cure >= Cure.HARDWARE_RESET:
            self._chip.reset_hardware()
            self._chip.check_identity()
        if cure >= Cure.SOFTWARE_RESET:
            self._chip.reset_software()
            self._register_text = self._chip.configure(self._registers())
        if cure >= Cure.HARDWARE_RESET:
            self._self_test()
        self._chip.write(Register.MAIN, self._main(reg.FIFO_RESET))
        self._chip.write(Register.MAIN, self._main(reg.FRAME_START))
        self.epoch += 1
        self._assembler = FrameAssembler(self._layout)
        self._stamps = FrameStamps(self._plan.timing)
        self._origin_s, self._base_words = self._clock.monotonic_s(), 0
        self._words_without_frame, self._adrift = 0, False
        self._last_count: int | None = None

    def _recover(self, fault: RadarFault, cures: int) -> None:
        """Restart with the fault's cure, or a stronger one after several that brought no frame.

        Raises:
            RadarFault: nothing helps.
        """
        if cures >= MAX_CURES or isinstance(fault, ChipRefused):
            raise fault
        if fault.name == "fifo_underflow":
            self._irq.distrust()
        cure = Cure(min(fault.cure + cures // CURES_PER_STEP, Cure.HARDWARE_RESET))
        name = cure.name.lower().replace("_", " ")
        self._report.bad_input(fault.name)
        self._report.state("degraded", f"{fault}; {name}, clutter background starts again")
        log.warning("%s: %s; %s", fault.name, fault, name)
        try:
            self._restart(cure)
        except RadarFault as again:
            self._recover(again, cures + 1)

    def _stop(self) -> None:
        """State machine reset, then let go of the lines; same thread as everything else."""
        try:
            self._chip.write(Register.MAIN, self._main(reg.FSM_RESET))
        except OSError as error:
            log.warning("could not stop the chip: %s", error)
        self._link.close()

    def _registers(self) -> reg.Registers:
        sfctl = self._chip.high_speed | reg.PREFIX_EN.bits(1) | reg.FIFO_CREF.bits(self._burst - 1)
        keep = reg.QSPI_WT.mask | reg.FIFO_LP_MODE.mask
        return self._plan.registers | {
            Register.SFCTL: (self._plan.registers[Register.SFCTL] & keep) | sfctl,
            Register.MAIN: self._main(),
        }

    def _main(self, command: reg.Field | None = None) -> int:
        base = self._plan.registers[Register.MAIN] & ~0xF
        return base | (command.bits(1) if command else 0)

    def _self_test(self) -> None:
        """The chip's test pattern through FIFO and SPI; a link that fails is used, but never called good."""
        words = min(SELF_TEST_WORDS, self._layout.chirps * self._layout.samples // 2)
        for attempt in range(SELF_TEST_TRIES):
            if attempt:  # it may have lost its power, and with it the registers, in the middle of the last one
                self._register_text = self._chip.configure(self._registers())
            wrong = self._test_pattern_errors(words)
            if not wrong:
                self._self_test_text = ""
                break
            self._report.bad_input("link_self_test")
            self._self_test_text = f"link self-test: {wrong} of {2 * words} samples wrong; lower [spi] speed_hz"

    def _test_pattern_errors(self, words: int) -> int:
        """Samples that differ from the pattern, with receiver 1 alone and no headers."""
        registers = self._registers()
        test = registers[Register.SFCTL] & ~reg.PREFIX_EN.mask
        test = reg.FIFO_CREF.put(test, words - 1) | reg.LFSR_EN.bits(1)
        self._chip.write(Register.CS1_U_1, reg.BBCH_SEL.put(registers[Register.CS1_U_1], 1))
        self._chip.write(Register.SFCTL, test)
        self._chip.write(Register.MAIN, self._main(reg.FRAME_START))
        self._clock.sleep(WordSchedule(self._plan.timing, rx=1, header_words=0).ready_s(words) + DUE_MARGIN_S)
        for _ in range(SELF_TEST_POLLS):  # the interrupt line is not part of this test
            if self._chip.fifo_status() & Fstat.CREF:
                break
            self._clock.sleep(POLL_S)
        _, data = self._chip.burst(words)
        self._chip.write(Register.MAIN, self._main(reg.FIFO_RESET))
        self._chip.write(Register.SFCTL, registers[Register.SFCTL])
        self._chip.write(Register.CS1_U_1, registers[Register.CS1_U_1])
        return int(np.count_nonzero(unpack_words(data) != lfsr_sequence(2 * words)))

    # --- frames ------------------------------------------------------------------------------------------------------

    def _next_frame(self) -> RadarFrame:
        """Read bursts until a frame is complete and FSTAT vouches for it."""
        while True:
            words = self._burst_size()
            seen_s = self._wait_for(words)
            status, data = self._chip.burst(words)
            self._chip.check_burst(status)
            lost = self._assembler.lost_words
            frames = list(self._assembler.feed(data))
            self._count_words(words, self._assembler.lost_words - lost)
            if frames:
                self._chip.fifo_status()
                return self._stamped(frames[-1], seen_s)

    def _burst_size(self) -> int:
        """A whole burst, or what is missing to the next boundary after words were lost."""
        position = self._assembler.position
        return self._burst - (position % self._burst if position is not None else 0)

    def _wait_for(self, words: int) -> float:
        """Wait for the interrupt, or for FSTAT where the line is not trusted; returns the moment (clock)."""
        due_s = self._due_s(words) + DUE_MARGIN_S
        now_s = self._clock.monotonic_s()
        give_up_s = max(due_s, now_s) + STALL_S + (self._plan.timing.frame_period_s if self._adrift else 0.0)
        wait_s = max(due_s + (IRQ_GRACE_S if self._irq.trusted else 0.0) - now_s, 0.0)
        while True:
            said = self._link.wait_irq(wait_s)
            now_s = self._clock.monotonic_s()
            if said and self._irq.trusted:
                self._irq.strikes = 0
                return now_s
            ready = bool(self._chip.fifo_status() & Fstat.CREF)
            self._irq.compare(said=said, truth=ready)
            if ready:
                return now_s
            if now_s > give_up_s:
                raise RadarFault("stalled", f"no data {STALL_S * 1e3:.0f} ms after it was due", Cure.HARDWARE_RESET)
            wait_s = max(due_s - now_s, POLL_S)
            if said:  # a line that is stuck high does not wait
                self._clock.sleep(wait_s)

    def _due_s(self, words: int) -> float:
        """When the next ``words`` are in the FIFO, by the schedule since the last frame's end (or FRAME_START)."""
        position = self._assembler.position or 0
        return self._origin_s + self._schedule.ready_s(self._base_words + position + words)

    def _count_words(self, words: int, lost: int) -> None:
        """Report lost words; a stream in which no header is found for three frames is no stream."""
        self._report.bad_input("lost_words", lost)
        self._adrift = self._adrift or lost > 0
        self._words_without_frame += words
        if self._words_without_frame > 3 * self._layout.frame_words:
            raise RadarFault("no_sync", "no complete frame in three frames' words", Cure.SOFTWARE_RESET)

    def _stamped(self, packed: PackedFrame, seen_s: float) -> RadarFrame:
        """Unpack and stamp; the frame's end is the new origin of the schedule (the crystals drift apart)."""
        end_s = self._stamps.end_s(packed.count, seen_s)
        self._origin_s = end_s - self._schedule.ready_s(self._layout.frame_words)
        self._base_words, self._words_without_frame, self._adrift = self._layout.frame_words, 0, False
        if self._last_count is not None:
            self._report.dropped((packed.count - self._last_count - 1) % COUNTER_SPAN)
        self._last_count = packed.count
        samples = unpack_frame(packed.data, self._layout)
        received_ns = self._clock.utc_ns()
        age_s = self._clock.monotonic_s() - end_s + self._plan.timing.first_chirp_to_end_s
        return RadarFrame(received_ns - round(age_s * 1e9), received_ns, samples, self.epoch, self._note())

    def _note(self) -> str:
        polling = "" if self._irq.trusted else "interrupt line is not to be trusted: polling; check [spi] irq_gpio"
        return "; ".join(filter(None, (self._register_text, self._self_test_text, polling)))
