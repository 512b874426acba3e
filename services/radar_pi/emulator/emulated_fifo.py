"""The emulated chip's state machine and FIFO: words appear on schedule, their content is made when it is read."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.link import Clock
from services.radar_pi.chip.packing import COUNTER_SPAN, HEADER_WORDS, lfsr_sequence, pack_frame, pack_words
from services.radar_pi.chip.registers import FIFO_WORDS, WORD_BYTES
from services.radar_pi.chip.schedule import WordSchedule
from services.radar_pi.chip.waveform import timing_of, waveform_of
from services.radar_pi.config import WaveformConfig

# (UTC seconds of the first chirp, programmed waveform) -> (rx, chirp, sample) uint16, 0..4095
SignalSource = Callable[[float, WaveformConfig], np.ndarray]


class EmulatedFifo:
    """Fill, overflow and underflow as counts of words since FRAME_START."""

    def __init__(self, signal: SignalSource, clock: Clock) -> None:
        self.running = False
        self.overflowed = False
        self.underflowed = False
        self._signal = signal
        self._clock = clock
        self._produced = 0
        self._consumed = 0
        self._frames: dict[int, bytes] = {}

    @property
    def fill(self) -> int:
        """Words that wait to be read."""
        return self._produced - self._consumed

    @property
    def counters(self) -> tuple[int, int]:
        """(frame count, chirp count) of STAT1."""
        if not self._produced:
            return 0, 0
        frame, word = divmod(self._produced, self._schedule.frame_words)
        return frame, word // self._schedule.chirp_words

    def start(self, registers: Mapping[int, int]) -> None:
        """FRAME_START; ignored while running."""
        if self.running:
            return
        self._registers = dict(registers)
        self._waveform = waveform_of(registers)
        self._with_header = bool(reg.PREFIX_EN.of(registers))
        header_words = HEADER_WORDS if self._with_header else 0
        self._schedule = WordSchedule(timing_of(registers), len(self._waveform.rx), header_words)
        self._last_frame = reg.MAX_FRAME_CNT.of(registers) or math.inf
        self._produced = self._consumed = 0
        self._start_utc_s = self._clock.utc_ns() * 1e-9
        self._frames = {0: self._make_frame(0)}  # before the clock starts: the first chirp is only 1 ms away
        self._start_s, self._start_utc_s = self._clock.monotonic_s(), self._clock.utc_ns() * 1e-9
        self.running = True

    def stop(self) -> None:
        """FSM reset: what is in the FIFO stays."""
        self.running = False

    def advance(self, now_s: float) -> None:
        """Let the time pass: new words, and the overflow that puts the chip to sleep with its FIFO full."""
        if not self.running:
            return
        words = self._schedule.produced(now_s - self._start_s)
        self._produced = int(min(words, self._last_frame * self._schedule.frame_words))
        if self.fill > FIFO_WORDS:
            self._produced = self._consumed + FIFO_WORDS
            self.overflowed, self.running = True, False

    def prepare(self) -> None:
        """Make the content of the next word's frame now, while there is time: the reader has none later."""
        if self.running:
            self._frame(self._consumed // self._schedule.frame_words)

    def fill_exceeds_s(self, mark: int) -> float:
        """Clock time at which more than ``mark`` words are there; infinity if never, the past if they are."""
        self.advance(self._clock.monotonic_s())
        if self.fill > mark:
            return -math.inf
        words = self._consumed + mark + 1
        if not self.running or mark >= FIFO_WORDS or words > self._last_frame * self._schedule.frame_words:
            return math.inf
        return self._start_s + self._schedule.ready_s(words)

    def read(self, words: int) -> bytes:
        """Take words out; those that are not there read as ones and set the underflow flag."""
        there = min(words, self.fill)
        data = self._content(self._consumed, there)
        self._consumed += there
        if there < words:
            self.underflowed = True
        return data.ljust(WORD_BYTES * words, b"\xff")

    def overflow(self) -> None:
        """As if the reader had been away: the FIFO is full and the chip asleep."""
        if self.running:
            self._produced = self._consumed + FIFO_WORDS
            self.overflowed, self.running = True, False

    def underflow(self) -> None:
        """As if somebody had read more than there was."""
        self._consumed = self._produced
        self.underflowed = True

    def lose(self, words: int) -> None:
        """Words vanish without an error flag."""
        self._consumed += min(words, self.fill)

    def _content(self, start: int, words: int) -> bytes:
        """Words by their number since FRAME_START."""
        parts = []
        while words:
            frame, offset = divmod(start, self._schedule.frame_words)
            count = min(words, self._schedule.frame_words - offset)
            parts.append(self._frame(frame)[offset * WORD_BYTES : (offset + count) * WORD_BYTES])
            start, words = start + count, words - count
        return b"".join(parts)

    def _frame(self, number: int) -> bytes:
        if number not in self._frames:
            self._frames = {n: data for n, data in self._frames.items() if n == number - 1}
            self._frames[number] = self._make_frame(number)
        return self._frames[number]

    def _make_frame(self, number: int) -> bytes:
        w = self._waveform
        if reg.LFSR_EN.of(self._registers):
            samples = self._signal(self._start_utc_s, w).copy()
            samples[0] = self._pattern(number, w)
        else:
            samples = self._signal(self._start_utc_s + self._schedule.frame_start_s(number), w)
        if self._with_header:
            return pack_frame(samples, number % COUNTER_SPAN).tobytes()
        return pack_words(samples.transpose(1, 2, 0).ravel()).tobytes()

    @staticmethod
    def _pattern(number: int, w: WaveformConfig) -> np.ndarray:
        """Test pattern instead of the first channel's samples."""
        per_frame = w.chirps * w.samples
        sequence = lfsr_sequence(4095)
        return sequence[(number * per_frame + np.arange(per_frame)) % 4095].reshape(w.chirps, w.samples)
