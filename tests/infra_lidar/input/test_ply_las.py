"""PLY and LAS files: every form of them, written here byte by byte or by laspy, and what is refused."""

from __future__ import annotations

import contextlib
import io
import struct
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.bus.status import Report
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.pcd import FrameError
from services.infra_lidar.input.point_files import parse_frame
from services.infra_lidar.input.senders import print_senders
from services.infra_lidar.input.source import open_source

ROWS = np.array([[1.0, 2.0, 3.0, 40.0, 5.0], [-1.0, 0.5, 0.25, 255.0, 127.0]], np.float32)
PROPERTIES = (("float", "x"), ("float", "y"), ("double", "z"), ("uchar", "intensity"), ("ushort", "ring"))
NUMPY = {"float": "f4", "double": "f8", "uchar": "u1", "ushort": "u2"}


def ply(form: str = "binary_little_endian", rows: np.ndarray = ROWS, before: str = "", between: bytes = b"") -> bytes:
    lines = [f"ply\nformat {form} 1.0\ncomment made here\n{before}element vertex {len(rows)}"]
    lines += [f"property {kind} {name}" for kind, name in PROPERTIES]
    head = "\n".join([*lines, "element face 1", "property list uchar int vertex_indices", "end_header\n"]).encode()
    if form == "ascii":
        return (
            head
            + between
            + "\n".join(" ".join(f"{value:g}" for value in row) for row in rows).encode()
            + b"\n3 0 1 0\n"
        )
    order = ">" if "big" in form else "<"
    record = np.zeros(len(rows), [(name, order + NUMPY[kind]) for kind, name in PROPERTIES])
    for k, (_, name) in enumerate(PROPERTIES):
        record[name] = rows[:, k]
    return head + between + record.tobytes() + b"\x03" + bytes(12)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_of_every_form(form: str) -> None:
    np.testing.assert_array_equal(parse_frame("a.ply", ply(form)).points, ROWS)


def test_elements_before_the_points_are_passed_over() -> None:
    before = "element pose 2\nproperty float x\nproperty float y\n"
    np.testing.assert_array_equal(parse_frame("a.ply", ply(before=before, between=bytes(16))).points, ROWS)
    np.testing.assert_array_equal(parse_frame("a.ply", ply("ascii", before=before, between=b"0 0\n0 0\n")).points, ROWS)


def test_ply_without_intensity_and_ring() -> None:
    data = ply().replace(b"uchar intensity", b"uchar red").replace(b"ushort ring", b"ushort green")
    np.testing.assert_array_equal(parse_frame("a.ply", data).points, ROWS[:, :3])


def test_ply_in_capitals() -> None:
    data = ply()
    for _, name in PROPERTIES:
        data = data.replace(f" {name}\n".encode(), f" {name.upper()}\n".encode())
    np.testing.assert_array_equal(parse_frame("a.ply", data).points, ROWS)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no header of a PLY file"),
        (ply()[:60], "no header of a PLY file"),
        (ply().replace(b"float x", b"float a"), "no property x among a y z intensity ring"),
        (ply().replace(b"element vertex 2", b"element vertex 0"), "0 points"),
        (
            ply().replace(b"element vertex 2", b"element vertex 9"),
            "9 points of 19 bytes are announced, 51 bytes",
        ),
        (ply("ascii").replace(b"element vertex 2", b"element vertex 9"), "9 points are announced, 3 lines follow"),
        (ply("ascii").replace(b"property ushort ring\n", b""), "5 numbers a line, 4 expected"),
        (ply("ascii").replace(b"1 2 3 40 5\n", b"\n \n"), "the number of columns changed"),
        (ply().replace(b"uchar intensity", b"list uchar int many"), "vertex.many is a list"),
        (ply().replace(b"element vertex", b"element point"), "no element vertex"),
        (ply().replace(b"float y", b"float x"), "property x twice in element vertex, expected once"),
        (ply().replace(b"float y", b"float X"), "property x twice in element vertex, expected once"),
        (ply().replace(b"binary_little_endian", b"xml"), "format xml: expected"),
        (ply().replace(b"float x", b"string x"), "'property string x' is no property of PLY"),
        (ply("ascii").replace(b"1 2 3 40 5", b"1 two 3 40 5"), "two"),
        (ply(rows=ROWS * [1e6, 1e6, 1e6, 1, 1]), "are these millimetres"),
    ],
)
def test_a_wrong_ply_is_refused_in_words(data: bytes, words: str) -> None:
    with pytest.raises(FrameError) as raised:
        parse_frame("a.ply", data)
    assert str(raised.value).startswith("a.ply: ")
    assert words in str(raised.value)


# --- LAS ---


def las(rows: np.ndarray = ROWS, compress: bool = False, ring: bool = True, point_format: int = 3) -> bytes:
    laspy = pytest.importorskip("laspy", reason="needs the extra las")
    header = laspy.LasHeader(point_format=point_format, version="1.4" if point_format > 5 else "1.2")
    header.scales, header.offsets = np.full(3, 0.001), np.floor(rows[:, :3].min(axis=0))
    if ring:
        header.add_extra_dim(laspy.ExtraBytesParams("ring", "u1"))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = rows[:, :3].T.astype(float)
    cloud.intensity = rows[:, 3].astype(np.uint16)
    if ring:
        cloud["ring"] = rows[:, 4].astype(np.uint8)
    buffer = io.BytesIO()
    cloud.write(buffer, do_compress=compress)
    return buffer.getvalue()


@pytest.mark.parametrize("point_format", [1, 3, 6])
def test_las(point_format: int) -> None:
    np.testing.assert_allclose(parse_frame("a.las", las(point_format=point_format)).points, ROWS, atol=1e-3)
    assert parse_frame("a.LAS", las(ring=False, point_format=point_format)).points.shape == (2, 4)


def test_laz() -> None:
    pytest.importorskip("lazrs", reason="needs the extra laz")
    np.testing.assert_allclose(parse_frame("a.laz", las(compress=True)).points, ROWS, atol=1e-3)


def test_a_laz_that_announces_more_chunks_than_points_is_refused() -> None:
    """Else the library would ask for memory for them all, and the process would end without it."""
    pytest.importorskip("lazrs", reason="needs the extra laz")
    data = bytearray(las(compress=True))
    points_at = struct.unpack_from("<I", data, 96)[0]
    table_at = struct.unpack_from("<q", data, points_at)[0]
    struct.pack_into("<I", data, table_at + 4, 1_000_000)
    with pytest.raises(FrameError, match="1000000 compressed chunks are announced for 2 points"):
        parse_frame("a.laz", bytes(data))


def test_a_panic_of_the_decompressor_is_damage_and_nothing_else_is(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("laspy", reason="needs the extra las")
    data = las()
    panic = type("PanicException", (BaseException,), {})  # as the library of Rust defines it
    for error, expected in ((panic("mid > len"), FrameError), (KeyboardInterrupt(), KeyboardInterrupt)):
        monkeypatch.setattr("laspy.read", Mock(side_effect=error))
        with pytest.raises(expected):
            parse_frame("a.las", data)


@settings(max_examples=150, deadline=None)
@given(changes=st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 255)), max_size=5), cut=st.floats(0.3, 3.0))
def test_damaged_laz_files_are_refused_or_read(changes: list[tuple[int, int]], cut: float) -> None:
    pytest.importorskip("lazrs", reason="needs the extra laz")
    data = bytearray(las(compress=True))
    for at, value in changes:
        data[at % len(data)] = value
    with contextlib.suppress(FrameError):
        parse_frame("a.laz", bytes(data[: int(cut * len(data))]))


def test_intensities_of_sixteen_bits_are_brought_to_eight() -> None:
    rows = ROWS * [1, 1, 1, 257, 1]
    np.testing.assert_allclose(parse_frame("a.las", las(rows)).points[:, 3], [40.0, 255.0], atol=0.01)


def test_without_the_extras_they_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    laspy: Any = pytest.importorskip("laspy", reason="needs the extra las")
    data, packed = las(), las(compress=True) if laspy.LazBackend.Lazrs.is_available() else b""
    monkeypatch.setattr("laspy.compression.LazBackend.is_available", lambda _: False)
    if packed:
        with pytest.raises(FrameError, match=r"compressed \(LAZ\): needs the extra `laz`"):
            parse_frame("a.laz", packed)
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(FrameError, match="needs the extra `las`"):
        parse_frame("a.las", data)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: b"", "no header of a LAS file"),
        (lambda: b"LASF" + bytes(300), "0 points"),
        (lambda: las()[:-10], "a.las: "),
        (lambda: las()[:283] + bytes(2) + las()[285:], "damaged LAS file (integer division"),  # a dimension of no bytes
        (lambda: las()[:100] + b"\xff" * 4 + las()[104:], "4294967295 records are announced"),
        (lambda: las(np.add(ROWS, [385_000.0, 5_819_000.0, 40.0, 0.0, 0.0])), "coordinates of a map? The sensor"),
    ],
)
def test_a_wrong_las_is_refused_in_words(make: Any, words: str) -> None:
    with pytest.raises(FrameError) as raised:
        parse_frame("a.las", make())
    assert words in str(raised.value)


@settings(max_examples=150, deadline=None)
@given(
    kind=st.sampled_from(["ply", "ply ascii", "las"]), share=st.floats(0, 1), wrong=st.binary(max_size=8),
    cut=st.booleans(),
)  # fmt: skip
def test_damaged_files_are_refused_or_read(kind: str, share: float, wrong: bytes, cut: bool) -> None:
    if kind == "las":
        pytest.importorskip("laspy", reason="needs the extra las")
    data = las() if kind == "las" else ply("ascii" if "ascii" in kind else "binary_little_endian")
    at = int(share * len(data))
    damaged = data[:at] if cut else data[:at] + wrong + data[at + len(wrong) :]
    with contextlib.suppress(FrameError):
        assert len(parse_frame(f"a.{kind[:3]}", damaged).points) <= 2


@pytest.mark.parametrize("suffix", ["ply", "PLY", "las"])
def test_they_are_sources_and_look_tells_of_them(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k in range(2):
        (tmp_path / f"{k}.{suffix}").write_bytes(las() if suffix == "las" else ply())
    frames = list(open_source(InfraLidarConfig(source=f"file:{tmp_path}?rate=0"), Report("test")))
    assert [len(frame.points) for _, frame in frames] == [2, 2]
    assert print_senders(str(tmp_path), 1.0)
    output = capsys.readouterr().out
    assert f"0.{suffix}: 2 points (x, y, z, intensity, ring), 1.1 to 3.7 m away" in output
    assert f'source = "file:{tmp_path}"' in output
    (tmp_path / f"wrong.{suffix}").write_bytes(b"wrong")
    assert not print_senders(str(tmp_path / f"wrong.{suffix}"), 1.0)
    assert "no header of a" in capsys.readouterr().out
