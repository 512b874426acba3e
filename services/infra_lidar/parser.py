"""Files of single frames to arrays: ``.npz``, ``.bin`` and ``.pcd``. Bytes in, (N, 5) float32 out; no I/O.

The columns are x, y, z in metres in the sensor frame, intensity 0..255 and ring. A ring of -1 in a file without rings
is never invented: such a cloud has four columns, one without intensity three.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from dataclasses import dataclass

import numpy as np

_PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8", ("U", 1): "<u1", ("U", 2): "<u2", ("U", 4): "<u4",
              ("I", 1): "<i1", ("I", 2): "<i2", ("I", 4): "<i4"}  # fmt: skip
MAX_POINTS = 5_000_000


class FrameError(ValueError):
    """A frame file that cannot be read; the text says why."""


@dataclass(frozen=True)
class FileFrame:
    """points: (N, 3..5) float32. stamp_s: UTC seconds as recorded, or None."""

    points: np.ndarray
    stamp_s: float | None = None


def parse_frame(name: str, data: bytes) -> FileFrame:
    """One file by its suffix; a ``.bin`` named by nanoseconds gives its stamp.

    Raises:
        FrameError: damaged, of a layout we do not know, or without points.
    """
    try:
        if name.endswith(".npz"):
            return parse_npz(data)
        if name.endswith(".pcd"):
            return FileFrame(parse_pcd(data), _stamp_in_name(name))
        return FileFrame(parse_bin(data), _stamp_in_name(name))
    except FrameError as error:
        raise FrameError(f"{name}: {error}") from None
    except (ValueError, LookupError, OSError, EOFError, struct.error, zipfile.BadZipFile, zlib.error) as error:
        raise FrameError(f"{name}: {error}") from error


def parse_bin(data: bytes) -> np.ndarray:
    """Raw float32 rows of 5 (x y z intensity ring), 4 (KITTI) or 3 columns; the count must divide, 5 is tried first.

    When several fit, the one wins whose last column looks like what it should be: rings are whole numbers 0..255.
    """
    values = np.frombuffer(data, "<f4") if len(data) % 4 == 0 else None
    if values is None or not len(values):
        raise FrameError(f"{len(data)} bytes are no rows of float32")
    if len(values) % 5 == 0:
        rows = values.reshape(-1, 5)
        ring = rows[:, 4]
        if ((ring >= 0) & (ring < 256) & (ring == np.floor(ring))).all():
            return np.array(rows)
    for columns in (4, 3):
        if len(values) % columns == 0:
            return np.array(values.reshape(-1, columns))
    raise FrameError(f"{len(values)} float32 values are no rows of 5, 4 or 3")


def parse_npz(data: bytes) -> FileFrame:
    """``xyz`` (..., 3) and optionally ``intensity ring stamp range_mm reflectivity``; or ``xyz_cm`` int16."""
    if data[:2] != b"PK":
        raise FrameError("not an .npz file")
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        if "xyz" in file:
            xyz = np.asarray(file["xyz"], np.float32)
        elif "xyz_cm" in file:
            xyz = np.asarray(file["xyz_cm"], np.float32) / np.float32(100.0)
        else:
            raise FrameError(f"no array 'xyz' among {', '.join(file.files)}")
        if xyz.ndim < 2 or xyz.shape[-1] != 3 or xyz.size > 3 * MAX_POINTS:
            raise FrameError(f"xyz has shape {xyz.shape}, expected (..., 3)")
        shape = xyz.shape[:-1]
        columns = [xyz.reshape(-1, 3)]
        intensity = next((file[n] for n in ("intensity", "reflectivity") if n in file), None)
        ring = next((file[n] for n in ("ring",) if n in file), None)
        if ring is None and len(shape) == 2:  # an organised cloud: rows are beams
            ring = np.broadcast_to(np.arange(shape[0])[:, None], shape)
        if intensity is not None or ring is not None:
            columns.append(_column(intensity, shape))
        if ring is not None:
            columns.append(_column(ring, shape))
        points = np.hstack(columns)
        if "range_mm" in file:
            points = points[file["range_mm"].ravel() > 0]
        stamp_s = float(file["stamp"]) if "stamp" in file else None
    return FileFrame(np.ascontiguousarray(points, np.float32), stamp_s)


def _column(values: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    if values is None:
        return np.zeros((int(np.prod(shape)), 1), np.float32)
    if values.shape != shape:
        raise FrameError(f"a column of shape {values.shape} does not belong to points {shape}")
    return np.clip(values, 0, 255).astype(np.float32).reshape(-1, 1)


def _stamp_in_name(name: str) -> float | None:
    stem = name.rpartition("/")[2].partition(".")[0]
    return int(stem) / 1e9 if stem.isdigit() and 18 <= len(stem) <= 19 else None


def parse_pcd(data: bytes) -> np.ndarray:
    """Point Cloud Library files, ascii, binary and binary_compressed (format description of PCL, version 0.7)."""
    header, body = _pcd_header(data)
    count = int(header["POINTS"][0] if "POINTS" in header else header["WIDTH"][0])
    if not 0 < count <= MAX_POINTS:
        raise FrameError(f"{count} points")
    names = header["FIELDS"]
    counts = [int(c) for c in header.get("COUNT", ["1"] * len(names))]
    types = [_PCD_TYPES[t, int(s)] for t, s in zip(header["TYPE"], header["SIZE"], strict=True)]
    kind = header["DATA"][0]
    if kind == "ascii":
        if not body.strip():
            raise FrameError("no points behind the header")
        starts = np.concatenate([[0], np.cumsum(counts)])
        table = np.loadtxt(io.BytesIO(body), dtype=np.float64, comments=None, ndmin=2, max_rows=count)
        fields = {name: table[:, start] for name, start in zip(names, starts, strict=False)}
    elif kind == "binary":
        record = np.dtype([(n, t, (c,)) for n, t, c in zip(_unique(names), types, counts, strict=True)])
        rows = np.frombuffer(body, record, count)
        fields = {n: rows[n][:, 0] for n in record.names or ()}
    elif kind == "binary_compressed":
        fields = _pcd_columns(body, names, types, counts, count)
    else:
        raise FrameError(f"DATA {kind} is no layout of PCD")
    columns = [fields[axis] for axis in "xyz"]
    intensity = next((fields[n] for n in ("intensity", "i") if n in fields), None)
    ring = next((fields[n] for n in ("ring", "channel") if n in fields), None)
    if intensity is not None or ring is not None:
        columns.append(intensity if intensity is not None else np.zeros(count))
    if ring is not None:
        columns.append(ring)
    return np.ascontiguousarray(np.stack(columns, axis=1), np.float32)


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


def _pcd_columns(
    body: bytes, names: list[str], types: list[str], counts: list[int], count: int
) -> dict[str, np.ndarray]:
    packed, size = struct.unpack_from("<II", body)
    expected = sum(np.dtype(t).itemsize * c for t, c in zip(types, counts, strict=True)) * count
    if size != expected:
        raise FrameError(f"{size} bytes unpacked, {expected} expected")
    raw = lzf_decompress(body[8 : 8 + packed], size)
    fields, position = {}, 0
    for name, kind, repeat in zip(names, types, counts, strict=True):
        fields[name] = np.frombuffer(raw, kind, count * repeat, position)[:count]
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
