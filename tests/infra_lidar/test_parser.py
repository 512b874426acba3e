"""Frame files: every layout we read, and what is refused."""

import contextlib
import io
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from services.infra_lidar.parser import FrameError, lzf_decompress, parse_frame, parse_pcd

ROWS = np.array([[1.0, 2.0, 3.0, 40.0, 5.0], [-1.0, 0.5, 0.25, 255.0, 127.0]], np.float32)


def _npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


@pytest.mark.parametrize("columns", [3, 4, 5])
def test_bin_rows(columns):
    frame = parse_frame("a.bin", ROWS[:, :columns].tobytes())
    if columns == 5:
        assert np.array_equal(frame.points, ROWS)
    assert frame.points.size == 2 * columns


def test_kitti_rows_whose_count_divides_by_five_are_not_taken_for_rings():
    rows = np.random.default_rng(0).normal(0, 10, (5, 4)).astype(np.float32)
    assert np.array_equal(parse_frame("000000.bin", rows.tobytes()).points, rows)


def test_a_name_of_nanoseconds_is_the_stamp():
    assert parse_frame("1700000000123456789.bin", ROWS.tobytes()).stamp_s == pytest.approx(1700000000.1234567)
    assert parse_frame("000123.bin", ROWS.tobytes()).stamp_s is None


def test_npz_of_a_list_of_points():
    frame = parse_frame("a.npz", _npz(xyz=ROWS[:, :3], intensity=ROWS[:, 3], ring=ROWS[:, 4], stamp=np.float64(12.5)))
    assert np.array_equal(frame.points, ROWS)
    assert frame.stamp_s == 12.5
    assert parse_frame("a.npz", _npz(xyz=ROWS[:, :3])).points.shape == (2, 3)
    assert parse_frame("a.npz", _npz(xyz=ROWS[:, :3].astype(np.float16))).points.dtype == np.float32


def test_npz_of_an_organised_cloud_keeps_returns_only_and_takes_rows_for_rings():
    xyz = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    range_mm = np.array([[0, 1, 1, 0], [1, 0, 0, 1]], np.uint32)
    frame = parse_frame("a.npz", _npz(xyz=xyz, range_mm=range_mm, reflectivity=np.full((2, 4), 300, np.uint16)))
    assert np.array_equal(frame.points[:, :3], xyz[range_mm > 0])
    assert frame.points[:, 4].tolist() == [0, 0, 1, 1]
    assert (frame.points[:, 3] == 255).all()


def test_npz_in_centimetres():
    frame = parse_frame("a.npz", _npz(xyz_cm=np.array([[100, -250, 3]], np.int16)))
    assert np.allclose(frame.points, [[1.0, -2.5, 0.03]])


def _pcd(kind, body, fields="x y z intensity ring", size="4 4 4 4 2", types="F F F F U", count="1 1 1 1 1", points=2):
    header = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {types}\nCOUNT {count}\n"
        f"WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {kind}\n"
    )
    return header.encode() + body


def test_pcd_ascii():
    text = "\n".join(" ".join(f"{v:g}" for v in row) for row in ROWS).encode()
    assert np.array_equal(parse_pcd(_pcd("ascii", text)), ROWS)


def test_pcd_binary_with_padding():
    record = np.zeros(2, [("xyz", "<f4", 3), ("_", "u1", 4), ("intensity", "<f4"), ("ring", "<u2"), ("__", "u1", 2)])
    record["xyz"], record["intensity"], record["ring"] = ROWS[:, :3], ROWS[:, 3], ROWS[:, 4]
    data = _pcd(
        "binary", record.tobytes(), "x y z _ intensity ring _", "4 4 4 1 4 2 1", "F F F U F U U", "1 1 1 4 1 1 2"
    )
    assert np.array_equal(parse_pcd(data), ROWS)


def _lzf_literals(raw):
    return b"".join(bytes([len(raw[i : i + 32]) - 1]) + raw[i : i + 32] for i in range(0, len(raw), 32))


def test_pcd_compressed_stores_columns():
    raw = b"".join(ROWS[:, k].astype("<u2" if k == 4 else "<f4").tobytes() for k in range(5))
    packed = _lzf_literals(raw)
    body = struct.pack("<II", len(packed), len(raw)) + packed
    assert np.array_equal(parse_pcd(_pcd("binary_compressed", body)), ROWS)


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


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.bin", b""),
        ("a.bin", b"abc"),
        ("a.bin", b"\x00" * 28),
        ("a.npz", b"PK\x03\x04 damaged"),
        ("a.npz", _npz(other=np.zeros(3))),
        ("a.npz", _npz(xyz=np.zeros((4, 2)))),
        ("a.npz", _npz(xyz=np.zeros((4, 3)), ring=np.zeros(3))),
        ("a.pcd", b"VERSION 0.7\nFIELDS x y z\n"),
        ("a.pcd", _pcd("binary", b"too short")),
        ("a.pcd", _pcd("smoke", b"")),
        ("a.pcd", _pcd("ascii", b"1 2 3 4 5", points=0)),
        ("a.pcd", _pcd("binary_compressed", struct.pack("<II", 4, 36) + b"\xff\xff\xff\xff")),
    ],
)
def test_what_cannot_be_read_is_refused_by_name(name, data):
    with pytest.raises(FrameError, match=r"a\.(bin|npz|pcd)"):
        parse_frame(name, data)


@settings(max_examples=100, deadline=None)
@given(data=st.binary(max_size=300), name=st.sampled_from(["a.bin", "a.npz", "a.pcd"]))
def test_garbage_is_read_or_refused(name, data):
    with contextlib.suppress(FrameError):
        assert parse_frame(name, data).points.shape[1] in (3, 4, 5)


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, 400))
@example(cut=159)  # just behind the header
def test_truncated_files_are_refused_or_shorter(cut):
    data = _pcd("ascii", "\n".join(" ".join(f"{v:g}" for v in row) for row in ROWS).encode())
    with contextlib.suppress(FrameError):
        assert len(parse_frame("a.pcd", data[:cut]).points) <= 2
