"""FIFO words <-> frames: 12-bit unpacking, the header of each chirp, resynchronisation after lost words.

One 24-bit word holds two samples, the first in the upper half. With the data header on, each chirp begins with three
words: zero (real data that is all zero is altered to 1, so that this stays unique); frame count[23:12] and chirp
count[11:0]; samples per chirp[23:12], sensor ADC[11:2], shape[1:0]. Samples of the active receivers are interleaved.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from services.radar_pi.chip.registers import WORD_BYTES

HEADER_WORDS = 3
COUNTER_SPAN = 1 << 12
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
        """Bytes of one chirp in the FIFO."""
        return self.chirp_words * WORD_BYTES

    @property
    def frame_words(self) -> int:
        """FIFO words of one frame."""
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

    A word missing in one chirp shows at the next chirp's header; one missing in the last chirp as a sync word inside
    the data. ``lost_words`` counts what was thrown away.
    """

    def __init__(self, layout: Layout) -> None:
        self.lost_words = 0
        self._layout = layout
        self._buffer = bytearray()  # from the start of a chirp on, while in sync
        self._first_chirp = 0  # of the buffer: not 0 while the beginning of a frame is missing
        self._checked = 0  # chirps in the buffer whose header is right
        self._count: int | None = None  # frame counter; None = whatever comes first
        self._synced = True  # the first word after a start is a header

    @property
    def position(self) -> int | None:
        """Place in the frame (in words) of the next word from the chip; None while no header has been found."""
        if not self._synced:
            return None
        return self._first_chirp * self._layout.chirp_words + len(self._buffer) // WORD_BYTES

    def feed(self, data: bytes) -> Iterator[PackedFrame]:
        """Take the words of one burst (whole words); yields the frames that they complete."""
        self._buffer += data
        while self._synced or self._find_header():
            if not self._headers_fit():
                self._search_behind(max(self._checked - 1, 0))
            elif len(self._buffer) < (self._layout.chirps - self._first_chirp) * self._layout.chirp_bytes:
                return
            else:
                yield from self._finish()

    def _headers_fit(self) -> bool:
        """Check the headers that have come in since the last time."""
        size, head = self._layout.chirp_bytes, HEADER_WORDS * WORD_BYTES
        while (start := self._checked * size) + head <= len(self._buffer):
            chirp = self._first_chirp + self._checked
            if chirp == self._layout.chirps:
                break
            sync, counters, content = _words(self._buffer[start : start + head])
            if self._count is None:
                self._count = counters >> 12
            if sync or counters != self._count << 12 | chirp or content >> 12 != self._layout.samples:
                return False
            self._checked += 1
        return True

    def _finish(self) -> Iterator[PackedFrame]:
        """All chirps are there; hand the frame over unless its beginning is missing or it holds a second header."""
        chirps = self._layout.chirps - self._first_chirp
        end = chirps * self._layout.chirp_bytes
        blocks = np.frombuffer(bytes(self._buffer[:end]), np.uint8).reshape(chirps, -1)
        torn = _chirp_with_sync_inside(blocks)
        if torn is not None:
            self._search_behind(torn)
            return
        count, whole = self._count or 0, self._first_chirp == 0
        self._start_at(end, chirp=0, count=(count + 1) % COUNTER_SPAN)
        if whole:
            yield PackedFrame(blocks, count, int(header_fields(blocks[-1:])[0, 4]))
        else:
            self.lost_words += chirps * self._layout.chirp_words

    def _search_behind(self, block: int) -> None:
        """That chirp of the buffer is damaged: look for a header behind its first word."""
        drop = block * self._layout.chirp_words + 1
        self.lost_words += drop
        del self._buffer[: drop * WORD_BYTES]
        self._synced = False

    def _find_header(self) -> bool:
        """Drop words up to the next header and take its counters; False when there is none yet."""
        words = _as_words(np.frombuffer(bytes(self._buffer), np.uint8))
        start = _first_header(words, self._layout)
        if start is None:
            drop = max(len(words) - HEADER_WORDS + 1, 0)
            self.lost_words += drop
            del self._buffer[: drop * WORD_BYTES]
            return False
        self.lost_words += start
        counters = int(words[start + 1])
        self._start_at(start * WORD_BYTES, chirp=counters & 0xFFF, count=counters >> 12)
        self._synced = True
        return True

    def _start_at(self, offset: int, *, chirp: int, count: int) -> None:
        del self._buffer[:offset]
        self._first_chirp, self._checked, self._count = chirp, 0, count


def header_fields(blocks: np.ndarray) -> np.ndarray:
    """Chirps (n, chirp_bytes) uint8 -> (n, 5) int64: sync word, frame count, chirp count, samples, sensor ADC."""
    words = _as_words(blocks[:, : HEADER_WORDS * WORD_BYTES].ravel()).reshape(-1, HEADER_WORDS)
    sync, counters, content = words.T
    fields = (sync, counters >> 12, counters & 0xFFF, content >> 12, content >> 2 & 0x3FF)
    return np.stack(fields, axis=1)


def _chirp_with_sync_inside(blocks: np.ndarray) -> int | None:
    """Index of the first chirp (n, chirp_bytes) uint8 whose data holds an all-zero word."""
    data = blocks[:, HEADER_WORDS * WORD_BYTES :]
    clean = (data[:, 0::WORD_BYTES] | data[:, 1::WORD_BYTES] | data[:, 2::WORD_BYTES]).all(axis=1)
    return None if clean.all() else int(np.argmin(clean))


def _words(header: bytes | bytearray) -> tuple[int, int, int]:
    """Three words of a header; plain integers are faster than numpy for so few."""
    b = header
    return b[0] << 16 | b[1] << 8 | b[2], b[3] << 16 | b[4] << 8 | b[5], b[6] << 16 | b[7] << 8 | b[8]


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
    and one mask.
    """
    width = (rows.shape[1] - offset) // WORD_BYTES
    shape, strides = (rows.shape[0], width), (rows.shape[1], WORD_BYTES)
    samples = np.empty((*shape, 2), np.uint16)
    if samples.size:
        first = np.ndarray(shape, ">u2", rows.data, offset, strides)
        second = np.ndarray(shape, ">u2", rows.data, offset + 1, strides)
        samples[..., 0] = first >> 4
        samples[..., 1] = second & 0xFFF
    return samples.reshape(rows.shape[0], -1)
