"""Point Cloud Library files: every form that we read, and what is refused."""

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from services.infra_lidar.input.pcd import FrameError, lzf_decompress, parse_pcd
from services.infra_lidar.input.point_files import parse_frame
from tests.infra_lidar.made_frames import ROWS, lzf_literals, pcd, text


def test_pcd_ascii():
    text = "\n".join(" ".join(f"{v:g}" for v in row) for row in ROWS).encode()
    assert np.array_equal(parse_pcd(pcd("ascii", text)), ROWS)


def test_pcd_binary_with_padding():
    record = np.zeros(2, [("xyz", "<f4", 3), ("_", "u1", 4), ("intensity", "<f4"), ("ring", "<u2"), ("__", "u1", 2)])
    record["xyz"], record["intensity"], record["ring"] = ROWS[:, :3], ROWS[:, 3], ROWS[:, 4]
    layout = "x y z _ intensity ring _", "4 4 4 1 4 2 1", "F F F U F U U", "1 1 1 4 1 1 2"
    data = pcd("binary", record.tobytes(), layout)
    assert np.array_equal(parse_pcd(data), ROWS)


def test_pcd_compressed_stores_columns():
    raw = b"".join(ROWS[:, k].astype("<u2" if k == 4 else "<f4").tobytes() for k in range(5))
    packed = lzf_literals(raw)
    body = struct.pack("<II", len(packed), len(raw)) + packed
    assert np.array_equal(parse_pcd(pcd("binary_compressed", body)), ROWS)


@pytest.mark.parametrize(
    ("packed", "raw"),
    [
        (b"\x02abc", b"abc"),
        (b"\x00a\x20\x00", b"aaaa"),  # a match of three that overlaps itself
        (b"\x02abc\xe0\x02\x02", (b"abc" * 5)[:14]),  # a long match: 7 + 2 + 2 bytes, from three back
    ],
)
def test_lzf(packed, raw):
    assert lzf_decompress(packed, len(raw)) == raw


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, 400))
@example(cut=159)  # just behind the header
def test_truncated_files_are_refused_or_shorter(cut):
    data = pcd("ascii", "\n".join(" ".join(f"{v:g}" for v in row) for row in ROWS).encode())
    with contextlib.suppress(FrameError):
        assert len(parse_frame("a.pcd", data[:cut]).points) <= 2


def test_pcd_of_an_organised_cloud_without_points():
    data = pcd("ascii", text(np.tile(ROWS, (3, 1)))).replace(b"WIDTH 2\nHEIGHT 1", b"WIDTH 3\nHEIGHT 2")
    data = data.replace(b"POINTS 2\n", b"")
    assert len(parse_pcd(data)) == 6


def test_pcd_with_eight_byte_time_and_a_padding_of_nothing():
    record = np.zeros(2, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u8")])
    record["x"], record["t"] = ROWS[:, 0], 1 << 60
    data = pcd("binary", record.tobytes(), ("X Y Z t _", "4 4 4 8 1", "F F F U U", "1 1 1 1 0"))
    assert np.array_equal(parse_pcd(data)[:, 0], ROWS[:, 0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((b"POINTS 2", b"POINTS 1"), "WIDTH x HEIGHT says 2 points; POINTS says 1 points"),
        ((b"FIELDS x y z intensity ring", b"FIELDS x y height intensity ring"), "no field z among x y height"),
        ((b"TYPE F F F F U", b"TYPE F F F F Q"), "no field of PCD has type Q and 2 bytes"),
        ((b"FIELDS x y z intensity ring\n", b""), "no FIELDS line in the header"),
        ((b"TYPE F F F F U\n", b""), "no TYPE line in the header"),
        ((b"SIZE 4 4 4 4 2\n", b""), "no SIZE line in the header"),
        ((b"DATA ascii", b"DATA"), "no DATA line in the header"),
        ((b"TYPE F F F F U", b"TYPE F F"), "5 FIELDS, 2 TYPES"),
        ((b"SIZE 4 4 4 4 2", b"SIZE 4 4 4 4 2 2"), "5 FIELDS, 6 SIZES"),
        ((b"COUNT 1 1 1 1 1", b"COUNT 1 1 1"), "5 FIELDS, 3 COUNTS"),
        ((b"COUNT 1 1 1 1 1", b"COUNT 1 1 0 1 1"), "0 values of z for each point, 1 expected"),
        ((b"FIELDS x y z intensity", b"FIELDS x y z z"), "2 values of z for each point, 1 expected"),
        ((b"SIZE 4", b"SIZE four"), "SIZE: expected whole numbers, found four 4 4 4 2"),
        ((b"WIDTH 2", b"WIDTH"), "WIDTH: expected whole numbers, found nothing"),
        ((b"POINTS 2", b"POINTS -2"), "POINTS: expected whole numbers, found -2"),
        ((b"1 2 3 40 5\n-1 0.5 0.25 255 127", b"1 2\n3 4"), "2 numbers a line, 5 expected"),
        ((b"1 2 3 40 5\n", b"\n"), "2 points are announced, 1 lines follow"),
    ],
)
def test_a_pcd_that_contradicts_itself_is_refused_in_words(change, words):
    assert change[0] in pcd("ascii", text())
    with pytest.raises(FrameError) as raised:
        parse_frame("a.pcd", pcd("ascii", text()).replace(*change))
    assert words in str(raised.value)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"1234", "the sizes of the compressed data are 8 bytes, 4 follow"),
        (struct.pack("<II", 9, 36) + b"abc", "9 compressed bytes are announced, 3 follow"),
        (struct.pack("<II", 3, 36) + b"\0a\x20", "the compressed data end within a match"),
    ],
)
def test_a_compressed_pcd_that_is_cut_is_refused_in_words(body, words):
    with pytest.raises(FrameError, match=words):
        parse_frame("a.pcd", pcd("binary_compressed", body))
