"""``spotter-camera calibrate``: the focal length, from chessboard pictures or one object of known size and distance.

The result is the ``[lens]`` section of the service's configuration file; the rest of the file stays as it is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import cv2
import msgspec
import numpy as np
import typer

from common.replace_file import replace_text
from services.jetson.camera.config import CameraConfig, LensConfig
from services.jetson.camera.detector import Detector
from services.jetson.camera.training.coverage import Board, corners_by_field, coverage_picture, uncovered
from services.jetson.camera.training.evaluate import lens_of

LEAST_CORNERS = 3  # inner ones, each way: OpenCV finds no smaller board
MIN_PICTURES = 5
MIN_TILTED, TILTED_DEG = 3, 15.0
MOST_UNCERTAIN = 0.02  # standard deviation of the focal length, as a share of it
VIEW_DEG = (10.0, 150.0)  # across and down, of lenses that a pinhole describes
MOST_ASIDE = 0.2  # of the optical axis from the picture's centre, as a share of the size
_SUBPIXEL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)

app = typer.Typer(name="calibrate", help="Measure the lens and write it into the configuration.", no_args_is_help=True)
OutOption = Annotated[Path, typer.Option("--out", help="The configuration file to write [lens] into.")]


class CalibrationError(ValueError):
    """The pictures do not determine the lens; the text says why."""


class ChessboardResult(NamedTuple):
    """What a set of board pictures gave."""

    lens: LensConfig
    error_px: float  # root mean square reprojection error
    used: int  # pictures in which the board was found
    uncovered: list[str]  # ninths of the picture in which no board lay


@app.command()
def chessboard(
    pictures: Annotated[list[Path], typer.Argument(help="Pictures of a chessboard, taken through the same pipeline.")],
    columns: Annotated[int, typer.Option(min=LEAST_CORNERS, help="Inner corners along a row.")] = 9,
    rows: Annotated[int, typer.Option(min=LEAST_CORNERS, help="Inner corners along a column.")] = 6,
    coverage: Annotated[Path | None, typer.Option(help="Draw here where on the picture the boards lay.")] = None,
    out: OutOption = Path("camera.toml"),
) -> None:
    """Calibrate from at least 5 pictures of a chessboard held at different angles, all over the picture."""
    images = [_read(path) for path in pictures]
    boards = [find_board(image, columns, rows) for image in images]
    if coverage is not None:
        _draw_coverage(coverage, images[0], [board for board in boards if board is not None])
    try:
        result = from_boards(boards, images, rows)
    except CalibrationError as error:
        raise typer.BadParameter(str(error)) from None
    _finish(result.lens, out, f"{result.used} of {len(images)} pictures, error {result.error_px:.2f} px")
    if result.uncovered:
        typer.echo(f"no board lay in: {', '.join(result.uncovered)} of the picture; the distortion there is a guess")


@app.command("object")
def known_object(
    picture: Annotated[Path, typer.Argument(help="One picture of an upright object, seen in full.")],
    height_m: Annotated[float, typer.Option(help="Its real height.")],
    distance_m: Annotated[float, typer.Option(help="Its distance from the lens, along the view.")],
    box: Annotated[str, typer.Option(help="Its rows in the picture, TOP,BOTTOM; without it a network looks.")] = "",
    model: Annotated[str, typer.Option(help="The network that looks for a person, where no --box is given.")] = "",
    out: OutOption = Path("camera.toml"),
) -> None:
    """Calibrate from one object of known height at a known distance."""
    image = _read(picture)
    try:
        top, bottom = _rows(box) if box else _find_person(image, model)
        lens = from_object(image.shape[1], image.shape[0], bottom - top, height_m, distance_m)
    except CalibrationError as error:
        raise typer.BadParameter(str(error)) from None
    _finish(lens, out, f"{bottom - top:.0f} px for {height_m} m at {distance_m} m")


def from_chessboard(images: list[np.ndarray], columns: int, rows: int) -> ChessboardResult:
    """Lens from pictures (H, W, 3) uint8 of one size (Zhang 2000, as in OpenCV).

    Raises:
        CalibrationError: as ``from_boards``.
    """
    return from_boards([find_board(image, columns, rows) for image in images], images, rows)


def from_boards(boards: Sequence[Board | None], images: list[np.ndarray], rows: int) -> ChessboardResult:
    """Lens from the boards that were found in these pictures, None = none in this one.

    Raises:
        CalibrationError: too few pictures with a board, pictures of several sizes, or pictures that do not determine
            the lens; says what is missing.
    """
    sizes = {image.shape[:2] for image in images}
    if len(sizes) != 1:
        raise CalibrationError(f"expected pictures of one size, found {sorted((w, h) for h, w in sizes)}")
    height_px, width_px = sizes.pop()
    found = [board for board in boards if board is not None]
    if len(found) < MIN_PICTURES:
        raise CalibrationError(
            f"found the board's inner corners in {len(found)} of {len(images)} pictures, needs {MIN_PICTURES}"
        )
    columns, corners = found[0].columns, [board.corners_px[:, None] for board in found]
    board = np.zeros((rows * columns, 3), np.float32)  # in squares: the focal length does not depend on their size
    board[:, :2] = np.mgrid[0:columns, 0:rows].T.reshape(-1, 2)
    error_px, matrix, distortion, rotations, _, deviations, *_ = cv2.calibrateCameraExtended(
        [board] * len(corners), corners, (width_px, height_px), np.eye(3), np.zeros(5)
    )
    _check_determined(matrix, deviations.reshape(-1), rotations, corners, (width_px, height_px))
    terms = tuple(float(value) for value in distortion.reshape(-1))
    lens = msgspec.structs.replace(lens_of(matrix, width_px, height_px), distortion=terms)
    empty = uncovered(corners_by_field(found, width_px, height_px))
    return ChessboardResult(lens, float(error_px), len(corners), empty)


def _check_determined(
    matrix: np.ndarray,
    deviations: np.ndarray,
    rotations: Sequence[np.ndarray],
    corners: list[np.ndarray],
    size_px: tuple[int, int],
) -> None:
    """Refuse what these boards leave open, and say which pictures are missing.

    ``deviations``: standard deviations of f_x, f_y, c_x, c_y, ... as OpenCV estimates them. A board that faces the
    camera tells only the ratio of focal length and distance, so boards have to be tilted.
    """
    missing = []
    tilts_deg = [float(np.degrees(np.arccos(min(1.0, abs(cv2.Rodrigues(one)[0][2, 2]))))) for one in rotations]
    tilted = sum(tilt > TILTED_DEG for tilt in tilts_deg)
    if tilted < MIN_TILTED:
        missing.append(f"{MIN_TILTED - tilted} more with the board turned by {TILTED_DEG:.0f} to 45 degrees")
    views = distinct_views(corners, size_px)
    if views < MIN_PICTURES:
        missing.append(f"{MIN_PICTURES - views} more from other places and distances ({views} differ)")
    focal_px, axis_px = matrix[[0, 1], [0, 1]], matrix[:2, 2]
    uncertain = np.nan_to_num(deviations[:2] / focal_px, nan=np.inf).max()
    if uncertain > MOST_UNCERTAIN:
        missing.append(
            f"boards that determine the focal length (its standard deviation is {min(uncertain, 9.99):.0%} of it)"
        )
    view_deg = np.degrees(2 * np.arctan(np.array(size_px) / 2 / focal_px))
    if view_deg.min() < VIEW_DEG[0] or view_deg.max() > VIEW_DEG[1]:
        missing.append(
            f"a field of view that a lens can have (this one is {view_deg[0]:.2g} x {view_deg[1]:.2g} degrees)"
        )
    if (np.abs(axis_px / size_px - 0.5) > MOST_ASIDE).any():
        missing.append(f"boards in every corner of the picture (the optical axis comes out at {axis_px.round()} px)")
    if missing:
        raise CalibrationError("these pictures do not determine the lens; missing: " + "; ".join(missing))


def distinct_views(corners: list[np.ndarray], size_px: tuple[int, int]) -> int:
    """Of boards (N, 1, 2) in pixels, how many differ from all before by a fiftieth of the picture's width."""
    seen: list[np.ndarray] = []
    for board in corners:
        if all(float(np.abs(board - other).mean()) > size_px[0] / 50 for other in seen):
            seen.append(board)
    return len(seen)


def from_object(width_px: int, height_px: int, box_px: float, height_m: float, distance_m: float) -> LensConfig:
    """Lens from one object that is ``box_px`` rows high; square pixels and a centred axis are assumed.

    Raises:
        CalibrationError: a length that is not positive, or a focal length that no lens has.
    """
    if min(box_px, height_m, distance_m) <= 0:
        raise CalibrationError("the object's rows, height and distance must be positive")
    focal_px = distance_m * box_px / height_m
    view_deg = math.degrees(2 * math.atan(max(width_px, height_px) / 2 / focal_px))
    if not VIEW_DEG[0] <= view_deg <= VIEW_DEG[1]:
        raise CalibrationError(
            f"{focal_px:.0f} px would be a field of view of {view_deg:.0f} degrees; expected {VIEW_DEG[0]:.0f} to "
            f"{VIEW_DEG[1]:.0f}: check the box, the height and the distance"
        )
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
    lines = [f"{key} = {_toml(value)}" for key, value in values.items()]
    section = "[lens]\n" + "\n".join(lines) + "\n"
    replaced, count = re.subn(r"(?ms)^\[lens\].*?(?=^\[|\Z)", section + "\n", text, count=1)
    return replaced if count else (text.rstrip() + "\n\n" if text.strip() else "") + section


def _toml(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(f'{one:.5f}' for one in value)}]"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def _finish(lens: LensConfig, out: Path, evidence: str) -> None:
    try:
        text = out.read_text(encoding="utf-8") if out.exists() else ""
        replace_text(out, with_lens(text, lens))  # never half a file: the service may be using it
    except OSError as error:
        raise typer.BadParameter(f"{out}: {error.strerror}; nothing in it was changed") from None
    typer.echo(f"f_x {lens.f_x_px:.1f} px, f_y {lens.f_y_px:.1f} px at {lens.width_px} x {lens.height_px} ({evidence})")
    typer.echo(f"written to {out}")


def find_board(image: np.ndarray, columns: int, rows: int) -> Board | None:
    """The board in a picture (H, W, 3) uint8 BGR, by its inner corners; None = it is not there as a whole."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCorners(grey, (columns, rows))
    if not found:
        return None
    return Board(cv2.cornerSubPix(grey, corners, (7, 7), (-1, -1), _SUBPIXEL).reshape(-1, 2), columns)


def _draw_coverage(path: Path, background: np.ndarray, boards: list[Board]) -> None:
    encoded, png = cv2.imencode(".png", coverage_picture(background, boards))
    assert encoded
    path.with_suffix(".png").write_bytes(png.tobytes())
    typer.echo(f"where the boards lay is drawn in {path.with_suffix('.png')}")


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


def _find_person(image: np.ndarray, model: str) -> tuple[float, float]:
    """Top and bottom of the tallest person."""
    if not model:
        raise CalibrationError("give the object's rows with --box TOP,BOTTOM, or a network with --model")
    detector = Detector(msgspec.structs.replace(CameraConfig().detector, model=model))
    boxes = detector.detect(image)
    rows = [
        (float(box[1]), float(box[3]))
        for box, class_id in zip(boxes.xyxy_px, boxes.class_id, strict=True)
        if detector.names[class_id].lower() == "person"
    ]
    if not rows:
        raise CalibrationError("no person found in the picture; give the object's rows with --box TOP,BOTTOM")
    return max(rows, key=lambda row: row[1] - row[0])
