"""KITTI tracking files as arrays: labels, detections, results.

Boxes are (n, 7) float64: x y z (camera frame, metres, bottom centre; x right, y DOWN, z forward), h w l, rot_y.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

CLASSES = ("Car", "Pedestrian", "Cyclist")
NEIGHBOURS = {"Car": "Van", "Pedestrian": "Person_sitting", "Cyclist": None}


@dataclass(frozen=True)
class Rows:
    """n rows of one sequence: a box in a frame, with the track it belongs to (-1: none)."""

    frame: np.ndarray  # (n,) int64
    track: np.ndarray  # (n,) int64
    kind: np.ndarray  # (n,) str
    truncated: np.ndarray  # (n,) float64
    occluded: np.ndarray  # (n,) float64
    box_px: np.ndarray  # (n, 4) x1 y1 x2 y2
    box: np.ndarray  # (n, 7)
    alpha: np.ndarray  # (n,)
    score: np.ndarray  # (n,), 1 for labels

    def take(self, index: np.ndarray) -> Rows:
        """The rows at ``index``, integers or a mask (n,)."""
        return Rows(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def data_folder() -> Path:
    """``tracking-kitti`` in SPOTTER_DATA, by default beside the repository."""
    default = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("SPOTTER_DATA", default)) / "tracking-kitti"


def read_rows(path: Path) -> Rows:
    """Labels (17 columns) or results (18, with the score at the end)."""
    lines = [line.split() for line in path.read_text().splitlines() if line.strip()]
    if not lines:
        return _empty()
    kind = np.array([line[2] for line in lines])
    numbers = np.array([[*line[:2], *line[3:17], line[17] if len(line) > 17 else "1"] for line in lines], float)
    return Rows(
        frame=numbers[:, 0].astype(np.int64),
        track=numbers[:, 1].astype(np.int64),
        kind=kind,
        truncated=numbers[:, 2],
        occluded=numbers[:, 3],
        box_px=numbers[:, 5:9],
        box=np.column_stack((numbers[:, 12:15], numbers[:, 9:12], numbers[:, 15])),
        alpha=numbers[:, 4],
        score=numbers[:, 16],
    )


def read_detections(path: Path, kind: str) -> Rows:
    """PointRCNN detections of one class and sequence (15 comma-separated columns)."""
    text = path.read_text().strip()
    if not text:
        return _empty()
    numbers = np.array([line.split(",") for line in text.splitlines()], float)
    count = len(numbers)
    return Rows(
        frame=numbers[:, 0].astype(np.int64),
        track=np.full(count, -1),
        kind=np.full(count, kind),
        truncated=np.zeros(count),
        occluded=np.zeros(count),
        box_px=numbers[:, 2:6],
        box=np.column_stack((numbers[:, 10:13], numbers[:, 7:10], numbers[:, 13])),
        alpha=numbers[:, 14],
        score=numbers[:, 6],
    )


def write_rows(path: Path, rows: Rows) -> None:
    """A result file: the label columns and the score."""
    with path.open("w") as file:
        for i in range(len(rows.frame)):
            x, y, z, h, w, l, turn = rows.box[i]  # noqa: E741
            numbers = [rows.alpha[i], *rows.box_px[i], h, w, l, x, y, z, turn, rows.score[i]]
            text = " ".join(f"{value:.6f}" for value in numbers)
            file.write(f"{rows.frame[i]} {rows.track[i]} {rows.kind[i]} 0 0 {text}\n")


def _empty() -> Rows:
    none = np.empty(0)
    whole = np.empty(0, np.int64)
    return Rows(whole, whole, np.empty(0, "<U16"), none, none, np.empty((0, 4)), np.empty((0, 7)), none, none)
