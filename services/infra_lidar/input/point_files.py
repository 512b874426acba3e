"""Files of single frames to arrays: ``.npz .npy .bin .pcd .ply .las .laz``. Bytes in, (N, 3..5) float32 out; no I/O.

The columns are x, y, z in metres in the sensor frame, intensity and ring. A file without rings gives four columns, one
without intensity and rings three. Intensities of ``.bin .npy .pcd`` are as in the file; those of ``.npz .ply`` are
clipped to 0..255, and those of ``.las .laz`` of 16 bits are brought to 8. Nothing is guessed: numbers that do not bear
out a layout are refused.
"""

from __future__ import annotations

import io
import lzma
import struct
import tokenize
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from services.infra_lidar.input.las import parse_las
from services.infra_lidar.input.pcd import MAX_POINTS, FrameError, parse_pcd, point_columns
from services.infra_lidar.input.plausible import in_metres, with_plausible_columns, wrong_intensity, wrong_ring
from services.infra_lidar.input.ply import parse_ply

POINTS_OF = {".pcd": parse_pcd, ".ply": parse_ply, ".las": parse_las, ".laz": parse_las}
FRAME_SUFFIXES = (".npz", ".pcd", ".bin", ".npy", ".ply", ".las", ".laz")
WITHOUT_NAMES = (".bin", ".npy")  # whose columns can be told with ?columns=
MODEL_FILE = "background.npz"  # which ``calibration.store`` writes
LAYOUTS = {3: ("x", "y", "z"), 4: ("x", "y", "z", "intensity"), 5: ("x", "y", "z", "intensity", "ring")}
PERIODS = range(3, 13)  # values a row that are looked for in a .bin
FEW_VALUES = 1000  # of so many, rings tell more than sizes
CLEAR_SHARE = 0.97  # of the best score: a multiple of the period scores as well, a divisor does not
NPZ_COLUMNS = ("intensity", "reflectivity", "ring", "range_mm")  # a value for each point
NPZ_ARRAYS = ("xyz", "xyz_cm", "stamp", *NPZ_COLUMNS)
# What the readers of numpy and zipfile raise on damaged bytes, as documented and as seen with bytes damaged at random.
_DAMAGE = (ValueError, TypeError, LookupError, ArithmeticError, OSError, EOFError, struct.error, MemoryError)
_DAMAGE_OF_ZIP = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, RuntimeError)  # the last: encrypted, or too new
_DAMAGE_OF_NUMPY = (*_DAMAGE, SyntaxError, tokenize.TokenError, RecursionError)  # the header is written in Python


def frame_files(folder: Path) -> list[Path]:
    """The frames of the first suffix that the folder holds; ``background.npz``, the learned model, is none."""
    for suffix in FRAME_SUFFIXES:
        names = sorted(p for p in folder.iterdir() if p.suffix.lower() == suffix and p.name != MODEL_FILE)
        if names:
            return names
    return []


def others_beside(folder: Path, read: str) -> str:
    """How many frames of other suffixes than ``read`` the folder holds, as "2 .bin, 1 .npy"; "" = none."""
    suffixes = [p.suffix.lower() for p in folder.iterdir() if p.name != MODEL_FILE]
    return ", ".join(
        f"{suffixes.count(other)} {other}" for other in FRAME_SUFFIXES if other in suffixes and other != read
    )


@dataclass(frozen=True)
class FileFrame:
    """points: (N, 3..5) float32. stamp_s: UTC seconds as recorded, or None."""

    points: np.ndarray
    stamp_s: float | None = None


def parse_frame(name: str, data: bytes, columns: tuple[str, ...] = ()) -> FileFrame:
    """One file by its suffix; a file named by nanoseconds gives its stamp.

    columns: what the columns of a ``.bin`` or ``.npy`` are, such as ("x", "y", "z", "intensity", "time"). Without them
    only the usual layouts are taken, and only when the numbers bear them out.

    Raises:
        FrameError: damaged, of an unknown layout, without points, or not in metres.
    """
    try:
        with np.errstate(all="ignore"):  # what is too large for float32 becomes infinite and is left out
            frame = _parse(name, data, columns)
            return FileFrame(with_plausible_columns(in_metres(frame.points)), frame.stamp_s)
    except FrameError as error:
        raise FrameError(f"{name}: {error}") from None
    except (*_DAMAGE, *_DAMAGE_OF_ZIP) as error:
        raise FrameError(f"{name}: damaged ({str(error) or type(error).__name__})") from error


def _parse(name: str, data: bytes, columns: tuple[str, ...]) -> FileFrame:
    suffix = name[name.rfind(".") :].lower()
    if suffix == ".npz":
        return parse_npz(data)
    if suffix in POINTS_OF:
        return FileFrame(POINTS_OF[suffix](data), _stamp_in_name(name))
    if suffix == ".npy":
        rows = _numbers(io.BytesIO(data), "the array")
        if rows.ndim != 2:
            raise FrameError(f"an array of shape {rows.shape}, expected (N, 3..)")
        return FileFrame(_named(rows.astype(np.float32), columns), _stamp_in_name(name))
    return FileFrame(parse_bin(data, columns), _stamp_in_name(name))


def parse_bin(data: bytes, columns: tuple[str, ...] = ()) -> np.ndarray:
    """Raw float32 rows: x y z, with intensity (KITTI), with ring; or ``columns``.

    How long the rows are shows in the numbers: heights, intensities and rings repeat with that period.
    """
    values = np.frombuffer(data, "<f4") if len(data) % 4 == 0 else None
    if values is None or not len(values):
        raise FrameError(f"{len(data)} bytes are no rows of float32")
    width = len(columns) or row_length(values)
    if len(values) % width:
        raise FrameError(f"{len(values)} float32 values are no rows of {width}")
    return _named(np.array(values.reshape(-1, width)), columns)


def row_length(values: np.ndarray) -> int:
    """How many values make a row.

    Raises:
        FrameError: the numbers do not tell.
    """
    possible = [width for width in PERIODS if len(values) % width == 0]
    if len(values) < FEW_VALUES and 5 in possible and not _contradiction(values, 5):
        return 5  # whole numbers in every fifth place: no coordinates would be
    scores = _periodicities(values)
    best = max(scores.values(), default=0.0)
    if best <= 0.0:
        raise FrameError(f"{len(values)} float32 values do not tell how long the rows are: {_HOW_TO_TELL}")
    width = next(width for width, score in scores.items() if score >= CLEAR_SHARE * best)  # its multiples score as well
    if width not in possible or width not in LAYOUTS:
        raise FrameError(f"the numbers look like rows of {width}: {_HOW_TO_TELL}")
    return width


_HOW_TO_TELL = "say what the columns are with ?columns=x,y,z,... (others: any name)"


def _periodicities(values: np.ndarray) -> dict[int, float]:
    """Share of the variance of the numbers' size that their place in a row explains, for each length of rows.

    What chance would explain is taken off: the longer the rows and the fewer, the more.
    """
    size = np.log1p(np.abs(np.nan_to_num(values.astype(float))))
    scores = {}
    for width in PERIODS:
        rows = size[: len(size) // width * width].reshape(-1, width)
        if len(rows) > 1:
            explained = rows.mean(axis=0).var() / max(float(rows.var()), 1e-12)
            scores[width] = float(1.0 - (1.0 - explained) * (rows.size - 1) / (rows.size - width))
    return scores


def _contradiction(values: np.ndarray, width: int) -> str:
    """Why rows of so many values are not the usual layout; "" = nothing speaks against it."""
    rows = values.reshape(-1, width)
    if width == 5 and wrong_ring(rows[:, 4]):
        return f"the fifth column is no ring: {wrong_ring(rows[:, 4])}"
    if width >= 4 and wrong_intensity(rows[:, 3]):
        return f"the fourth column is no intensity: {wrong_intensity(rows[:, 3])}"
    return ""


def _named(rows: np.ndarray, columns: tuple[str, ...]) -> np.ndarray:
    """(N, 3..5) from rows (N, W): the columns by name, or the usual layout if the numbers bear it out."""
    if columns:
        if len(columns) != rows.shape[1] or not {"x", "y", "z"} <= set(columns):
            raise FrameError(f"columns {','.join(columns)}: {rows.shape[1]} names with x, y and z are expected")
    elif rows.shape[1] not in LAYOUTS:
        raise FrameError(f"{rows.shape[1]} columns: {_HOW_TO_TELL}")
    elif _contradiction(rows, rows.shape[1]):
        raise FrameError(f"{_contradiction(rows, rows.shape[1])}; {_HOW_TO_TELL}")
    names = list(columns or LAYOUTS[rows.shape[1]])
    columns_by_name = dict(zip(names, rows.T, strict=True))
    xyz = [columns_by_name[axis] for axis in "xyz"]
    return point_columns(xyz, columns_by_name.get("intensity"), columns_by_name.get("ring"))


def parse_npz(data: bytes) -> FileFrame:
    """``xyz`` (..., 3) and optionally ``intensity ring stamp range_mm reflectivity``; or ``xyz_cm`` int16."""
    if data[:4] != b"PK\3\4":
        raise FrameError("not an .npz file")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        held = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
        arrays = {name: _numbers(archive.open(f"{name}.npy"), name) for name in NPZ_ARRAYS if name in held}
    if "xyz" in arrays:
        xyz = arrays["xyz"].astype(np.float32)
    elif "xyz_cm" in arrays:
        xyz = arrays["xyz_cm"].astype(np.float32) / np.float32(100.0)
    else:
        raise FrameError(f"no array 'xyz' among {', '.join(held)}")
    if xyz.ndim < 2 or xyz.shape[-1] != 3 or xyz.size > 3 * MAX_POINTS:
        raise FrameError(f"xyz has shape {xyz.shape}, expected (..., 3)")
    shape = xyz.shape[:-1]
    columns = {name: _column(arrays[name], shape, name) for name in NPZ_COLUMNS if name in arrays}
    if "ring" not in columns and len(shape) == 2:  # an organised cloud: rows are beams
        columns["ring"] = np.repeat(np.arange(shape[0]), shape[1])
    intensity = columns.get("intensity", columns.get("reflectivity"))
    points = point_columns(list(xyz.reshape(-1, 3).T), _clipped(intensity), _clipped(columns.get("ring")))
    if "range_mm" in columns:
        points = points[columns["range_mm"] > 0]
    return FileFrame(points, _stamp(arrays.get("stamp")))


def _numbers(stream: IO[bytes], name: str) -> np.ndarray:
    """An array as numpy writes it, of any shape.

    Raises:
        FrameError: damaged, or not of numbers.
    """
    try:
        array = np.lib.format.read_array(stream, allow_pickle=False)
    except _DAMAGE_OF_NUMPY as error:
        what = str(error.args[0] if error.args else "") or type(error).__name__
        raise FrameError(f"{name} is damaged, or not of numbers ({what})") from None
    if array.dtype.kind not in "fiu":
        raise FrameError(f"{name} is of type {array.dtype}, expected numbers")
    return array


def _column(values: np.ndarray, shape: tuple[int, ...], name: str) -> np.ndarray:
    """(N,) of an array with a value for each point."""
    if values.shape != shape:
        raise FrameError(f"{name} has shape {values.shape}, expected {shape}, a value for each point")
    return values.ravel()


def _clipped(values: np.ndarray | None) -> np.ndarray | None:
    return None if values is None else np.clip(values, 0, 255)


def _stamp(values: np.ndarray | None) -> float | None:
    """UTC seconds of the frame."""
    if values is None:
        return None
    if values.size != 1:
        raise FrameError(f"stamp has shape {values.shape}, expected one number, the UTC seconds of the frame")
    return float(values.ravel()[0])


def _stamp_in_name(name: str) -> float | None:
    stem = name.rpartition("/")[2].partition(".")[0]
    return int(stem) / 1e9 if stem.isdigit() and 18 <= len(stem) <= 19 else None
