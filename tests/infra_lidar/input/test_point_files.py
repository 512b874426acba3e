"""Frame files: every layout we read, and what is refused."""

import contextlib
import io
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from services.infra_lidar.input.pcd import FrameError, lzf_decompress, parse_pcd
from services.infra_lidar.input.point_files import frame_files, parse_frame

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
    rows = np.abs(np.random.default_rng(0).normal(0, 10, (5, 4))).astype(np.float32)
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


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"stamp": np.arange(2.0)}, r"stamp has shape \(2,\), expected one number, the UTC seconds of the frame"),
        ({"stamp": np.array("noon")}, "stamp is of type <U4, expected numbers"),
        ({"ring": np.array(["a", "b"])}, "ring is of type <U1, expected numbers"),
        ({"intensity": np.ones(3)}, r"intensity has shape \(3,\), expected \(2,\), a value for each point"),
        ({"range_mm": np.ones(3)}, r"range_mm has shape \(3,\), expected \(2,\), a value for each point"),
        ({"xyz": np.full((2, 3), "a")}, "xyz is of type <U1, expected numbers"),
        ({"xyz": np.full((2, 3), None)}, "xyz is damaged, or not of numbers"),
    ],
)
def test_npz_of_other_arrays_is_refused_in_words(arrays, words):
    with pytest.raises(FrameError, match=words):
        parse_frame("a.npz", _npz(**({"xyz": ROWS[:, :3]} | arrays)))


def test_npz_of_a_frame_beside_arrays_of_other_things():
    data = _npz(xyz=ROWS[:, :3], stamp=np.array([12.5]), labels=np.array(["car", None]))
    assert parse_frame("a.npz", data).stamp_s == 12.5


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


def _npy(array, version=None):
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, version)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 5), ", "the array is damaged, or not of numbers"),
        ("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 5)) }", "the array is damaged, or not of numbers"),
        ("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 6), }", "the array is damaged, or not of numbers"),
        ("{'descr': '<f4', 'fortran_order': False, 'shape': (-2, 5), }", "the array is damaged, or not of numbers"),
        ("{'descr': '<U1', 'fortran_order': False, 'shape': (2, 5), }", "the array is of type <U1, expected numbers"),
        ("{'descr': '<f4', 'fortran_order': False, 'shape': (10,), }", r"an array of shape \(10,\), expected \(N, 3"),
    ],
)
def test_npy_of_a_wrong_header_is_refused_in_words(header, words):
    text = header.ljust(117).encode() + b"\n"
    data = b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text + ROWS.tobytes()
    with pytest.raises(FrameError, match=words):
        parse_frame("a.npy", data)


_DAMAGED = [
    ("a.npy", _npy(ROWS)),
    ("a.npy", _npy(ROWS.astype(int), (2, 0))),
    ("a.npz", _npz(xyz=ROWS[:, :3], intensity=ROWS[:, 3], ring=ROWS[:, 4], stamp=np.float64(1.0))),
    ("a.npz", _npz(xyz_cm=np.ones((2, 3), np.int16), range_mm=np.ones(2))),
    ("a.pcd", _pcd("ascii", b"1 2 3 4 5\n1 2 3 4 5\n")),
    ("a.pcd", _pcd("binary", bytes(36))),
    ("a.pcd", _pcd("binary_compressed", struct.pack("<II", 38, 36) + _lzf_literals(bytes(36)))),
]


@pytest.mark.filterwarnings("ignore")  # numpy warns of headers that are no longer written like that
@settings(max_examples=500, deadline=None)
@given(
    which=st.sampled_from(_DAMAGED),
    changes=st.lists(st.tuples(st.integers(0, 2000), st.sampled_from([*b"\0\n (['9-", 255])), max_size=4),
    cut=st.floats(0.1, 4.0),
)
def test_damaged_frames_are_read_or_refused(which, changes, cut):
    name, data = which[0], bytearray(which[1])
    for at, value in changes:
        data[at % len(data)] = value
    with contextlib.suppress(FrameError):
        parse_frame(name, bytes(data[: int(cut * len(data))]))


# --- nothing is guessed ---


def _cloud(rows=4000):
    """A street: x, y over 40 m, heights of 2 m, intensity 0..255, ring 0..127, time within 0.1 s."""
    rng = np.random.default_rng(1)
    return np.column_stack(
        [
            rng.uniform(-40, 40, rows), rng.uniform(-40, 40, rows), rng.uniform(-2, 0.5, rows),
            rng.integers(0, 256, rows), rng.integers(0, 128, rows), rng.uniform(0, 0.1, rows),
        ]
    ).astype(np.float32)  # fmt: skip


@pytest.mark.parametrize("columns", [3, 4, 5])
@pytest.mark.parametrize("rows", [4000, 4001, 4003])
def test_the_usual_layouts_show_in_the_numbers(columns, rows):
    cloud = _cloud(rows)[:, :columns]
    assert np.array_equal(parse_frame("a.bin", cloud.tobytes()).points, cloud)


@pytest.mark.parametrize("rows", [4000, 4001, 4003, 4005])
@pytest.mark.parametrize("picked", [[0, 1, 2, 3, 5], [0, 1, 2, 3, 4, 5], [0, 1, 2, 5]])
def test_other_layouts_are_asked_for(picked, rows):
    data = _cloud(rows)[:, picked].tobytes()
    if picked == [0, 1, 2, 5]:
        assert parse_frame("a.bin", data).points.shape == (rows, 4)  # a time is as good a fourth column as any
        return
    with pytest.raises(FrameError, match=r"\?columns=x,y,z"):
        parse_frame("a.bin", data)
    names = ("x", "y", "z", "intensity", *(["time"] if len(picked) == 5 else ["ring", "time"]))
    points = parse_frame("a.bin", data, names).points
    assert np.array_equal(points, _cloud(rows)[:, : 4 if len(picked) == 5 else 5])


def test_named_columns_in_any_order():
    cloud = _cloud(100)
    points = parse_frame("a.bin", cloud[:, [4, 2, 1, 0]].tobytes(), ("ring", "z", "y", "x")).points
    assert np.array_equal(points[:, :3], cloud[:, :3])
    assert np.array_equal(points[:, 4], cloud[:, 4])
    with pytest.raises(FrameError, match="with x, y and z are expected"):
        parse_frame("a.bin", cloud[:, :3].tobytes(), ("a", "b", "c"))


def test_npy():
    buffer = io.BytesIO()
    np.save(buffer, _cloud(50)[:, :5])
    assert np.array_equal(parse_frame("a.npy", buffer.getvalue()).points, _cloud(50)[:, :5])
    buffer = io.BytesIO()
    np.save(buffer, _cloud(50))
    with pytest.raises(FrameError, match=r"6 columns: say what the columns are"):
        parse_frame("a.npy", buffer.getvalue())
    assert parse_frame("a.npy", buffer.getvalue(), ("x", "y", "z", "intensity", "ring", "_")).points.shape == (50, 5)


@pytest.mark.parametrize("suffix", ["npz", "bin"])
def test_millimetres_are_refused(suffix):
    cloud = _cloud(500)[:, :3] * 1000.0
    data = _npz(xyz=cloud) if suffix == "npz" else cloud.tobytes()
    with pytest.raises(FrameError, match="are these millimetres"):
        parse_frame(f"a.{suffix}", data)


def test_points_that_are_no_number_are_left_out():
    xyz = np.array([[1, 2, 3], [np.nan] * 3, [4, 5, 6]], np.float32)
    assert parse_frame("a.npz", _npz(xyz=xyz)).points.tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        (3, -3, "no intensity: expected 0 to 65535, found -3"),
        (3, np.nan, "no intensity: expected 0 to 65535, found nan"),
        (3, 70000, "no intensity: expected 0 to 65535, found 70000"),
        (4, 256, "no ring: whole numbers from 0 to 255 are expected, found 256"),
        (4, 0.5, "no ring: whole numbers from 0 to 255 are expected, found 0.5"),
    ],
)
def test_a_column_that_is_none_is_told_with_what_was_found(column, value, words):
    cloud = _cloud(2000)[:, :5]
    cloud[7, column] = value
    with pytest.raises(FrameError, match=words):
        parse_frame("a.npy", _npy(cloud))


@pytest.mark.parametrize(("value", "npz"), [(40_000, 255), (255, 255), (0.5, 0.5)])
def test_intensities_are_as_in_the_file_or_clipped(value, npz):
    """As the module says: .bin, .npy and .pcd keep them, .npz and .ply clip them."""
    cloud = _cloud(10)[:, :4]
    cloud[:, 3] = value
    header = "FIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 10\nDATA binary\n"
    as_it_is = {"a.bin": cloud.tobytes(), "a.npy": _npy(cloud), "a.pcd": header.encode() + cloud.tobytes()}
    for name, data in as_it_is.items():
        assert (parse_frame(name, data).points[:, 3] == value).all(), name
    assert (parse_frame("a.npz", _npz(xyz=cloud[:, :3], intensity=cloud[:, 3])).points[:, 3] == npz).all()


def test_only_the_learned_model_of_a_folder_is_no_frame(tmp_path):
    for name in ("background.npz", "background_0001.npz", "backgrounds.npz", "a.npz"):
        (tmp_path / name).write_bytes(b"")
    assert [path.name for path in frame_files(tmp_path)] == ["a.npz", "background_0001.npz", "backgrounds.npz"]


def _text(rows=ROWS):
    return "\n".join(" ".join(f"{v:g}" for v in row) for row in rows).encode()


def test_pcd_of_an_organised_cloud_without_points():
    data = _pcd("ascii", _text(np.tile(ROWS, (3, 1)))).replace(b"WIDTH 2\nHEIGHT 1", b"WIDTH 3\nHEIGHT 2")
    data = data.replace(b"POINTS 2\n", b"")
    assert len(parse_pcd(data)) == 6


def test_pcd_with_eight_byte_time_and_a_padding_of_nothing():
    record = np.zeros(2, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u8")])
    record["x"], record["t"] = ROWS[:, 0], 1 << 60
    data = _pcd("binary", record.tobytes(), "X Y Z t _", "4 4 4 8 1", "F F F U U", "1 1 1 1 0")
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
    assert change[0] in _pcd("ascii", _text())
    with pytest.raises(FrameError) as told:
        parse_frame("a.pcd", _pcd("ascii", _text()).replace(*change))
    assert words in str(told.value)


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
        parse_frame("a.pcd", _pcd("binary_compressed", body))
