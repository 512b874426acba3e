"""Chessboards as a camera with a known lens sees them.

python -m tests.jetson.camera.training.boards FOLDER      # writes six pictures, for the commands of the pages
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

COLUMNS, ROWS = 9, 6
TRUE = np.array([[520.0, 0, 315.0], [0, 505.0, 245.0], [0, 0, 1]])


def board_picture(rotation_rad: tuple[float, float, float], place_squares: tuple[float, float, float]) -> np.ndarray:
    """A chessboard of 10 x 7 squares as a camera with the true lens sees it."""
    cell = 40
    flat = np.full(((ROWS + 3) * cell, (COLUMNS + 3) * cell), 255, np.uint8)
    for row in range(ROWS + 1):
        for column in range(COLUMNS + 1):
            if (row + column) % 2:
                flat[(row + 1) * cell : (row + 2) * cell, (column + 1) * cell : (column + 2) * cell] = 0
    rotation, _ = cv2.Rodrigues(np.array(rotation_rad))
    # pixels of the flat board -> squares, origin at the first inner corner -> picture
    to_squares = np.array([[1 / cell, 0, -2], [0, 1 / cell, -2], [0, 0, 1]])
    to_picture = TRUE @ np.column_stack([rotation[:, 0], rotation[:, 1], place_squares]) @ to_squares
    grey = cv2.warpPerspective(flat, to_picture, (640, 480), flags=cv2.INTER_AREA, borderValue=128)
    return cv2.cvtColor(cv2.GaussianBlur(grey, (3, 3), 0), cv2.COLOR_GRAY2BGR)


def tilted_boards() -> list[np.ndarray]:
    """Six pictures that determine the lens."""
    tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.5, 0.1), (0.1, -0.5, 0), (0.3, 0.3, 0.2), (-0.3, -0.3, 0)]
    return [board_picture(tilt, (-4.0 + i * 0.3, -2.5 + i * 0.1, 11.0 + i * 0.4)) for i, tilt in enumerate(tilts)]


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for number, picture in enumerate(tilted_boards()):
        cv2.imwrite(str(folder / f"{number:03}.png"), picture)
