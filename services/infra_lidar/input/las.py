"""ASPRS LAS and LAZ files to arrays, by the library ``laspy`` (extras ``las`` and ``laz``). Bytes in, arrays out."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np

from services.infra_lidar.input.pcd import MAX_POINTS, FrameError, point_columns

_COMPRESSED = 0x80  # in the point format's number, LAS 1.4 R15 with LASzip
_FORMAT_AT, _LEGACY_COUNT_AT, _COUNT_AT, _VERSION_AT = 104, 107, 247, 25
_RECORDS_AT, _LATE_RECORDS_AT = 100, 243  # how many variable length records, before and (LAS 1.4) behind the points
_POINTS_AT = 96  # where the points begin; those of LAZ begin with the place of the table of their chunks
_RECORD_BYTES = 54  # of such a record's head
_HEAD_BYTES = 227


def parse_las(data: bytes) -> np.ndarray:
    """(N, 4..5) float32: x, y, z in the file's own metres, intensity (0..255), and ring if there is such a dimension.

    Raises:
        FrameError: no LAS, damaged, without points, or an extra is not installed.
    """
    if data[:4] != b"LASF" or len(data) < _HEAD_BYTES:
        raise FrameError("no header of a LAS file")
    count = _announced(data)
    if not 0 < count <= MAX_POINTS:
        raise FrameError(f"{count} points")
    records = _records(data)
    if records * _RECORD_BYTES > len(data):  # the library would look for every one of them
        raise FrameError(f"{records} records are announced, more than the file can hold")
    compressed = bool(data[_FORMAT_AT] & _COMPRESSED)
    laspy = _laspy(compressed)
    if compressed and _chunks(data) > count:  # the library would take memory for them, and end the process without it
        raise FrameError(f"{_chunks(data)} compressed chunks are announced for {count} points")
    columns, intensity, ring = _dimensions(laspy, data)
    if len(columns[0]) != count:
        raise FrameError(f"{count} points are announced, {len(columns[0])} follow")
    if intensity.max(initial=0.0) > 255.0:
        intensity /= 257.0  # LAS 1.4: of 16 bits
    return point_columns(columns, intensity, ring)


def _dimensions(laspy: Any, data: bytes) -> tuple[list[np.ndarray], np.ndarray, np.ndarray | None]:
    """x, y and z, intensity and ring of all points, each (N,) float64.

    Raises:
        FrameError: damaged.
    """
    try:
        # Not the parallel decompressor: it takes as much memory as damaged bytes tell it to.
        cloud = laspy.read(io.BytesIO(data), laz_backend=laspy.LazBackend.Lazrs)
        columns = [np.asarray(getattr(cloud, axis), float) for axis in "xyz"]
        intensity = np.asarray(cloud.intensity, float)
        ring = np.asarray(cloud["ring"], float) if "ring" in cloud.point_format.dimension_names else None
    except (laspy.errors.LaspyException, ValueError, LookupError, OSError, struct.error, ArithmeticError) as error:
        raise FrameError(f"damaged LAS file ({error})") from None
    except RuntimeError as error:  # of the decompressor
        raise FrameError(f"damaged LAZ file ({error})") from None
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # of the decompressor, which is Rust: no ``Exception``
            raise
        raise FrameError(f"damaged LAZ file ({error})") from None
    return columns, intensity, ring


def _announced(data: bytes) -> int:
    """The number of points in the header: 32 bits before LAS 1.4."""
    if data[_VERSION_AT] >= 4 and len(data) >= _COUNT_AT + 8:
        return int(struct.unpack_from("<Q", data, _COUNT_AT)[0])
    return int(struct.unpack_from("<I", data, _LEGACY_COUNT_AT)[0])


def _records(data: bytes) -> int:
    """The number of variable length records in the header."""
    late = data[_VERSION_AT] >= 4 and len(data) >= _COUNT_AT
    places = (_RECORDS_AT, _LATE_RECORDS_AT) if late else (_RECORDS_AT,)
    return sum(int(struct.unpack_from("<I", data, at)[0]) for at in places)


def _chunks(data: bytes) -> int:
    """The number of chunks in the table of a LAZ file; 0 where there is no table, which the library refuses."""
    points_at = struct.unpack_from("<I", data, _POINTS_AT)[0]
    if len(data) < points_at + 8:
        return 0
    table_at = struct.unpack_from("<q", data, points_at)[0]
    if table_at == -1:  # the writer could not go back; then it stands at the end
        table_at = struct.unpack_from("<q", data, len(data) - 8)[0]
    return int(struct.unpack_from("<I", data, table_at + 4)[0]) if 0 <= table_at <= len(data) - 8 else 0


def _laspy(compressed: bool):  # type: ignore[no-untyped-def]
    """The library, once it can do what is asked."""
    try:
        import laspy
    except ImportError:
        raise FrameError(f"needs the extra `{'laz' if compressed else 'las'}`, which is not installed") from None
    if compressed and not laspy.LazBackend.Lazrs.is_available():
        raise FrameError("compressed (LAZ): needs the extra `laz`, which is not installed; or decompress it to LAS")
    return laspy
