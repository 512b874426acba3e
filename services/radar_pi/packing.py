"""FIFO words <-> frames: 12-bit unpacking, the header of each chirp, resynchronisation after lost words.

One 24-bit word holds two samples, the first in the upper half. With the data header on, each chirp begins with three
words: zero (real data that is all zero is altered to 1, so that this stays unique); frame count[23:12] and chirp
count[11:0]; samples per chirp[23:12], sensor ADC[11:2], shape[1:0]. Samples of the active receivers are interleaved.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from services.radar_pi.registers import WORD_BYTES

HEADER_WORDS = 3
COUNTER_SPAN = 1 << 12
UNDERFLOW_SAMPLE = 0xFFF
LFSR_START = 0x001


@dataclass(frozen=True)
class Layout:
    """Shape of a frame in the FIFO."""

    rx: int
    chirps: int
    samples: int

    def __post_init__(self) -> None:
        if self.rx * self.samples % 2:
            raise ValueError(f"{self.rx} receivers x {self.samples} samples: an odd number does not fill whole words")

    @property
    def chirp_words(self) -> int:
        """Words of one chirp with its header."""
        return HEADER_WORDS + self.rx * self.samples // 2

    @property
    def chirp_bytes(self) -> int:
        return self.chirp_words * WORD_BYTES

    @property
    def frame_words(self) -> int:
        return self.chirps * self.chirp_words


@dataclass(frozen=True)
class PackedFrame:
    """The bytes of one complete frame, every header checked."""

    data: np.ndarray  # (chirps, chirp_bytes) uint8
    count: int  # the chip's frame counter, modulo 4096
    sensor_adc: int  # raw reading of the chip's temperature sensor in the last chirp, 0..1023


def unpack_words(data: bytes | np.ndarray) -> np.ndarray:
    """24-bit words as bytes (3 n,) -> samples (2 n,) uint16; no header expected."""
    raw = np.frombuffer(data, np.uint8)
    return _unpack(raw.reshape(1, -1), 0).ravel()


def unpack_frame(packed: np.ndarray, layout: Layout) -> np.ndarray:
    """Frame as bytes (chirps, chirp_bytes) uint8 with headers -> (rx, chirp, sample) uint16, 0..4095."""
    pairs = _unpack(np.ascontiguousarray(packed), HEADER_WORDS * WORD_BYTES)
    by_sample = pairs.reshape(layout.chirps, layout.samples, layout.rx)
    return np.ascontiguousarray(by_sample.transpose(2, 0, 1))


def pack_words(samples: np.ndarray) -> np.ndarray:
    """Samples (..., 2 n) uint16 below 4096 -> bytes (..., 3 n) uint8."""
    pairs = samples.reshape(*samples.shape[:-1], -1, 2).astype(np.uint32)
    words = pairs[..., 0] << 12 | pairs[..., 1]
    as_bytes = np.stack((words >> 16, words >> 8 & 0xFF, words & 0xFF), axis=-1).astype(np.uint8)
    return as_bytes.reshape(*samples.shape[:-1], -1)


def pack_frame(frame: np.ndarray, count: int, sensor_adc: int = 512, shape: int = 0) -> np.ndarray:
    """(rx, chirp, sample) uint16 -> what the chip puts into its FIFO: (chirps, chirp_bytes) uint8 with headers."""
    rx, chirps, samples = frame.shape
    data = pack_words(frame.transpose(1, 2, 0).reshape(chirps, samples * rx)).reshape(chirps, -1, WORD_BYTES)
    data[~data.any(axis=-1), -1] = 1  # keeps the sync word unique
    header = np.zeros((chirps, HEADER_WORDS), np.uint32)
    header[:, 1] = (count % COUNTER_SPAN) << 12 | np.arange(chirps)
    header[:, 2] = samples << 12 | sensor_adc << 2 | shape
    head = np.stack((header >> 16, header >> 8 & 0xFF, header & 0xFF), axis=-1).astype(np.uint8)
    return np.concatenate((head, data), axis=1).reshape(chirps, -1)


def lfsr_sequence(length: int, state: int = LFSR_START) -> np.ndarray:
    """The chip's 12-bit test pattern (x^12 + x^11 + x^10 + x^4 + 1, period 4095): (length,) uint16.

    Each next word is the last one shifted right with bit0 ^ bit1 ^ bit2 ^ bit8 on top.
    """
    words = np.empty(length, np.uint16)
    for n in range(length):
        words[n] = state
        top = (state ^ state >> 1 ^ state >> 2 ^ state >> 8) & 1
        state = state >> 1 | top << 11
    return words


class FrameAssembler:
    """Bursts of words -> complete frames. Words lost on the way cost the frame they belong to, not the stream.

    ``lost_words`` counts what was thrown away. ``position`` is the place in the frame (in words) of the next word from
    the chip, or ``None`` while no header has been found.
    """

    def __init__(self, layout: Layout) -> None:
        self.lost_words = 0
        self._layout = layout
        self._pending = np.empty(0, np.uint8)  # bytes of a chirp that is not complete
        self._chirps: list[np.ndarray] = []  # (n, chirp_bytes) each, of the frame that is not complete
        self._next_chirp = 0
        self._count: int | None = None  # frame counter of that frame; None = whatever comes first
        self._broken = False  # its beginning was lost
        self._synced = True  # the first word after a start is a header

    @property
    def position(self) -> int | None:
        if not self._synced:
            return None
        return self._next_chirp * self._layout.chirp_words + self._pending.size // WORD_BYTES

    def feed(self, data: bytes | np.ndarray) -> Iterator[PackedFrame]:
        """Take the words of one burst (whole words); yields the frames that they complete."""
        self._pending = np.concatenate((self._pending, np.frombuffer(data, np.uint8)))
        while self._synced or self._find_header():
            size = self._layout.chirp_bytes
            whole = self._pending.size // size
            if not whole:
                return
            blocks = self._pending[: whole * size].reshape(whole, size)
            good = self._count_expected(blocks)
            self._pending = self._pending[good * size :]
            yield from self._take(blocks[:good])
            if good < whole:
                self._lose_sync()

    def _count_expected(self, blocks: np.ndarray) -> int:
        """How many of the chirps, from the first, have the header that has to come next and no second one inside."""
        head = header_fields(blocks)
        frame, chirp = np.divmod(self._next_chirp + np.arange(len(blocks)), self._layout.chirps)
        count = head[0, 1] if self._count is None else self._count
        data = blocks[:, HEADER_WORDS * WORD_BYTES :]
        fits = (
            (head[:, 0] == 0)
            & (head[:, 1] == (count + frame) % COUNTER_SPAN)
            & (head[:, 2] == chirp)
            & (head[:, 3] == self._layout.samples)
            & (data[:, 0::3] | data[:, 1::3] | data[:, 2::3]).all(axis=1)
        )
        return len(blocks) if fits.all() else int(np.argmin(fits))

    def _take(self, blocks: np.ndarray) -> Iterator[PackedFrame]:
        while len(blocks):
            if self._count is None:
                self._count = int(header_fields(blocks[:1])[0, 1])
            new = blocks[: self._layout.chirps - self._next_chirp]
            blocks = blocks[len(new) :]
            self._chirps.append(new)
            self._next_chirp += len(new)
            if self._next_chirp == self._layout.chirps:
                yield from self._finish()

    def _finish(self) -> Iterator[PackedFrame]:
        data, count, broken = np.concatenate(self._chirps), self._count or 0, self._broken
        self._chirps, self._next_chirp, self._broken = [], 0, False
        self._count = (count + 1) % COUNTER_SPAN
        if broken:
            self.lost_words += len(data) * self._layout.chirp_words
        else:
            yield PackedFrame(data, count, int(header_fields(data[-1:])[0, 4]))

    def _lose_sync(self) -> None:
        """The block at hand is damaged: the search goes on behind its first word."""
        self.lost_words += sum(map(len, self._chirps)) * self._layout.chirp_words
        self._chirps, self._synced = [], False
        self._drop(1)

    def _find_header(self) -> bool:
        """Drop words up to the next header and take its counters; False when there is none yet."""
        words = _as_words(self._pending)
        start = _first_header(words, self._layout)
        if start is None:
            self._drop(max(len(words) - HEADER_WORDS + 1, 0))
            return False
        self._drop(start)
        self._count, self._next_chirp = int(words[start + 1] >> 12), int(words[start + 1] & 0xFFF)
        self._broken = self._next_chirp > 0
        self._synced = True
        return True

    def _drop(self, words: int) -> None:
        self.lost_words += words
        self._pending = self._pending[words * WORD_BYTES :]


def header_fields(blocks: np.ndarray) -> np.ndarray:
    """Chirps (n, chirp_bytes) uint8 -> (n, 5) int64: sync word, frame count, chirp count, samples, sensor ADC."""
    words = _as_words(blocks[:, : HEADER_WORDS * WORD_BYTES].ravel()).reshape(-1, HEADER_WORDS)
    sync, counters, content = words.T
    fields = (sync, counters >> 12, counters & 0xFFF, content >> 12, content >> 2 & 0x3FF)
    return np.stack(fields, axis=1)


def _first_header(words: np.ndarray, layout: Layout) -> int | None:
    """Index of the first sync word with plausible counters behind it and, if already there, a sync one chirp later."""
    for start in np.flatnonzero(words[: len(words) - HEADER_WORDS + 1] == 0):
        counters, content = words[start + 1], words[start + 2]
        after = start + layout.chirp_words
        followed = after >= len(words) or words[after] == 0
        if (counters & 0xFFF) < layout.chirps and content >> 12 == layout.samples and followed:
            return int(start)
    return None


def _as_words(data: np.ndarray) -> np.ndarray:
    """Bytes (3 n + rest,) uint8 -> words (n,) int64."""
    parts = data[: data.size // WORD_BYTES * WORD_BYTES].reshape(-1, WORD_BYTES).astype(np.int64)
    return parts[:, 0] << 16 | parts[:, 1] << 8 | parts[:, 2]


def _unpack(rows: np.ndarray, offset: int) -> np.ndarray:
    """Rows (n, offset + 3 w) uint8, contiguous -> (n, 2 w) uint16.

    Each word is read twice as a big-endian 16-bit number, at its first and at its second byte: that leaves one shift
    and one mask, no intermediate arrays.
    """
    width = (rows.shape[1] - offset) // WORD_BYTES
    shape, strides = (rows.shape[0], width), (rows.shape[1], WORD_BYTES)
    samples = np.empty((*shape, 2), np.uint16)
    if samples.size:
        first = np.ndarray(shape, ">u2", rows.data, offset, strides)
        second = np.ndarray(shape, ">u2", rows.data, offset + 1, strides)
        np.right_shift(first, 4, out=samples[..., 0])
        np.bitwise_and(second, 0xFFF, out=samples[..., 1])
    return samples.reshape(rows.shape[0], -1)
