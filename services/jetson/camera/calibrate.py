"""``spotter-camera calibrate``: the focal length, from chessboard pictures or one object of known size and distance.

The result is the ``[lens]`` section of the service's configuration file; the rest of the file stays as it is.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, NamedTuple

import cv2
import msgspec
import numpy as np
import typer

from services.jetson.camera.config import CameraConfig, LensConfig
from services.jetson.camera.detector import Detector

MIN_PICTURES = 5
_SUBPIXEL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)

app = typer.Typer(name="calibrate", help="Measure the lens and write it into the configuration.", no_args_is_help=True)
OutOption = Annotated[Path, typer.Option("--out", help="The configuration file to write [lens] into.")]


class CalibrationError(ValueError):
    """The pictures do not determine the lens; the text says why."""


class ChessboardResult(NamedTuple):
    lens: LensConfig
    error_px: float  # root mean square reprojection error
    used: int  # pictures in which the board was found


@app.command()
def chessboard(
    pictures: Annotated[list[Path], typer.Argument(help="Pictures of a chessboard, taken through the same pipeline.")],
    columns: Annotated[int, typer.Option(help="Inner corners along a row.")] = 9,
    rows: Annotated[int, typer.Option(help="Inner corners along a column.")] = 6,
    out: OutOption = Path("camera.toml"),
) -> None:
    """Calibrate from at least 5 pictures of a chessboard held at different angles, all over the picture."""
    images = [_read(path) for path in pictures]
    try:
        result = from_chessboard(images, columns, rows)
    except CalibrationError as error:
        raise typer.BadParameter(str(error)) from None
    _finish(result.lens, out, f"{result.used} of {len(images)} pictures, error {result.error_px:.2f} px")


@app.command("object")
def known_object(
    picture: Annotated[Path, typer.Argument(help="One picture of an upright object, seen in full.")],
    height_m: Annotated[float, typer.Option(help="Its real height.")],
    distance_m: Annotated[float, typer.Option(help="Its distance from the lens, along the view.")],
    box: Annotated[str, typer.Option(help="Its rows in the picture, TOP,BOTTOM; without it the network looks.")] = "",
    label: Annotated[str, typer.Option(help="What the network shall look for.")] = "person",
    model: Annotated[str, typer.Option(help="The network to look with; without it the demo network.")] = "",
    out: OutOption = Path("camera.toml"),
) -> None:
    """Calibrate from one object of known height at a known distance."""
    image = _read(picture)
    try:
        top, bottom = _rows(box) if box else _find(image, label, model)
        lens = from_object(image.shape[1], image.shape[0], bottom - top, height_m, distance_m)
    except CalibrationError as error:
        raise typer.BadParameter(str(error)) from None
    _finish(lens, out, f"{bottom - top:.0f} px for {height_m} m at {distance_m} m")


def from_chessboard(images: list[np.ndarray], columns: int, rows: int) -> ChessboardResult:
    """Lens from pictures (H, W, 3) uint8 of one size (Zhang 2000, as in OpenCV).

    Raises:
        CalibrationError: too few pictures with a board, or pictures of several sizes.
    """
    sizes = {image.shape[:2] for image in images}
    if len(sizes) != 1:
        raise CalibrationError(f"expected pictures of one size, found {sorted((w, h) for h, w in sizes)}")
    height_px, width_px = sizes.pop()
    corners = [found for image in images if (found := _corners(image, columns, rows)) is not None]
    if len(corners) < MIN_PICTURES:
        raise CalibrationError(
            f"found the {columns} x {rows} corners in {len(corners)} of {len(images)} pictures, needs {MIN_PICTURES}"
        )
    board = np.zeros((rows * columns, 3), np.float32)  # in squares: the focal length does not depend on their size
    board[:, :2] = np.mgrid[0:columns, 0:rows].T.reshape(-1, 2)
    error_px, matrix, *_ = cv2.calibrateCamera([board] * len(corners), corners, (width_px, height_px), None, None)
    lens = LensConfig(
        width_px=width_px,
        height_px=height_px,
        f_x_px=float(matrix[0, 0]),
        f_y_px=float(matrix[1, 1]),
        c_x_px=float(matrix[0, 2]),
        c_y_px=float(matrix[1, 2]),
    )
    return ChessboardResult(lens, float(error_px), len(corners))


def from_object(width_px: int, height_px: int, box_px: float, height_m: float, distance_m: float) -> LensConfig:
    """Lens from one object that is ``box_px`` rows high; square pixels and a centred axis are assumed.

    Raises:
        CalibrationError: a length that is not positive.
    """
    if min(box_px, height_m, distance_m) <= 0:
        raise CalibrationError("the object's rows, height and distance must be positive")
    focal_px = distance_m * box_px / height_m
    return LensConfig(
        width_px=width_px,
        height_px=height_px,
        f_x_px=focal_px,
        f_y_px=focal_px,
        c_x_px=width_px / 2,
        c_y_px=height_px / 2,
    )


def with_lens(text: str, lens: LensConfig) -> str:
    """A TOML text with its ``[lens]`` section replaced, or added at its end."""
    values = msgspec.to_builtins(lens)
    lines = [
        f"{key} = {value:.2f}" if isinstance(value, float) else f"{key} = {value}" for key, value in values.items()
    ]
    section = "[lens]\n" + "\n".join(lines) + "\n"
    replaced, count = re.subn(r"(?ms)^\[lens\].*?(?=^\[|\Z)", section + "\n", text, count=1)
    return replaced if count else (text.rstrip() + "\n\n" if text.strip() else "") + section


def _finish(lens: LensConfig, out: Path, evidence: str) -> None:
    text = out.read_text(encoding="utf-8") if out.exists() else ""
    out.write_text(with_lens(text, lens), encoding="utf-8")
    typer.echo(f"f_x {lens.f_x_px:.1f} px, f_y {lens.f_y_px:.1f} px at {lens.width_px} x {lens.height_px} ({evidence})")
    typer.echo(f"written to {out}")


def _corners(image: np.ndarray, columns: int, rows: int) -> np.ndarray | None:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCorners(grey, (columns, rows))
    return cv2.cornerSubPix(grey, corners, (7, 7), (-1, -1), _SUBPIXEL) if found else None


def _read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise typer.BadParameter(f"{path}: not a picture that can be read")
    return image


def _rows(text: str) -> tuple[float, float]:
    try:
        top, bottom = (float(part) for part in text.split(","))
    except ValueError:
        raise CalibrationError(f"--box {text!r}: expected TOP,BOTTOM in pixels") from None
    return top, bottom


def _find(image: np.ndarray, label: str, model: str) -> tuple[float, float]:
    """Top and bottom of the tallest object of this label."""
    detector = Detector(msgspec.structs.replace(CameraConfig().detector, model=model))
    boxes = detector.detect(image)
    rows = [
        (float(box[1]), float(box[3]))
        for box, class_id in zip(boxes.xyxy_px, boxes.class_id, strict=True)
        if detector.names[class_id] == label
    ]
    if not rows:
        raise CalibrationError(f"no {label} found in the picture; give its rows with --box TOP,BOTTOM")
    return max(rows, key=lambda row: row[1] - row[0])
