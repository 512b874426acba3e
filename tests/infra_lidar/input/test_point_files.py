"""Frame files: every layout we read, and what is refused."""

import contextlib
import io
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.input.pcd import FrameError
from services.infra_lidar.input.point_files import frame_files, parse_frame
from tests.infra_lidar.made_frames import ROWS, lzf_literals, npy, npz, pcd


def test_two_rows_with_rings_are_enough_to_tell():
    assert np.array_equal(parse_frame("a.bin", ROWS.tobytes()).points, ROWS)


def test_a_name_of_nanoseconds_is_the_stamp():
    assert parse_frame("1700000000123456789.bin", ROWS.tobytes()).stamp_s == pytest.approx(1700000000.1234567)
    assert parse_frame("000123.bin", ROWS.tobytes()).stamp_s is None


def test_npz_of_a_list_of_points():
    frame = parse_frame("a.npz", npz(xyz=ROWS[:, :3], intensity=ROWS[:, 3], ring=ROWS[:, 4], stamp=np.float64(12.5)))
    assert np.array_equal(frame.points, ROWS)
    assert frame.stamp_s == 12.5
    assert parse_frame("a.npz", npz(xyz=ROWS[:, :3])).points.shape == (2, 3)
    assert parse_frame("a.npz", npz(xyz=ROWS[:, :3].astype(np.float16))).points.dtype == np.float32


def test_npz_of_an_organised_cloud_keeps_returns_only_and_takes_rows_for_rings():
    xyz = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    range_mm = np.array([[0, 1, 1, 0], [1, 0, 0, 1]], np.uint32)
    frame = parse_frame("a.npz", npz(xyz=xyz, range_mm=range_mm, reflectivity=np.full((2, 4), 300, np.uint16)))
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
        parse_frame("a.npz", npz(**({"xyz": ROWS[:, :3]} | arrays)))


def test_npz_of_a_frame_beside_arrays_of_other_things():
    data = npz(xyz=ROWS[:, :3], stamp=np.array([12.5]), labels=np.array(["car", None]))
    assert parse_frame("a.npz", data).stamp_s == 12.5


def test_npz_in_centimetres():
    frame = parse_frame("a.npz", npz(xyz_cm=np.array([[100, -250, 3]], np.int16)))
    assert np.allclose(frame.points, [[1.0, -2.5, 0.03]])


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.bin", b""),
        ("a.bin", b"abc"),
        ("a.bin", b"\x00" * 28),
        ("a.npz", b"PK\x03\x04 damaged"),
        ("a.npz", npz(other=np.zeros(3))),
        ("a.npz", npz(xyz=np.zeros((4, 2)))),
        ("a.npz", npz(xyz=np.zeros((4, 3)), ring=np.zeros(3))),
        ("a.pcd", b"VERSION 0.7\nFIELDS x y z\n"),
        ("a.pcd", pcd("binary", b"too short")),
        ("a.pcd", pcd("smoke", b"")),
        ("a.pcd", pcd("ascii", b"1 2 3 4 5", points=0)),
        ("a.pcd", pcd("binary_compressed", struct.pack("<II", 4, 36) + b"\xff\xff\xff\xff")),
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
    ("a.npy", npy(ROWS)),
    ("a.npy", npy(ROWS.astype(int), (2, 0))),
    ("a.npz", npz(xyz=ROWS[:, :3], intensity=ROWS[:, 3], ring=ROWS[:, 4], stamp=np.float64(1.0))),
    ("a.npz", npz(xyz_cm=np.ones((2, 3), np.int16), range_mm=np.ones(2))),
    ("a.pcd", pcd("ascii", b"1 2 3 4 5\n1 2 3 4 5\n")),
    ("a.pcd", pcd("binary", bytes(36))),
    ("a.pcd", pcd("binary_compressed", struct.pack("<II", 38, 36) + lzf_literals(bytes(36)))),
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
@pytest.mark.parametrize("rows", [60, 61, 100, 4000, 4001, 4003])
def test_the_usual_layouts_show_in_the_numbers(columns, rows):
    cloud = _cloud(rows)[:, :columns]
    assert np.array_equal(parse_frame("a.bin", cloud.tobytes()).points, cloud)


@pytest.mark.parametrize("rows", [60, 61, 4000, 4001, 4003, 4005])
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


def test_rows_of_nine_are_not_taken_for_rows_of_three():
    data = np.column_stack([_cloud(200), _cloud(200)[:, [3, 5, 5]]]).astype(np.float32).tobytes()
    with pytest.raises(FrameError, match="the numbers look like rows of 9: say what the columns are"):
        parse_frame("a.bin", data)


def test_too_few_numbers_tell_nothing():
    with pytest.raises(FrameError, match="6 float32 values do not tell how long the rows are: say what the columns"):
        parse_frame("a.bin", ROWS[:, :3].tobytes())
    assert np.array_equal(parse_frame("a.bin", ROWS[:, :3].tobytes(), ("x", "y", "z")).points, ROWS[:, :3])


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
    data = npz(xyz=cloud) if suffix == "npz" else cloud.tobytes()
    with pytest.raises(FrameError, match="are these millimetres"):
        parse_frame(f"a.{suffix}", data)


def test_points_that_are_no_number_are_left_out():
    xyz = np.array([[1, 2, 3], [np.nan] * 3, [4, 5, 6]], np.float32)
    assert parse_frame("a.npz", npz(xyz=xyz)).points.tolist() == [[1, 2, 3], [4, 5, 6]]


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
        parse_frame("a.npy", npy(cloud))


@pytest.mark.parametrize(("value", "clipped"), [(40_000, 255), (255, 255), (0.5, 0.5)])
def test_intensities_are_as_in_the_file_or_clipped(value, clipped):
    """As the module says: .bin, .npy and .pcd keep them, .npz and .ply clip them."""
    cloud = _cloud(10)[:, :4]
    cloud[:, 3] = value
    header = "FIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 10\nDATA binary\n"
    as_it_is = {"a.bin": cloud.tobytes(), "a.npy": npy(cloud), "a.pcd": header.encode() + cloud.tobytes()}
    for name, data in as_it_is.items():
        assert (parse_frame(name, data).points[:, 3] == value).all(), name
    assert (parse_frame("a.npz", npz(xyz=cloud[:, :3], intensity=cloud[:, 3])).points[:, 3] == clipped).all()


def test_only_the_learned_model_of_a_folder_is_no_frame(tmp_path):
    for name in ("background.npz", "background_0001.npz", "backgrounds.npz", "a.npz"):
        (tmp_path / name).write_bytes(b"")
    assert [path.name for path in frame_files(tmp_path)] == ["a.npz", "background_0001.npz", "backgrounds.npz"]
