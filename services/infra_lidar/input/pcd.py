"""Point Cloud Library files to arrays. Bytes in, (N, 3..5) float32 out: x, y, z, intensity, ring; no I/O."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence

import numpy as np

_PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8", ("U", 1): "<u1", ("U", 2): "<u2", ("U", 4): "<u4", ("U", 8): "<u8",
              ("I", 1): "<i1", ("I", 2): "<i2", ("I", 4): "<i4", ("I", 8): "<i8"}  # fmt: skip
MAX_POINTS = 5_000_000


class FrameError(ValueError):
    """A frame file that cannot be read; the text says why."""


def parse_pcd(data: bytes) -> np.ndarray:
    """(N, 3..5) float32 of a Point Cloud Library file: ascii, binary or binary_compressed (PCL's format, version 0.7).

    Raises:
        FrameError: damaged, or the header contradicts itself or lacks a coordinate.
    """
    header, body = _pcd_header(data)
    names, types, counts = _layout(header)
    count = _point_count(header)
    kind = header["DATA"][0]
    if kind == "ascii":
        fields = _ascii_columns(body, names, counts, count)
    elif kind == "binary":
        record = np.dtype([(n, t, (c,)) for n, t, c in zip(_unique(names), types, counts, strict=True)])
        if len(body) < count * record.itemsize:
            raise FrameError(f"{count} points of {record.itemsize} bytes are announced, {len(body)} bytes follow")
        rows = np.frombuffer(body, record, count)
        fields = {n: rows[n][:, 0] for n in record.names or () if rows[n].shape[1]}
    elif kind == "binary_compressed":
        fields = _pcd_columns(body, names, types, counts, count)
    else:
        raise FrameError(f"DATA {kind}: expected ascii, binary or binary_compressed")
    intensity = next((fields[n] for n in ("intensity", "i") if n in fields), None)
    ring = next((fields[n] for n in ("ring", "channel") if n in fields), None)
    return point_columns([fields[axis] for axis in "xyz"], intensity, ring)


def point_columns(xyz: Sequence[np.ndarray], intensity: np.ndarray | None, ring: np.ndarray | None) -> np.ndarray:
    """(N, 3..5) float32 of columns (N,): x, y, z, then intensity and ring, as many as there are.

    Where there is a ring and no intensity, the intensity is 0.
    """
    columns = list(xyz)
    if intensity is not None or ring is not None:
        columns.append(np.zeros(len(xyz[0])) if intensity is None else intensity)
    if ring is not None:
        columns.append(ring)
    points = np.empty((len(xyz[0]), len(columns)), np.float32)
    for k, column in enumerate(columns):
        points[:, k] = column
    return points


def _layout(header: dict[str, list[str]]) -> tuple[list[str], list[str], list[int]]:
    """Names, numpy types and counts of the fields: three lists of one length."""
    for line in ("FIELDS", "SIZE", "TYPE", "DATA"):
        if not header.get(line):
            raise FrameError(f"no {line} line in the header")
    names = [name.lower() for name in header["FIELDS"]]
    for line in ("SIZE", "TYPE", "COUNT"):
        if line in header and len(header[line]) != len(names):
            raise FrameError(f"{len(names)} FIELDS, {len(header[line])} {line}S")
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise FrameError(f"no field {' and '.join(missing)} among {' '.join(header['FIELDS'])}")
    types = [_type_of(letter, size) for letter, size in zip(header["TYPE"], _whole(header, "SIZE"), strict=True)]
    counts = _whole(header, "COUNT") if "COUNT" in header else [1] * len(names)
    for axis in "xyz":
        times = sum(count for name, count in zip(names, counts, strict=True) if name == axis)
        if times != 1:
            raise FrameError(f"{times} values of {axis} for each point, 1 expected")
    return names, types, counts


def _whole(header: dict[str, list[str]], line: str) -> list[int]:
    """The numbers of a line, at least one."""
    words = header[line]
    if not words or not all(word.isdigit() for word in words):
        raise FrameError(f"{line}: expected whole numbers, found {' '.join(words) or 'nothing'}")
    return [int(word) for word in words]


def _point_count(header: dict[str, list[str]]) -> int:
    """Number of points; WIDTH x HEIGHT and POINTS have to agree."""
    counts = {}
    if "WIDTH" in header:
        height = _whole(header, "HEIGHT")[0] if "HEIGHT" in header else 1
        counts["WIDTH x HEIGHT"] = _whole(header, "WIDTH")[0] * height
    if "POINTS" in header:
        counts["POINTS"] = _whole(header, "POINTS")[0]
    if len(set(counts.values())) != 1:
        raise FrameError(
            "; ".join(f"{name} says {count} points" for name, count in counts.items()) or "no WIDTH line in the header"
        )
    count = next(iter(counts.values()))
    if not 0 < count <= MAX_POINTS:
        raise FrameError(f"{count} points")
    return count


def _type_of(letter: str, size: int) -> str:
    if (letter, size) not in _PCD_TYPES:
        raise FrameError(f"no field of PCD has type {letter} and {size} bytes")
    return _PCD_TYPES[letter, size]


def _pcd_header(data: bytes) -> tuple[dict[str, list[str]], bytes]:
    header: dict[str, list[str]] = {}
    position = 0
    while "DATA" not in header:
        end = data.find(b"\n", position)
        if end < 0 or position > 10_000:
            raise FrameError("no DATA line in the header")
        words = data[position:end].decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        position = end + 1
    return header, data[position:]


def _unique(names: list[str]) -> list[str]:
    """Padding fields are all called ``_``: a record needs different names."""
    return [f"{name}{i}" if names.count(name) > 1 else name for i, name in enumerate(names)]


def text_table(body: bytes, skipped: int, count: int, width: int) -> np.ndarray:
    """(count, width) float64 of the numbers in the lines that follow ``skipped`` ones; empty lines do not count.

    Raises:
        FrameError: too few lines, or lines of another number of values.
    """
    lines = [line for line in body.splitlines() if line.strip()][skipped : skipped + count]
    if len(lines) < count:
        raise FrameError(f"{count} points are announced, {len(lines)} lines follow")
    table = np.loadtxt(io.BytesIO(b"\n".join(lines)), dtype=np.float64, comments=None, ndmin=2)
    if table.shape[1] != width:
        raise FrameError(f"{table.shape[1]} numbers a line, {width} expected")
    return table


def _ascii_columns(body: bytes, names: list[str], counts: list[int], count: int) -> dict[str, np.ndarray]:
    table = text_table(body, 0, count, sum(counts))
    starts = [sum(counts[:k]) for k in range(len(counts))]
    return {name: table[:, start] for name, start, repeat in zip(names, starts, counts, strict=True) if repeat}


def _pcd_columns(
    body: bytes, names: list[str], types: list[str], counts: list[int], count: int
) -> dict[str, np.ndarray]:
    """Columns of the format binary_compressed: two sizes, then all values of a field, field after field."""
    if len(body) < 8:
        raise FrameError(f"the sizes of the compressed data are 8 bytes, {len(body)} follow")
    packed, size = struct.unpack_from("<II", body)
    if len(body) - 8 < packed:
        raise FrameError(f"{packed} compressed bytes are announced, {len(body) - 8} follow")
    expected = sum(np.dtype(t).itemsize * c for t, c in zip(types, counts, strict=True)) * count
    if size != expected:
        raise FrameError(f"{size} bytes unpacked, {expected} expected")
    try:
        raw = lzf_decompress(body[8 : 8 + packed], size)
    except IndexError:
        raise FrameError("the compressed data end within a match") from None
    fields, position = {}, 0
    for name, kind, repeat in zip(names, types, counts, strict=True):
        if repeat:
            fields[name] = np.frombuffer(raw, kind, count * repeat, position)[::repeat]
            position += np.dtype(kind).itemsize * count * repeat
    return fields


def lzf_decompress(packed: bytes, size: int) -> bytes:
    """LibLZF: a control byte < 32 copies that many + 1 literals, else a match of length (c >> 5) + 2 that far back."""
    out = bytearray()
    i = 0
    while i < len(packed):
        control = packed[i]
        i += 1
        if control < 32:
            out += packed[i : i + control + 1]
            i += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += packed[i]
            i += 1
        start = len(out) - ((control & 31) << 8) - packed[i] - 1
        i += 1
        if start < 0 or len(out) > size:
            raise FrameError("damaged compressed data")
        for _ in range(length + 2):  # may overlap itself: byte by byte
            out.append(out[start])
            start += 1
    if len(out) != size:
        raise FrameError(f"compressed data give {len(out)} bytes, {size} expected")
    return bytes(out)
