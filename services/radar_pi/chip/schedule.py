"""When each word of a frame is in the FIFO, by the programmed timing, and in which bursts it is read.

Emulator and driver share this table.
"""

from __future__ import annotations

from common.config import ConfigError
from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.packing import HEADER_WORDS, Layout
from services.radar_pi.chip.waveform import CLOCK_HZ, Timing


class WordSchedule:
    """Words since FRAME_START <-> seconds since FRAME_START.

    The header of a chirp is there with its first ADC trigger, a data word when its second sample is converted.
    """

    def __init__(self, timing: Timing, rx: int, header_words: int = HEADER_WORDS) -> None:
        self._timing = timing
        self._rx = rx
        self._header_words = header_words
        self.chirp_words = header_words + timing.samples * rx // 2
        self.frame_words = self.chirp_words * timing.chirps

    def ready_s(self, words: int) -> float:
        """Seconds after FRAME_START at which that many words have been produced."""
        frame, word = divmod(words - 1, self.frame_words)
        chirp, word = divmod(word, self.chirp_words)
        data_words = word + 1 - self._header_words
        conversions = -(-2 * max(data_words, 0) // self._rx)
        t = self._timing
        in_chirp = t.first_sample + conversions * t.adc_divider
        return (frame * t.frame + t.first_chirp + chirp * t.chirp + in_chirp) / CLOCK_HZ

    def produced(self, elapsed_s: float) -> int:
        """Words produced until then: the inverse of ``ready_s``."""
        t = self._timing
        clocks = int(elapsed_s * CLOCK_HZ + 0.5)  # a clock's half: what is due at this very moment is there
        frame, clocks = divmod(clocks, t.frame)
        if clocks < t.first_chirp:
            return frame * self.frame_words
        chirp, clocks = divmod(clocks - t.first_chirp, t.chirp)
        if chirp >= t.chirps:
            return (frame + 1) * self.frame_words
        return frame * self.frame_words + chirp * self.chirp_words + self._in_chirp(clocks)

    def frame_start_s(self, frame: int) -> float:
        """Start of a frame's first chirp."""
        return (frame * self._timing.frame + self._timing.first_chirp) / CLOCK_HZ

    def _in_chirp(self, clocks: int) -> int:
        since_first = clocks - self._timing.first_sample
        if since_first < 0:
            return 0
        conversions = min(since_first // self._timing.adc_divider, self._timing.samples)
        return self._header_words + conversions * self._rx // 2


def burst_words(layout: Layout, max_bytes: int) -> int:
    """The largest part of a frame that divides it, fits into one transfer and leaves most of the FIFO as reserve.

    Raises:
        ConfigError: the frame has no such part of at least 16 words.
    """
    limit = min((max_bytes - reg.COMMAND_BYTES) // reg.WORD_BYTES, reg.FIFO_WORDS // 8)
    words = next(n for n in range(min(limit, layout.frame_words), 0, -1) if layout.frame_words % n == 0)
    if words < min(16, layout.frame_words):
        text = f"{layout.frame_words} words of a frame cannot be cut into equal bursts of 16 to {limit} words"
        raise ConfigError(f"[waveform] chirps, samples: {text}; choose other numbers")
    return words
