"""FIFO words to frames: the bit layout, the headers, and a stream with holes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from services.radar_pi.chip.packing import (
    FrameAssembler,
    Layout,
    header_fields,
    lfsr_sequence,
    pack_frame,
    pack_words,
    unpack_frame,
    unpack_words,
)

LAYOUT = Layout(rx=3, chirps=8, samples=16)  # 27 words a chirp, 216 a frame


def _frames(count: int, layout: Layout = LAYOUT, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.integers(0, 4096, (layout.rx, layout.chirps, layout.samples), np.uint16) for _ in range(count)]


def _stream(frames: list[np.ndarray], first_count: int = 0) -> np.ndarray:
    """All words of the frames: (n, 3) uint8."""
    return np.concatenate([pack_frame(f, first_count + n).reshape(-1, 3) for n, f in enumerate(frames)])


def _assemble(words: np.ndarray, burst: int, layout: Layout = LAYOUT) -> tuple[dict[int, np.ndarray], FrameAssembler]:
    """Frames by their counter, as they come out of bursts of that many words."""
    assembler = FrameAssembler(layout)
    packed = [p for n in range(0, len(words), burst) for p in assembler.feed(words[n : n + burst].tobytes())]
    return {p.count: unpack_frame(p.data, layout) for p in packed}, assembler


def _unpack_slowly(data: bytes) -> list[int]:
    """The data sheet's layout, byte by byte."""
    samples = []
    for n in range(0, len(data), 3):
        b0, b1, b2 = data[n : n + 3]
        samples += [b0 << 4 | b1 >> 4, (b1 & 15) << 8 | b2]
    return samples


def test_first_sample_is_in_the_upper_half_of_the_word() -> None:
    assert unpack_words(bytes.fromhex("abc123 000fff fff000")).tolist() == [0xABC, 0x123, 0, 0xFFF, 0xFFF, 0]


@given(st.binary(max_size=300).map(lambda b: b[: len(b) // 3 * 3]))
def test_unpacking_equals_the_slow_reference(data: bytes) -> None:
    assert unpack_words(data).tolist() == _unpack_slowly(data)


@given(st.lists(st.integers(0, 4095), max_size=100).map(lambda s: s[: len(s) // 2 * 2]))
def test_packing_and_unpacking_are_inverse(samples: list[int]) -> None:
    packed = pack_words(np.array(samples, np.uint16))
    assert unpack_words(packed.tobytes()).tolist() == samples


def test_receivers_are_interleaved_sample_by_sample() -> None:
    layout = Layout(rx=3, chirps=1, samples=2)
    frame = np.array([[[11, 12]], [[21, 22]], [[31, 32]]], np.uint16)  # (rx, chirp, sample)
    packed = pack_frame(frame, count=5, sensor_adc=700)
    assert unpack_words(packed[0, 9:].tobytes()).tolist() == [11, 21, 31, 12, 22, 32]
    assert unpack_frame(packed, layout).tolist() == frame.tolist()


def test_header_of_each_chirp() -> None:
    packed = pack_frame(_frames(1)[0], count=4097, sensor_adc=700, shape=1)
    assert packed[3, :9].tobytes().hex(" ", 3) == "000000 001003 010af1"  # sync; frame 1, chirp 3; 16 samples, 700, 1
    assert header_fields(packed)[3].tolist() == [0, 1, 3, 16, 700]


def test_data_that_is_all_zero_is_altered_so_that_the_sync_word_stays_unique() -> None:
    packed = pack_frame(np.zeros((3, 8, 16), np.uint16), count=1)
    words = packed.reshape(8, -1, 3)
    assert np.flatnonzero(~words.any(axis=2)).tolist() == [27 * n for n in range(8)]
    assert np.unique(unpack_frame(packed, LAYOUT)).tolist() == [0, 1]


@pytest.mark.parametrize("layout", [Layout(3, 64, 128), Layout(2, 16, 512), Layout(1, 32, 64), Layout(3, 4, 2)])
def test_any_layout_survives_the_round_trip(layout: Layout) -> None:
    (frame,) = _frames(1, layout)
    frame = np.maximum(frame, 1)
    assert np.array_equal(unpack_frame(pack_frame(frame, 9), layout), frame)


def test_an_odd_number_of_samples_does_not_fill_whole_words() -> None:
    with pytest.raises(ValueError, match="1 receivers x 3 samples"):
        Layout(1, 4, 3)


def test_test_pattern_has_the_data_sheets_words_and_period() -> None:
    pattern = lfsr_sequence(2 * 4095)
    assert [f"{w:03x}" for w in pattern[:8]] == ["001", "800", "400", "200", "100", "880", "440", "220"]
    assert len(set(pattern[:4095].tolist())) == 4095
    assert np.array_equal(pattern[:4095], pattern[4095:])


# --- assembling -------------------------------------------------------------------------------------------------------


@settings(max_examples=50)
@given(st.integers(7, 500), st.integers(0, 4095))
def test_bursts_of_any_size_give_the_same_frames(burst: int, first_count: int) -> None:
    frames = _frames(4)
    found, assembler = _assemble(_stream(frames, first_count), burst)
    assert list(found) == [(first_count + n) % 4096 for n in range(4)]
    assert all(np.array_equal(f, g) for f, g in zip(found.values(), map(_unzeroed, frames), strict=True))
    assert assembler.lost_words == 0
    assert assembler.position == 0


@settings(max_examples=50)
@given(st.integers(7, 300), st.integers(0, 5 * 216 - 1), st.integers(1, 60))
@example(burst=27, start=624, length=25)  # the end of a frame and the next sync word
def test_lost_words_cost_the_frames_they_were_in_and_no_other(burst: int, start: int, length: int) -> None:
    frames = _frames(6)
    stream = _stream(frames)
    length = min(length, 5 * 216 - start)
    found, assembler = _assemble(np.delete(stream, slice(start, start + length), axis=0), burst)
    end = start + length
    hit = set(range(start // 216, (end - 1) // 216 + 1))
    # Without the sync word behind its end, a frame takes the words after it for its own: known limit.
    unseen = {frame for frame in hit if start <= 216 * (frame + 1) < end}
    assert set(range(6)) - hit <= set(found) <= set(range(6)) - hit | unseen
    assert all(np.array_equal(found[n], _unzeroed(frames[n])) for n in set(found) - unseen)
    assert assembler.lost_words == 216 * (6 - len(found)) - length
    assert assembler.position == 0


@settings(max_examples=50)
@given(st.integers(7, 300), st.integers(0, 5 * 216 - 1), st.binary(min_size=3, max_size=90))
def test_wrong_words_never_damage_another_frame(burst: int, start: int, noise: bytes) -> None:
    frames = _frames(6)
    extra = np.frombuffer(noise[: len(noise) // 3 * 3], np.uint8).reshape(-1, 3)
    stream = np.insert(_stream(frames), [start] * len(extra), extra, axis=0)
    found, _ = _assemble(stream, burst)
    place = start % 216
    touched = {start // 216} if place else {start // 216 - 1, start // 216}
    untouched = set(range(6)) - touched - {max(touched) + 1}  # noise may look like a header and cost the next one
    assert untouched <= set(found)
    assert all(np.array_equal(found[n], _unzeroed(frames[n])) for n in untouched)


def test_a_stream_that_begins_in_the_middle_waits_for_the_next_frame() -> None:
    stream = _stream(_frames(3))[100:]
    found, assembler = _assemble(stream, 64)
    assert list(found) == [1, 2]
    assert assembler.lost_words == 116


def test_position_tells_where_the_next_word_belongs() -> None:
    stream = _stream(_frames(2))
    assembler = FrameAssembler(LAYOUT)
    assert assembler.position == 0
    assert not list(assembler.feed(stream[:40].tobytes()))
    assert assembler.position == 40
    assert not list(assembler.feed(stream[50:60].tobytes()))  # ten words lost: not noticed before the next header
    assert not list(assembler.feed(stream[60:80].tobytes()))
    assert assembler.position is None or assembler.position == 80
    list(assembler.feed(stream[80:100].tobytes()))
    assert assembler.position == 100


def test_garbage_without_header_is_dropped_word_by_word() -> None:
    assembler = FrameAssembler(LAYOUT)
    assert not list(assembler.feed(b"\xff" * 3 * 1000))
    assert assembler.position is None
    assert assembler.lost_words >= 990
    frames = list(assembler.feed(_stream(_frames(2)).tobytes()))
    assert [p.count for p in frames] == [0, 1]


def _unzeroed(frame: np.ndarray) -> np.ndarray:
    """What the chip makes of a frame: a word of two zero samples becomes 0, 1."""
    return unpack_frame(pack_frame(frame, 0), LAYOUT)
