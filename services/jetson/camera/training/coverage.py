"""Where on the picture the boards lay: counted by ninths, and drawn, so that one sees what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

FIELDS = 3  # across and down
ENOUGH = 6  # corners in a field; with fewer no board lay there
NAMES = (
    ("upper left", "upper middle", "upper right"),
    ("middle left", "middle", "middle right"),
    ("lower left", "lower middle", "lower right"),
)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_WHITE, _GREY, _AMBER, _GREEN = (255, 255, 255), (150, 150, 150), (0, 170, 255), (80, 175, 76)
_DIMMED = 0.35


class Board(NamedTuple):
    """One board that was found. ``corners_px`` (N, 2), row by row."""

    corners_px: np.ndarray
    columns: int


def corners_by_field(boards: Sequence[Board], width_px: int, height_px: int) -> np.ndarray:
    """(3, 3) int: how many corners lay in each ninth of the picture, rows from above."""
    corners = np.concatenate([board.corners_px for board in boards]) if boards else np.zeros((0, 2))
    counts, _, _ = np.histogram2d(corners[:, 1], corners[:, 0], bins=FIELDS, range=((0, height_px), (0, width_px)))
    return counts.astype(int)


def uncovered(counts: np.ndarray) -> list[str]:
    """Names of the fields in which no board lay: there the distortion is a guess."""
    return [NAMES[row][column] for row, column in zip(*np.nonzero(counts < ENOUGH), strict=True)]


def coverage_picture(background: np.ndarray, boards: Sequence[Board]) -> np.ndarray:
    """A dimmed copy of (H, W, 3) uint8 BGR with every board's outline and corners, and the empty fields marked."""
    canvas = (background * _DIMMED).astype(np.uint8)
    height_px, width_px = canvas.shape[:2]
    counts = corners_by_field(boards, width_px, height_px)
    for row in range(FIELDS):
        for column in range(FIELDS):
            left, top = width_px * column // FIELDS, height_px * row // FIELDS
            right, bottom = width_px * (column + 1) // FIELDS - 1, height_px * (row + 1) // FIELDS - 1
            empty = counts[row, column] < ENOUGH
            cv2.rectangle(canvas, (left, top), (right, bottom), _AMBER if empty else _GREY, 3 if empty else 1)
            text = "no board" if empty else str(counts[row, column])
            cv2.putText(canvas, text, (left + 8, top + 20), _FONT, width_px / 1280, _WHITE, 1, cv2.LINE_AA)
    for board in boards:
        rows = board.corners_px.reshape(-1, board.columns, 2)
        outline = np.array([rows[0, 0], rows[0, -1], rows[-1, -1], rows[-1, 0]])
        cv2.polylines(canvas, [outline.round().astype(np.int32)], isClosed=True, color=_GREEN, thickness=2)
        for x_px, y_px in board.corners_px:
            cv2.circle(canvas, (round(float(x_px)), round(float(y_px))), 2, _WHITE, cv2.FILLED)
    return canvas
